"""How often the interval holds the truth, and how often the verdict is right, where the truth is known.

Errors of two models are drawn as AR(1) processes whose change is known, in flights of different difficulty,
and each model has its own luck in every flight. `python -m bench.verdict_coverage [repetitions [seed
[kind]]]` prints one line per case, of one kind or of all: flights first, then single flights. The truth is
the change on a typical flight (geometric mean), or of the process of the one flight there is. The numbers of
`validate/compare/intervals.py` were chosen on draws of another program; docs/measured/verdicts.md names the
seeds that its figures rest on.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from flysid.dataset import FloatArray
from flysid.validate.compare.intervals import change
from flysid.validate.compare.verdict import Evidence, Verdict, decide

FLIGHTS = (2, 3, 4, 5, 6, 8, 12, 30)
LUCK = (0.0, 0.15, 0.3)
KINDS = ("alike", "one in ten", "drift", "regimes", "rarely better")
RARELY_PCT = 100.0 * (
    3.0**-0.1 - 1.0
)  # makes up, on a typical flight, for every tenth being three times worse
MISSED = 0.75  # share of its error that a "rarely better" baseline misses, in variances of the noise


@dataclass(frozen=True)
class Case:
    """Flights of n samples each.

    Attributes
    ----------
    rho : correlation of an error from one sample to the next; `rho_base` that of the baseline.
    luck : standard deviation of the logarithm of each model's own luck in a flight.
    kind : one of KINDS: every tenth flight three times worse for the model; its error grows fourfold over a
        flight; a third of every flight is three times rougher for both; the baseline misses something,
        most in a few flights.
    change_pct : true change from the baseline to the model beside that of the kind.
    """

    flights: int
    n: int = 900
    rho: float = 0.95
    rho_base: float | None = None
    luck: float = 0.0
    kind: str = "alike"
    change_pct: float = 0.0

    def __str__(self) -> str:
        if self.flights == 1:
            return (
                f"1 flight of {self.n}, {self.kind}, rho {self.rho:g}, baseline {self.rho_base or self.rho:g}"
            )
        return f"{self.flights} flights, {self.kind}, luck {self.luck:g}"

    @property
    def truth(self) -> float:
        """The change on a typical flight, as a log ratio."""
        theta = float(np.log1p(self.change_pct / 100.0))
        if self.kind == "one in ten":
            return theta + 0.1 * float(np.log(3.0))
        if self.kind == "drift":
            return theta + 0.5 * float(np.log(np.mean(np.linspace(0.5, 2.0, self.n) ** 2)))
        if self.kind == "rarely better":
            return theta - 0.5 * _typical_miss()
        return theta


@dataclass(frozen=True)
class Outcome:
    """Percent: the interval holds the truth; false verdicts; better and worse; median half width."""

    coverage: float
    false: float
    better: float
    worse: float
    half_width: float


def _missed(rng: np.random.Generator, size: int) -> FloatArray:
    return np.asarray(MISSED * np.exp(0.6 * rng.normal(size=size) - 0.18))


def _typical_miss() -> float:
    """Mean over flights of log(1 + what is missed)."""
    return float(np.mean(np.log1p(_missed(np.random.default_rng(0), 1_000_000))))


def draw(case: Case, rng: np.random.Generator) -> tuple[list[FloatArray], list[FloatArray], list[str]]:
    """Errors of baseline and model, and the flight of each."""
    ea = []
    eb = []
    missed = _missed(rng, case.flights)
    for i in range(case.flights):
        rough = np.exp(0.3 * rng.normal()) * np.ones(case.n)
        if case.kind == "regimes":
            at = int(rng.integers(0, 2 * case.n // 3))
            rough[at : at + case.n // 3] *= 3.0
        common, rest = (_ar1(case.n, case.rho, rng) for _ in range(2))
        own = _ar1(case.n, case.rho_base or case.rho, rng)
        shared = np.sqrt(0.5) * common if case.rho_base is None else 0.0
        weight = np.sqrt(0.5) if case.rho_base is None else 1.0
        a, b = (rough * np.exp(case.luck * rng.normal()) * (shared + weight * e) for e in (own, rest))
        if case.kind == "rarely better":
            a = np.sqrt(1.0 + missed[i]) * a
        if case.kind == "one in ten" and rng.random() < 0.1:
            b = 3.0 * b
        if case.kind == "drift":
            b = np.linspace(0.5, 2.0, case.n) * b
        ea.append(a)
        eb.append((1.0 + case.change_pct / 100.0) * b)
    return ea, eb, [f"f{i}" for i in range(case.flights)]


def _ar1(n: int, rho: float, rng: np.random.Generator) -> FloatArray:
    settle = int(6.0 / (1.0 - rho))
    noise = np.sqrt(1.0 - rho**2) * rng.normal(size=n + settle)
    return np.asarray(lfilter([1.0], [1.0, -rho], noise)[settle:])


def run(case: Case, repetitions: int, seed: int = 4242) -> Outcome:
    """Repeat one case."""
    rng = np.random.default_rng(seed)
    truth = round(100.0 * float(np.expm1(case.truth)), 9)
    held = 0
    widths = []
    verdicts = dict.fromkeys(Verdict, 0)
    for _ in range(repetitions):
        found = change(*draw(case, rng)).interval
        assert found is not None
        held += found.low_pct <= truth <= found.high_pct
        low, high = (np.log1p(v / 100.0) for v in (found.low_pct, found.high_pct))
        widths.append(100.0 * np.sinh(0.5 * (high - low)))
        evidence = Evidence(1.0, 2.0, 0.0, low_pct=found.low_pct, high_pct=found.high_pct, p=found.p)
        verdicts[decide(evidence)[0]] += 1
    share = 100.0 / repetitions
    wrong = {Verdict.BETTER} if truth > 0.0 else {Verdict.WORSE} if truth < 0.0 else set()
    wrong = wrong or {Verdict.BETTER, Verdict.WORSE}
    return Outcome(
        coverage=share * held,
        false=share * sum(verdicts[v] for v in wrong),
        better=share * verdicts[Verdict.BETTER],
        worse=share * verdicts[Verdict.WORSE],
        half_width=float(np.median(widths)),
    )


def flight_cases() -> Iterator[Case]:
    """Every kind and luck at every number of flights; a rare flight that leaves the typical one unchanged;
    then a fifth and a half less error."""
    for kind in KINDS:
        for luck in LUCK if kind == "alike" else (0.15,):
            for flights in FLIGHTS:
                yield Case(flights, luck=luck, kind=kind)
    for flights in FLIGHTS:
        yield Case(flights, luck=0.15, kind="one in ten", change_pct=RARELY_PCT)
    for percent in (-20.0, -50.0):
        for luck in LUCK:
            for flights in FLIGHTS:
                yield Case(flights, luck=luck, change_pct=percent)


def single_cases() -> Iterator[Case]:
    """One flight; errors alike, a baseline whose error is slow, a rough third."""
    for n, rho, base in (
        (500, 0.9, None), (500, 0.98, None), (5000, 0.995, None), (5000, 0.999, None), (2000, 0.999, None),
        (500, 0.9, 0.98), (5000, 0.9, 0.995), (2000, 0.9, 0.999),
    ):  # fmt: skip
        for percent in (0.0, -50.0, -90.0):
            yield Case(1, n, rho, base, change_pct=percent)
    yield Case(1, 2000, 0.995, kind="regimes")


def main() -> None:
    """Print the table."""
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 4242
    kinds = sys.argv[3:4] or KINDS
    print(f"{repetitions} draws a case, seed {seed}; half width of the interval of the log ratio, in percent")
    print(
        f"{'case':58s} {'true':>7s} {'covered':>8s} {'false':>7s} {'better':>8s} {'worse':>7s} {'half':>7s}"
    )
    for case in (c for c in (*flight_cases(), *single_cases()) if c.kind in kinds):
        o = run(case, repetitions, seed)
        print(
            f"{case!s:58s} {100.0 * np.expm1(case.truth):5.0f} % {o.coverage:6.1f} % {o.false:5.1f} % "
            f"{o.better:6.1f} % {o.worse:5.1f} % {o.half_width:5.0f} %",
            flush=True,
        )


if __name__ == "__main__":
    main()
