"""How often the intervals of frequency responses and transfer functions hold the plant.

`python -m bench.frequency_coverage [runs [case...]]`, a case being e.g. lateral-steps: the paper's
loops, flown with a chirp and with random steps, coloured noise on the output; the response, a transfer
function fitted to it, and TF. Orders are given, everything else is by default. Prints coverage of nominal
95 % intervals, and the bias in standard deviations.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.ingest.synth.manoeuvres import chirp
from flysid.ingest.synth.plants import LOOPS
from flysid.model.frequency.rational import Form, Rational, hold_response
from flysid.model.frequency.response import measure_response
from flysid.model.frequency.sampling import sample
from flysid.model.frequency.simulation_fit import fit_response
from flysid.model.transfer_function import TF

DT_S = 0.02
SECONDS = 120.0
BANDS_HZ = {"longitudinal": (0.05, 1.2), "lateral": (0.02, 0.4), "vertical": (0.05, 2.0)}
NOISE = 0.05
"""Standard deviation of the noise in that of the output."""
WORK = ("gain", "phase", "fit", "TF")


@dataclass(frozen=True)
class Case:
    """A loop and how it is excited."""

    loop: str
    excitation: str

    @property
    def truth(self) -> Rational:
        """The plant."""
        system = LOOPS[self.loop].transfer_function()
        den = np.asarray(system.den[0][0], dtype=np.float64)
        num = np.trim_zeros(np.asarray(system.num[0][0], dtype=np.float64), "f")
        return Rational(den / den[0], (num / den[0],), np.zeros(1))

    def flown(self, seed: int) -> Dataset:
        """One flight."""
        rng = np.random.default_rng(seed)
        n = round(SECONDS / DT_S)
        t = np.arange(n) * DT_S
        low, high = BANDS_HZ[self.loop]
        if self.excitation == "chirp":
            u = chirp(t, (low, high), 1.0)
        else:
            hold = round(0.25 / high / DT_S)
            u = np.repeat(rng.standard_normal(n // hold + 1), hold)[:n]
        a, b = sample(self.truth, DT_S, "zero")
        y = np.asarray(lfilter(b[0], a, u))
        noise = np.asarray(lfilter([1.0], [1.0, -0.9], rng.standard_normal(n)))
        return Dataset.from_arrays(u, y + NOISE * y.std() * noise / noise.std(), DT_S)


def run(case: Case, seed: int) -> dict[str, tuple[FloatArray, FloatArray]]:
    """(miss, standard error) of every figure by kind of work; the response with a quantile of its own."""
    data = case.flown(seed)
    truth = case.truth
    low, high = BANDS_HZ[case.loop]
    measured = measure_response(data, points=24, band=(2 * np.pi * 1.5 * low, 2 * np.pi * 0.9 * high))
    g = truth.at(measured.omega)[:, 0] * hold_response(measured.omega, DT_S, "zero")
    error = np.log(measured.response[:, 0] / g)
    width = measured.half_width()[:, 0] / 1.959963984540054
    form = Form(len(truth.denominator) - 1, (len(truth.numerators[0]) - 1,), (0.0,))
    values = np.concatenate([truth.denominator[1:], truth.numerators[0]])
    fit = fit_response(measure_response(data), form)
    found = np.concatenate([fit.rational.denominator[1:], fit.rational.numerators[0]])
    transfer = TF(poles=form.poles, zeros=form.zeros[0], dead_time_s=0.0).fit(data, data).transfer()
    refined = np.concatenate([transfer.denominator[1:], transfer.numerator])
    spread = np.concatenate([transfer.denominator_error[1:], transfer.numerator_error])
    return {
        "gain": (error.real, width),
        "phase": (error.imag, width),
        "fit": (found - values, np.sqrt(np.diag(fit.covariance))),
        "TF": (refined - values, spread),
    }


def main(runs: int, wanted: Sequence[str] = ()) -> None:
    """Print the table: all cases, or the wanted ones."""
    print(f"| loop | excitation | {' | '.join(f'{w}: coverage %, bias / sd' for w in WORK)} | failed |")
    for loop in BANDS_HZ:
        for excitation in ("chirp", "steps"):
            if wanted and f"{loop}-{excitation}" not in wanted:
                continue
            case = Case(loop, excitation)
            failed = 0
            seen: dict[str, list[tuple[FloatArray, FloatArray]]] = {w: [] for w in WORK}
            for seed in range(runs):
                try:
                    for work, pair in run(case, seed).items():
                        seen[work].append(pair)
                except FlysidError:
                    failed += 1
            cells = [_cell(seen[w]) for w in WORK]
            print(f"| {loop} | {excitation} | {' | '.join(cells)} | {failed} |", flush=True)


def _cell(pairs: list[tuple[FloatArray, FloatArray]]) -> str:
    miss, spread = (np.stack(x) for x in zip(*pairs, strict=True))
    inside = np.abs(miss) < 1.959963984540054 * spread
    bias = np.abs(miss.mean(axis=0)) / miss.std(axis=0)
    return f"{100 * inside.mean():.1f}, {np.median(bias):.2f}"


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200, sys.argv[2:])
