"""Row 34: processor time a megabyte of garbage that is dense with what records begin with, or nothing else.

The seed is drawn anew unless one is given; a failure names it.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.marked_garbage import MARKS, SECONDS_A_MB, marked, runs_of, seconds_a_mb

TRIALS = 20
SIZE = 4 << 20


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    seed = random.SystemRandom().randrange(1 << 40) if budget.seed is None else budget.seed
    names = budget.chosen(list(MARKS))
    for name, share in zip(names, budget.shares(len(names)), strict=True):
        rng = random.Random(seed)
        outcome = Outcome(name)
        goes_on = share.clock()
        spent = []
        while outcome.trials < TRIALS and goes_on():
            with outcome.trial():
                spent.append(seconds_a_mb(name, SIZE, rng, (marked, runs_of)[outcome.trials % 2]))
            if spent[-1] > SECONDS_A_MB:
                outcome.failures.append(f"seed {seed}, trial {outcome.trials}: {spent[-1]:.3f} s a MB")
        outcome.remark = f"seed {seed}; at most {max(spent, default=0.0):.3f} s of CPU a MB"
        yield outcome


CAMPAIGN = Campaign(34, "marked garbage", run)
