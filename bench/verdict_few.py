"""Few flights, true models or real fits: is the verdict right, and how often is it found?

`python -m bench.verdict_few equal [trials [seed]]`: two models that are equally good by construction (gains
of 0.9 and 1.1 on flights whose gain is 1 +- 0.1): how often one is called better or worse, by flights.
`python -m bench.verdict_few evenly [trials [seed]]`: the same where gains are spread evenly from 0.83 to
1.17, and what 5 % of the t's of so few evenly spread numbers exceed, over Student's t.
`python -m bench.verdict_few order [trials [seed]]`: gains that drift from flight to flight (AR 0.9), one
flight in six that suits the other model so well that both are equally good on all flights, and a true
difference with gains of 1.1 +- 0.03: how often better or worse is claimed, and of which flights.

`python -m bench.verdict_few rotation [plants [seed]]`: six flights of 60 s in all, every one left out once,
and everything fitted anew in every fold: ARX and TS of two rules on plants that are linear, and on nonlinear
ones where a perfect model errs 20 % less than the best linear one, or half as much. How often TS is called
better or worse, and how often the interval holds what the models compared do on 60 fresh flights: those of
the split, as `flysid fit` has them, and models of all six flights.
`python -m bench.verdict_few searched [plants [seed]]`: the same with orders, baseline and rules as `flysid
fit` searches for them, for the models of the split.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.special import stdtrit

from bench.verdict_fairness import DT_S, Plant, fit_as_flysid, flights, linear_plant, nonlinear_plant
from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.ts import TS, over_lags
from flysid.split import plan_folds, plan_split
from flysid.validate.compare.comparison import Pair
from flysid.validate.compare.intervals import Scope, change
from flysid.validate.compare.models import Turn
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare.verdict import Evidence, Verdict, decide
from flysid.validate.compare_models import compare
from tests.fakes import FirstOrder

POLE = 0.9
DRIFT = 0.9
TYPICAL = 1.021
"""Gain of five flights in six, where the sixth has 0.9 and both models are equally good on all."""
IN_ORDER = ("drift", "one in six odd", "a true difference")
FLIGHTS = (2, 3, 4, 5, 6, 8, 12)
DRAWS = 10_000_000
IN_ALL = 6
ROWS = 1200  # 60 s
FRESH = 60


def flight_of(gain: float, rows: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Inputs and outputs of a first-order loop with a gain, and white noise of 2 %."""
    u = np.repeat(rng.normal(size=rows // 20 + 1), 20)[:rows]
    y = lfilter([0.0, gain * (1.0 - POLE)], [1.0, -POLE], u)
    return u[:, None], (y + 0.02 * rng.normal(size=rows))[:, None]


def equal_verdict(flights_held: int, rows: int, rng: np.random.Generator, spread: float = 0.1) -> Pair:
    """What is said of two models whose gains are as far off the flights' mean, one above and one below."""
    arrays = [flight_of(1.0 + spread * rng.normal(), rows, rng) for _ in range(flights_held)]
    data = Dataset.from_arrays([u for u, _ in arrays], [y for _, y in arrays], DT_S)
    low, high = (FirstOrder(a=POLE, b=gain * (1.0 - POLE), dt_s=DT_S) for gain in (0.9, 1.1))
    named = {"arx": low, "ts": replace(high, structure="ts", labels=("R1", "R2"))}
    return compare(named, data, horizons=[FREE_RUN]).verdict["y"]


def equal(trials: int, seed: int) -> Iterator[str]:
    """A line per number of flights and their length."""
    for rows in (600, 10_000):
        for count in FLIGHTS:
            rng = np.random.default_rng((seed, count, rows))
            wrong = sum(told_apart(1.0 + 0.1 * rng.normal(size=count), rows, rng) for _ in range(trials))
            yield f"{count:2d} flights of {rows * DT_S:3.0f} s: {wrong} of {trials} called better or worse"


def evenly(trials: int, seed: int) -> Iterator[str]:
    """A line per number of flights, then one per number of evenly spread numbers."""
    for count in FLIGHTS:
        rng = np.random.default_rng((seed, count))
        wrong = sum(told_apart(rng.uniform(0.83, 1.17, count), 600, rng) for _ in range(trials))
        yield f"{count:2d} flights of 30 s: {wrong} of {trials} called better or worse"
    rng = np.random.default_rng(seed)
    for count in range(2, 13):
        ratio = np.mean([_quantile(rng.random((DRAWS // 10, count)) - 0.5) for _ in range(10)])
        yield f"{count:2d} numbers: {ratio / stdtrit(count - 1, 0.975):.3f} times Student's t"


def order(trials: int, seed: int) -> Iterator[str]:
    """A line per way in which flights differ and number of flights."""
    for kind in IN_ORDER:
        for count in (2, 3, 4, 6, 10, 20, 40):
            rng = np.random.default_rng((seed, count))
            claims = Counter(claim(draw_gains(kind, count, rng), 600, rng) for _ in range(trials))
            said = ", ".join(f"{number} of {scope}" for scope, number in claims.items() if scope)
            yield f"{kind}, {count:2d} flights: better or worse in {said or 'none'}; of {trials}"


def draw_gains(kind: str, count: int, rng: np.random.Generator) -> FloatArray:
    """(count,) gains of flights in order, of a kind of IN_ORDER."""
    if kind == "drift":
        kicks = rng.normal(size=count) * np.append(1.0, np.full(count - 1, np.sqrt(1.0 - DRIFT**2)))
        return np.asarray(1.0 + 0.1 * lfilter([1.0], [1.0, -DRIFT], kicks))
    if kind == "one in six odd":
        return np.where(rng.random(count) < 1.0 / 6.0, 0.9, TYPICAL) + 0.01 * rng.normal(size=count)
    return 1.1 + 0.03 * rng.normal(size=count)


def told_apart(gains: FloatArray, rows: int, rng: np.random.Generator) -> bool:
    """Whether one of the models of gains 0.9 and 1.1 is called better on flights of these gains."""
    return claim(gains, rows, rng) is not None


def claim(gains: FloatArray, rows: int, rng: np.random.Generator) -> Scope | None:
    """Of which flights one of the models of gains 0.9 and 1.1 is called better; None where of none."""
    low = []
    high = []
    for gain in gains:
        u, y = flight_of(gain, rows, rng)
        run = lfilter([0.0, 1.0 - POLE], [1.0, -POLE], u, axis=0)
        low.append((y - 0.9 * run)[:, 0])
        high.append((y - 1.1 * run)[:, 0])
    found = change(low, high, [str(i) for i in range(len(gains))])
    assert found.interval is not None
    ends = found.interval.low_pct, found.interval.high_pct
    evidence = Evidence(1.0, 2.0, 0.0, low_pct=ends[0], high_pct=ends[1], p=found.interval.p)
    return found.scope if decide(evidence)[0] in (Verdict.BETTER, Verdict.WORSE) else None


def _quantile(values: FloatArray) -> float:
    """What 5 % of the t's of the rows (N, n) exceed, either way."""
    t = values.mean(axis=1) / values.std(axis=1, ddof=1) * np.sqrt(values.shape[1])
    return float(np.quantile(np.abs(t), 0.95))


@dataclass(frozen=True)
class Judged:
    """What rotation said of the models of one plant, and what these do on fresh flights."""

    pair: Pair
    truth: float | None

    @property
    def held(self) -> bool:
        return self.pair.ci95 is not None and self.pair.ci95[0] <= (self.truth or 0.0) <= self.pair.ci95[1]


Fits = Callable[[Dataset, str | None], tuple[dict[str, Fitted], str]]
"""Training data, and the baseline where it is known -> models, and the baseline."""


def judge_in_turn(plant: Plant, rng: np.random.Generator, fits: Fits, *, of_all: bool) -> dict[str, Judged]:
    """Six flights, each left out once, for the models of the split, and of all flights."""
    data = flights(plant, IN_ALL, rng, "t", ROWS)
    fresh = flights(plant, FRESH, rng, "f", ROWS)
    fitted = {"split": plan_split(data).apply(data)[0]} | ({"all six": data} if of_all else {})
    models, base = fits(fitted["split"], None)
    compared = {"split": models} | ({"all six": fits(data, base)[0]} if of_all else {})
    folds = [
        (fits(train, base)[0], train, test) for train, test in (s.apply(data) for s in plan_folds(data, 5))
    ]
    found = {}
    for name, some in compared.items():
        known = fitted[name].flights
        turns = [
            Turn(own, test, train.with_segments([s for s in train.segments if s.flight in known]))
            for own, train, test in folds
        ]
        pair = compare(some, fresh, horizons=[FREE_RUN], baseline=base, turns=turns).verdict["y"]
        truth = compare(some, fresh, horizons=[FREE_RUN], baseline=base).verdict["y"]
        found[name] = Judged(pair, truth.change_pct)
    return found


def two_rules(train: Dataset, base: str | None) -> tuple[dict[str, Fitted], str]:
    """ARX of order 3, and TS of two rules over two lags."""
    linear = ARX(na=3, nb=3, nk=1).fit(train)
    return {"arx": linear, "ts": over_lags(TS(rules=2, na=2, nb=2, nk=1), train)}, base or "arx"


def rotation(plants: int, seed: int, fits: Fits = two_rules, *, of_all: bool = True) -> Iterator[str]:
    """A line per kind of plant and models compared."""
    for kind, gain in (("linear", 1.0), ("a fifth better", 0.8), ("half", 0.5)):
        found: dict[str, list[Judged]] = {}
        for i in range(plants):
            rng = np.random.default_rng((seed, i))
            plant = linear_plant(rng) if kind == "linear" else nonlinear_plant(rng, gain)
            try:
                for name, judged in judge_in_turn(plant, rng, fits, of_all=of_all).items():
                    found.setdefault(name, []).append(judged)
            except FlysidError as error:
                print(f"{kind}, plant {i}: {error}", file=sys.stderr)
        yield from (f"{kind}, models of {name}: {_counts(those)}" for name, those in found.items())


def searched(plants: int, seed: int) -> Iterator[str]:
    """A line per kind of plant."""
    yield from rotation(plants, seed, fit_as_flysid, of_all=False)


def _counts(found: list[Judged]) -> str:
    verdicts = [str(j.pair.verdict) for j in found]
    judged = [j for j in found if j.truth is not None and j.pair.ci95 is not None]
    counts = ", ".join(f"{v} {verdicts.count(v)}" for v in Verdict)
    width = np.median([np.subtract(*j.pair.ci95[::-1]) for j in judged if j.pair.ci95])
    truth = np.median([j.truth for j in judged if j.truth is not None])
    wrong = sum(j.pair.verdict is Verdict.BETTER and (j.truth or 0.0) > 0.0 for j in judged)
    return (
        f"{counts} of {len(found)}; better where it is worse {wrong}; holds the truth "
        f"{sum(j.held for j in judged)} of {len(judged)}; median truth {truth:+.0f} %, width {width:.0f} %"
    )


def main() -> None:
    """Print the lines of the trial asked for."""
    kind = sys.argv[1] if len(sys.argv) > 1 else "equal"
    trials: dict[str, Callable[[int, int], Iterator[str]]]
    trials = {"equal": equal, "evenly": evenly, "order": order, "rotation": rotation, "searched": searched}
    count = int(sys.argv[2]) if len(sys.argv) > 2 else (20 if trials[kind] in (rotation, searched) else 200)
    seed = int(sys.argv[3]) if len(sys.argv) > 3 else 4242
    print(f"{kind}, {count} each, seed {seed}")
    for line in trials[kind](count, seed):
        print(line, flush=True)


if __name__ == "__main__":
    main()
