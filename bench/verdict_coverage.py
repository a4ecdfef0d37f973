"""How often the interval holds the truth, and how often the verdict is right, where the truth is known.

Errors of two models are drawn as correlated AR(1) processes whose RMSE ratio is known, in flights of
different difficulty. `python -m bench.verdict_coverage [repetitions [seed]]` prints one line
per case. The interval was chosen on the draws of seeds 3, 5, 71, 72 and 99, so that these do not count.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.validate.bootstrap import change_interval, make_units
from flysid.validate.verdict import Evidence, Verdict, decide


@dataclass(frozen=True)
class Case:
    """Flights of n samples each.

    Attributes
    ----------
    rho : correlation of an error from one sample to the next.
    spread : standard deviation of the logarithm of a flight's difficulty; a third of it is one model's own.
    shared : share of the variance that both errors have in common.
    change_pct : true change of the RMSE from the baseline to the model.
    rare : standard deviation of the logarithm of what the baseline misses in a flight; where it is not 0,
        the model errs by noise alone, and the baseline by the same noise and what it misses.
    """

    name: str
    flights: int
    n: int
    rho: float
    spread: float = 0.0
    shared: float = 0.5
    change_pct: float = 0.0
    rare: float = 0.0


CASES: Sequence[Case] = (
    Case("1 flight, rho 0.8", 1, 1000, 0.8),
    Case("1 flight, rho 0.95", 1, 3000, 0.95),
    Case("1 flight, rho 0.99", 1, 3000, 0.99),
    Case("3 flights", 3, 1000, 0.95),
    Case("5 flights, unlike", 5, 900, 0.95, 0.3),
    Case("6 flights, very unlike", 6, 900, 0.95, 0.5),
    Case("12 flights, very unlike", 12, 900, 0.95, 0.5, 0.7),
    Case("30 flights, very unlike", 30, 600, 0.95, 0.5, 0.7),
    Case("1 long flight, 20 % better", 1, 9000, 0.95, change_pct=-20.0),
    Case("12 flights, 20 % better", 12, 900, 0.95, 0.3, 0.7, -20.0),
    Case("5 flights, rarely better", 5, 900, 0.8, change_pct=-20.0, rare=0.6),
    Case("8 flights, rarely better", 8, 900, 0.8, change_pct=-20.0, rare=0.6),
    Case("30 flights, rarely better", 30, 900, 0.8, change_pct=-20.0, rare=0.6),
)


@dataclass(frozen=True)
class Outcome:
    """Shares in percent: the interval holds the truth, lies below, above it; verdicts; half width."""

    coverage: float
    truth_below: float
    truth_above: float
    better: float
    worse: float
    half_width: float


def draw(case: Case, rng: np.random.Generator) -> tuple[list[FloatArray], list[FloatArray], list[str]]:
    """Errors of baseline and model, and the flight of each, so that the true change is `case.change_pct`."""
    names = [f"f{i}" for i in range(case.flights)]
    if case.rare:
        return *_draw_rare(case, rng), names
    ea, eb = [], []
    luck = case.spread / 3.0
    ratio = (1.0 + case.change_pct / 100.0) * np.exp(-(luck**2))  # E[exp(2 N(0, luck))] = exp(2 luck^2)
    for _ in range(case.flights):
        difficulty = np.exp(case.spread * rng.normal())
        common, own, other = (_ar1(case.n, case.rho, rng) for _ in range(3))
        mixed = np.sqrt(case.shared) * common
        rest = np.sqrt(1.0 - case.shared)
        ea.append(difficulty * (mixed + rest * own))
        eb.append(ratio * difficulty * np.exp(luck * rng.normal()) * (mixed + rest * other))
    return ea, eb, names


def _draw_rare(case: Case, rng: np.random.Generator) -> tuple[list[FloatArray], list[FloatArray]]:
    """Errors of a baseline that misses something, most in a few flights, and of a model that does not."""
    noise = [_ar1(case.n, case.rho, rng) for _ in range(case.flights)]
    missed = (1.0 + case.change_pct / 100.0) ** -2 - 1.0  # variance, over that of the noise
    sizes = np.sqrt(missed * np.exp(case.rare * rng.normal(size=case.flights) - 0.5 * case.rare**2))
    return [e + size * _ar1(case.n, case.rho, rng) for e, size in zip(noise, sizes, strict=True)], noise


def _ar1(n: int, rho: float, rng: np.random.Generator) -> FloatArray:
    from scipy.signal import lfilter

    settle = int(6.0 / (1.0 - rho))
    noise = np.sqrt(1.0 - rho**2) * rng.normal(size=n + settle)
    filtered: FloatArray = lfilter([1.0], [1.0, -rho], noise)[settle:]
    return filtered


def run(case: Case, repetitions: int, seed: int = 4242) -> Outcome:
    """Repeat one case; a draw that gives no interval counts as covered by "not enough data"."""
    rng = np.random.default_rng(seed)
    held, widths, below, above = [], [], 0, 0
    verdicts = dict.fromkeys(Verdict, 0)
    for i in range(repetitions):
        interval = change_interval(make_units(*draw(case, rng)), i)
        if interval is None:
            verdicts[Verdict.NOT_ENOUGH] += 1
            continue
        held.append(interval.low_pct <= case.change_pct <= interval.high_pct)
        below += case.change_pct < interval.low_pct
        above += case.change_pct > interval.high_pct
        widths.append(0.5 * (interval.high_pct - interval.low_pct))
        evidence = Evidence(1.0, 2.0, 0.0, low_pct=interval.low_pct, high_pct=interval.high_pct, p=interval.p)
        verdicts[decide(evidence)[0]] += 1
    share = 100.0 / repetitions
    return Outcome(
        coverage=100.0 * float(np.mean(held)),
        truth_below=100.0 * below / len(held),
        truth_above=100.0 * above / len(held),
        better=share * verdicts[Verdict.BETTER],
        worse=share * verdicts[Verdict.WORSE],
        half_width=float(np.median(widths)),
    )


def main() -> None:
    """Print the table."""
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 4242
    print(f"{repetitions} draws a case, seed {seed}")
    print(
        f"{'case':28s} {'true':>6s} {'covered':>8s} {'truth below':>11s} {'above':>6s} {'better':>7s} "
        f"{'worse':>6s} {'half width':>10s}"
    )
    for case in CASES:
        o = run(case, repetitions, seed)
        print(
            f"{case.name:28s} {case.change_pct:5.0f} % {o.coverage:6.1f} % {o.truth_below:9.1f} % "
            f"{o.truth_above:4.1f} % {o.better:5.1f} % {o.worse:4.1f} % "
            f"{o.half_width:8.1f} %"
        )


if __name__ == "__main__":
    main()
