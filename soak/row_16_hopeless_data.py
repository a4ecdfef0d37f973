"""Row 16: data that cannot answer: 20 kinds by 4 structures, 31 by every linear one."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.input_trials import hopeless_data
from tests.linear_trials import chosen, fits_of_short_segments, given, hopeless_fits


def run(budget: Budget) -> Iterator[Outcome]:
    """Three outcomes."""
    yield hopeless_data(budget.clock())
    yield hopeless_fits(given() | chosen(), budget.clock())
    yield fits_of_short_segments(given())


CAMPAIGN = Campaign(16, "data that cannot answer", run)
