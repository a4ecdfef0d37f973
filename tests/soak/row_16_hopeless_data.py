"""Row 16: data that cannot answer, 20 kinds by 4 structures."""

from __future__ import annotations

from collections.abc import Iterator

from tests.input_trials import hopeless_data
from tests.soak import Budget, Campaign, Outcome


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome."""
    yield hopeless_data(budget.clock())


CAMPAIGN = Campaign(16, "data that cannot answer", run)
