"""Row 28: 2,000 tables of random formats of times, units, numbers and headers: read as meant, or named."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.table_trials import trials

TABLES = 2000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome; the seed of a table that fails is named."""
    yield trials(TABLES, budget.clock())


CAMPAIGN = Campaign(28, "tables of strangers", run)
