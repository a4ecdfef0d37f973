"""Row 35: recordings that were split at random, with and without their list, some with a file taken away.

Every file reads as the whole recording, what is taken away is named, and flights beside them stay apart.
The seed is drawn anew unless one is given; a failure names it.
"""

from __future__ import annotations

import random
import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.split_recordings import MAKERS, compare

RECORDINGS = 300


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per kind of file."""
    seed = random.SystemRandom().randrange(1 << 40) if budget.seed is None else budget.seed
    names = budget.chosen(list(MAKERS))
    for name, share in zip(names, budget.shares(len(names)), strict=True):
        rng = random.Random(seed)
        outcome = Outcome(name, remark=f"seed {seed}")
        goes_on = share.clock()
        with tempfile.TemporaryDirectory() as folder:
            while outcome.trials < RECORDINGS and goes_on():
                with outcome.trial():
                    place = Path(folder) / str(outcome.trials)
                    said = compare(place, name, rng)
                outcome.failures += [f"seed {seed}, trial {outcome.trials}: {said}"] if said else []
        yield outcome


CAMPAIGN = Campaign(35, "split recordings", run)
