"""Row 16: data that cannot answer: 20 kinds by 4 structures, 31 by every linear one; all by 33 sizes."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.input_trials import hopeless_data
from tests.large_trials import defaults, fits_of_sizes, sizes, structures
from tests.linear_trials import chosen, fits_of_short_segments, given, hopeless_fits


def run(budget: Budget) -> Iterator[Outcome]:
    """Five outcomes."""
    yield hopeless_data(budget.clock())
    yield hopeless_fits(given() | chosen(), budget.clock())
    yield fits_of_short_segments(given())
    yield fits_of_sizes(structures(), sizes(), budget.clock())
    yield fits_of_sizes(defaults(), sizes(), budget.clock())


CAMPAIGN = Campaign(16, "data that cannot answer", run)
