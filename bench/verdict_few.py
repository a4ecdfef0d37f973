"""Few flights, true models or real fits: is the verdict right, and how often is it found?

`python -m bench.verdict_few equal [trials [seed]]`: two models that are equally good by construction (gains
of 0.9 and 1.1 on flights whose gain is 1 +- 0.1): how often one is called better or worse, by flights.

`python -m bench.verdict_few rotation [plants [seed]]`: six flights of 60 s in all, every one left out once,
and everything fitted anew in every fold: ARX and TS of two rules on plants that are linear, and on nonlinear
ones where a perfect model errs 20 % less than the best linear one, or half as much. How often TS is called
better or worse, and how often the interval holds what both models, fitted to all six, do on 60 fresh flights.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from bench.verdict_fairness import DT_S, Plant, flights, linear_plant, nonlinear_plant
from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.ts import TS
from flysid.split import plan_folds
from flysid.validate.compare_models import Turn, compare
from flysid.validate.comparison import Pair
from flysid.validate.trials import FREE_RUN
from flysid.validate.verdict import Verdict
from tests.fakes import FirstOrder

POLE = 0.9
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
        for count in (1, 2, 3, 4, 5, 8, 12):
            rng = np.random.default_rng((seed, count, rows))
            said = [equal_verdict(count, rows, rng) for _ in range(trials)]
            wrong = sum(p.verdict in (Verdict.BETTER, Verdict.WORSE) for p in said)
            what = f"{count:2d} flights of {rows * DT_S:3.0f} s, scope {said[0].scope}"
            yield f"{what}: {wrong} of {trials} called better or worse"


@dataclass(frozen=True)
class Judged:
    """What rotation said of one plant, and what both models do on fresh flights."""

    pair: Pair
    truth: float | None

    @property
    def held(self) -> bool:
        return self.pair.ci95 is not None and self.pair.ci95[0] <= (self.truth or 0.0) <= self.pair.ci95[1]


def rotated(plant: Plant, rng: np.random.Generator) -> Judged:
    """Six flights, each left out once."""
    data = flights(plant, IN_ALL, rng, "t", ROWS)
    turns = [Turn(_fits(train), test) for train, test in (s.apply(data) for s in plan_folds(data, 5))]
    fresh = flights(plant, FRESH, rng, "f", ROWS)
    models = _fits(data)
    pair = compare(models, fresh, horizons=[FREE_RUN], turns=turns).verdict["y"]
    return Judged(pair, compare(models, fresh, horizons=[FREE_RUN]).verdict["y"].change_pct)


def _fits(train: Dataset) -> dict[str, Fitted]:
    linear = ARX(na=3, nb=3, nk=1).fit(train)
    return {"arx": linear, "ts": TS(rules=2, na=2, nb=2, nk=1).fit(train)}


def rotation(plants: int, seed: int) -> Iterator[str]:
    """A line per kind of plant."""
    for kind, gain in (("linear", 1.0), ("a fifth better", 0.8), ("half", 0.5)):
        found: list[Judged] = []
        for i in range(plants):
            rng = np.random.default_rng((seed, i))
            plant = linear_plant(rng) if kind == "linear" else nonlinear_plant(rng, gain)
            try:
                found.append(rotated(plant, rng))
            except FlysidError as error:
                print(f"{kind}, plant {i}: {error}", file=sys.stderr)
        verdicts = [str(j.pair.verdict) for j in found]
        judged = [j for j in found if j.truth is not None and j.pair.ci95 is not None]
        counts = ", ".join(f"{v} {verdicts.count(v)}" for v in Verdict)
        width = np.median([np.subtract(*j.pair.ci95[::-1]) for j in judged if j.pair.ci95])
        truth = np.median([j.truth for j in judged if j.truth is not None])
        yield (
            f"{kind}: {counts} of {len(found)}; holds the truth {sum(j.held for j in judged)} of "
            f"{len(judged)}; median truth {truth:+.0f} %, width {width:.0f} %"
        )


def main() -> None:
    """Print the lines of the trial asked for."""
    kind = sys.argv[1] if len(sys.argv) > 1 else "equal"
    count = int(sys.argv[2]) if len(sys.argv) > 2 else (200 if kind == "equal" else 20)
    seed = int(sys.argv[3]) if len(sys.argv) > 3 else 4242
    print(f"{kind}, {count} each, seed {seed}")
    for line in (equal if kind == "equal" else rotation)(count, seed):
        print(line, flush=True)


if __name__ == "__main__":
    main()
