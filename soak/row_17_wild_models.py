"""Row 17: models made unstable, or fed 100 to 10^6 times their range."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.input_trials import wild_models


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome; 1,000 models."""
    yield wild_models(1000, budget.clock(), seed=17)


CAMPAIGN = Campaign(17, "unstable and out of range", run)
