"""Loop figures with intervals against their closed form: an integrator with a dead time.

`python -m bench.loop_margins [runs] [first seed]`: the loop 20 / s e^(-0.03 s), held for 5 ms, closed, with a
multisine of 60 s added at the plant's input and noise at 30 dB below the output. Prints errors and coverage
of the 95 % intervals.
"""

from __future__ import annotations

import sys

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter

from flysid.dataset import Dataset
from flysid.ingest.synth.manoeuvres import random_phase_multisine
from flysid.model.frequency.loop_figures import broken_loop, loop_figures
from flysid.model.frequency.rational import Rational
from flysid.model.frequency.sampling import sample, sampled_response

DT_S = 0.005
SECONDS = 60.0
GAIN = 20.0
DEAD_S = 0.03
PLANT = Rational(np.array([1.0, 0.0]), (np.array([GAIN]),), np.array([DEAD_S]))


def flown(seed: int, snr_db: float = 30.0) -> Dataset:
    """Inputs u and r (added to the controller's -y), output y."""
    rng = np.random.default_rng(seed)
    n = round(SECONDS / DT_S)
    r = np.tile(random_phase_multisine(np.arange(n) * DT_S, (0.2, 20.0), 1.0, rng), 2)
    a, (b,) = sample(PLANT, DT_S, "zero")
    size = max(len(a), len(b))
    bottom = np.append(a, np.zeros(size - len(a))) + np.append(b, np.zeros(size - len(b)))
    clean = np.asarray(lfilter(b, bottom, r))
    noise = 10.0 ** (-snr_db / 20.0) * clean.std() * rng.standard_normal(len(r))
    y = clean + np.asarray(lfilter(np.append(a, np.zeros(size - len(a))), bottom, noise))
    return Dataset.from_arrays(np.column_stack([r - y, r])[n:], y[n:], DT_S, inputs=["u", "r"], outputs=["y"])


def truth() -> dict[str, float]:
    """Of the sampled loop, which is what the record shows."""

    def at(w: float) -> complex:
        return complex(sampled_response(PLANT, np.array([w]), DT_S, "zero")[0, 0])

    def phase(w: float) -> float:
        lag = -np.pi / 2 - w * (DEAD_S + DT_S / 2)
        return float(np.angle(at(w) * np.exp(-1j * lag))) + lag

    crossover = float(brentq(lambda w: abs(at(w)) - 1.0, 5.0, 60.0))
    turned = float(brentq(lambda w: phase(w) + np.pi, 20.0, 120.0))
    grid = np.geomspace(0.5, 300.0, 20000)
    s = 1.0 / (1.0 + sampled_response(PLANT, grid, DT_S, "zero")[:, 0])
    half = np.flatnonzero(np.abs(s) > np.sqrt(0.5))[0]
    return {
        "crossover_rads": crossover,
        "phase_margin_deg": 180.0 + float(np.degrees(phase(crossover))),
        "gain_margin_db": -20.0 * np.log10(abs(at(turned))),
        "sensitivity_peak_db": 20.0 * np.log10(np.abs(s).max()),
        "disturbance_rejection_bandwidth_rads": float(grid[half]),
    }


def main(runs: int, first: int) -> None:
    """Print the table."""
    true = truth()
    values: dict[str, list[tuple[float, bool]]] = {name: [] for name in true}
    refused = dict.fromkeys(true, 0)
    for seed in range(first, first + runs):
        loop = broken_loop(flown(seed), reference="r", at="input")
        figures = {f.name: f for f in loop_figures(loop)}
        for name, right in true.items():
            f = figures[name]
            if f.value is None or f.low is None or f.high is None:
                refused[name] += 1
            else:
                values[name].append((f.value, f.low <= right <= f.high))
    print(f"| figure | truth | median | largest error | interval holds, % of {runs} | refused |")
    for name, right in true.items():
        found = np.array([v for v, _ in values[name]] or [np.nan])
        holds = 100.0 * float(np.mean([h for _, h in values[name]] or [False]))
        worst = np.abs(found - right).max()
        print(
            f"| {name} | {right:.3f} | {np.median(found):.3f} | {worst:.3f} | {holds:.1f} | {refused[name]} |"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40, int(sys.argv[2]) if len(sys.argv) > 2 else 1000)
