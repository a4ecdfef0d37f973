"""Row 37: whole vehicles drawn anew, half in gusts, half with link losses: what flies is found.

The seed is drawn anew unless one is given; a failure names it.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.vehicle_trials import judge

VEHICLES = 200


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome."""
    first = random.SystemRandom().randrange(1 << 30) if budget.seed is None else budget.seed
    outcome = Outcome("hidden vehicles", remark=f"first seed {first}")
    goes_on = budget.clock()
    while outcome.trials < VEHICLES and goes_on():
        seed = first + outcome.trials
        with outcome.trial():
            said = judge(seed)
        outcome.failures += [f"seed {seed}: {said}"] if said else []
    yield outcome


CAMPAIGN = Campaign(37, "whole vehicles", run)
