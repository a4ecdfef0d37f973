"""Rules that are not kept: what would have been delivered?  python -m bench.unproven_rules N FIRST

Three rules are grown on N records a kind, whether they pay or not, and the last question before a delivery
is asked of them: is their advantage over the linear model, on held-out parts of the training data, beyond its
noise, and do they stay within limits there? Records of short flights: a linear lag in two flights under a
wind that drifts as fast as the vehicle answers; in four, of which one flies three times as large inputs; and
four of a vehicle with drag, which rules are right for. Of those given up and of those kept: the error over
the linear model's on ten fresh flights, and how often they run away there.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from bench.verdict_fairness import fly_with_drag
from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.one_rule import linear_choice, linear_rivals
from flysid.model.rules.contest import parts_to_compare_on, unproven
from flysid.model.rules.learning import over_lags
from flysid.model.rules.search_settings import EFFORTS
from flysid.model.ts import TS
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare_models import compare

DT_S = 0.05
ROWS = 150
FRESH = 10
RULES = 3
KINDS = {
    "linear, drifting wind": (1.0, 1.0),
    "linear, one flight three times as large": (1.0, 1.0, 1.0, 3.0),
    "drag": (2.0, 2.0, 2.0, 2.0),
}
"""Sizes of the inputs of the flights to train on."""
AWAY = "went to its limits"


def flown(kind: str, sizes: Sequence[float], rng: np.random.Generator) -> Dataset:
    """Flights of 150 samples; wind of about a third of the answer's size, a tenth of it under drag."""
    us, ys = [], []
    for size in sizes:
        u = size * np.repeat(rng.uniform(-1.0, 1.0, ROWS // 10 + 1), 10)[:ROWS]
        wind = 0.1 * lfilter([1.0], [1.0, -0.95], rng.normal(size=ROWS))
        us.append(u)
        ys.append(fly_with_drag(u, 2.0) + 0.1 * wind if kind == "drag" else answer(u) + wind)
    return Dataset.from_arrays(us, ys, DT_S)


def answer(u: FloatArray) -> FloatArray:
    """Two poles."""
    return np.asarray(lfilter([0.0, 0.06], [1.0, -1.5, 0.56], u))


@dataclass(frozen=True)
class Outcome:
    """What became of the rules of one record.

    Attributes
    ----------
    given_up : why, in the search's words; "" where they were kept.
    ratio : error of the rules over the linear model's on fresh flights, of a typical flight; None where
        either ran away.
    ran_away : the rules did, and the linear model did not.
    """

    given_up: str
    ratio: float | None
    ran_away: bool


def outcome(kind: str, seed: int) -> Outcome:
    """Of one record."""
    rng = np.random.default_rng(seed)
    sizes = KINDS[kind]
    train = flown(kind, sizes, rng)
    search = EFFORTS["quick"]
    found = over_lags(TS(rules=RULES, search=search), train, None, linear_choice)
    choice = linear_choice(TS(search=search), train, None)
    assert choice is not None
    label, linear = choice
    again = linear_rivals(search=search)[label]
    parts = parts_to_compare_on(train, None, found.least)
    given_up = unproven(again.fit, found.again, parts)
    models = {"linear": linear, "rules": found.bare}
    fresh = flown(kind, [max(sizes)] * FRESH, rng)
    pair = compare(models, fresh, horizons=[FREE_RUN], baseline="linear").verdict["y"]
    e = pair.evidence
    lost = e.diverged_model or e.diverged_baseline
    ratio = None if lost or pair.change_pct is None else 1.0 + pair.change_pct / 100.0
    return Outcome(given_up, ratio, e.diverged_model and not e.diverged_baseline)


def lines(count: int, first: int) -> Iterator[str]:
    """Some lines per kind of record."""
    for kind in KINDS:
        found: list[Outcome] = []
        for seed in range(first, first + count):
            try:
                found.append(outcome(kind, seed))
            except FlysidError as error:
                print(f"{kind}, {seed}: {error.message}", file=sys.stderr)
        away = [o for o in found if AWAY in o.given_up]
        noise = [o for o in found if o.given_up and AWAY not in o.given_up]
        yield f"{kind}, {len(found)} records"
        yield f"  given up, as they ran away on a held-out part: {_told(away)}"
        yield f"  given up, as their advantage was within its noise: {_told(noise)}"
        yield f"  kept: {_told([o for o in found if not o.given_up])}"


def _told(some: Sequence[Outcome]) -> str:
    """How many, and what they do on fresh flights."""
    ratios = [o.ratio for o in some if o.ratio is not None]
    said = f"{len(some)}; on fresh flights they alone run away in {sum(o.ran_away for o in some)}"
    if not ratios:
        return said
    worse = sum(r > 1.0 for r in ratios)
    span = f"{min(ratios):.2f} to {max(ratios):.2f}"
    return (
        f"{said}, else err {np.median(ratios):.2f} times the linear model's (median; {span}), more in {worse}"
    )


def main(words: list[str]) -> int:
    """Print the lines."""
    count, first = map(int, words)
    for line in lines(count, first):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
