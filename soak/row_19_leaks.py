"""Row 19: copies of training flights among the held-out."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.input_trials import leaks


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome; 200 datasets."""
    yield leaks(200, budget.clock(), seed=19)


CAMPAIGN = Campaign(19, "copied flights", run)
