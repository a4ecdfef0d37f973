"""Sets of gains that are alike, flown in flights that are not: how often a difference is called clear.

`python -m bench.flight_scatter [TRIALS] [SEED]`

In every trial two to four sets fly one to three times each, a minute a flight, under the same controller.
A flight's vehicle has its own gain, lag and delay around those of the trial. A trial is false where
the best phase margin or bandwidth is called clear ("clear"), or where any two sets part in any figure
("apart"). Both are counted by the intervals between flights, and by those of the stretches within a set.
"""

from __future__ import annotations

import secrets
import sys
from collections import Counter
from dataclasses import replace
from itertools import combinations

import numpy as np

from flysid.loops.contradictions import contradiction_of
from flysid.loops.gain_sets import differences
from flysid.loops.judged import Judged, find_margins
from flysid.loops.margins import Figure, Margins, margins
from flysid.loops.stick_response import Loop
from tests.drawn import SEEDS
from tests.flysid.loops.simulated import PID, Vehicle, fly

FLIGHT_S = 60.0


def fly_sets(seed: int) -> list[Judged]:
    """The sets of one trial, judged."""
    rng = np.random.default_rng(seed)
    scatter = rng.uniform(0.05, 0.25)
    gain, lag_s = rng.uniform(45.0, 100.0), rng.uniform(0.012, 0.03)
    sets = []
    for k in range(int(rng.integers(2, 5))):
        records = [
            fly(
                Vehicle(
                    gain * rng.lognormal(0.0, scatter),
                    lag_s * rng.lognormal(0.0, scatter),
                    int(rng.integers(6, 11)),
                ),
                PID,
                FLIGHT_S,
                int(rng.integers(2**31)),
            )
            for _ in range(int(rng.integers(1, 4)))
        ]
        names = tuple(record.name for record in records)
        gains = {"rollPID P": 46.0, "I": float(k)}
        sets.append(Judged("roll", names, gains, miss=0.0, loop=Loop.of(records), controller=PID))
    return find_margins(sets)


def within_stretches(judged: Judged) -> Judged:
    """The same set by the scatter of its stretches alone."""
    if judged.loop is None or judged.margins is None:
        return judged
    own = margins(judged.loop, PID)
    return replace(judged, margins=own, across=own)


def _figures(m: Margins | None) -> dict[str, Figure]:
    return {name: value for name, value in vars(m).items() if isinstance(value, Figure)} if m else {}


def parts(one: Judged, other: Judged) -> bool:
    """Whether the intervals of any figure part two sets."""
    mine, theirs = _figures(one.across), _figures(other.across)
    both = [(mine[name], theirs[name]) for name in mine if name in theirs]
    return any(a.low > b.high or b.low > a.high for a, b in both)


def main() -> None:
    """Print the counts."""
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    first = int(sys.argv[2]) if len(sys.argv) > 2 else secrets.randbelow(SEEDS)
    counts: Counter[str] = Counter()
    for seed in range(first, first + trials):
        across = fly_sets(seed)
        for words, found in (("across", across), ("within", [within_stretches(j) for j in across])):
            counts[f"{words}: clear"] += any("clearly" in line for line in differences(found))
            counts[f"{words}: apart"] += any(parts(*pair) for pair in combinations(found, 2))
            counts[f"{words}: figures"] += sum(
                f.value is not None for j in found for f in _figures(j.across).values()
            )
        counts["contradictions"] += any(contradiction_of(j, across) for j in across)
        counts["sets"] += len(across)
    print(f"{trials} trials from seed {first}: {dict(counts)}")


if __name__ == "__main__":
    main()
