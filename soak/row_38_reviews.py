"""Row 38: reviews of simulated flights whose logs lack streams, are thin or cut, and hold sentinels.

No section breaks, every figure is a number or has a reason, no parameter changes by more than a factor of
two. The seed is drawn anew unless one is given; a failure names it.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

from bench.faulty_sensors import fly
from soak import Budget, Campaign, Outcome
from tests.review_trials import KINDS, compare, logged, vehicles

LOGS = 500


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    seed = random.SystemRandom().randrange(1 << 40) if budget.seed is None else budget.seed
    flown = fly(vehicles(seed))
    names = budget.chosen(list(KINDS))
    for name, share in zip(names, budget.shares(len(names)), strict=True):
        rng = random.Random(seed)
        outcome = Outcome(name, remark=f"seed {seed}")
        flights = [logged(name, flight) for flight in flown]
        goes_on = share.clock()
        while outcome.trials < LOGS and goes_on():
            with outcome.trial():
                found = compare(rng.choice(flights), rng)
            outcome.failures += [f"seed {seed}, trial {outcome.trials}: {found}"] if found else []
        yield outcome


CAMPAIGN = Campaign(38, "reviews of spoilt logs", run)
