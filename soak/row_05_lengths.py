"""Row 5: lengths of 0, 1, 2^31, 2^32-1, 2^63 and 2^64-1, of either byte order, anywhere in a log."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from soak.readers import each_format
from tests.format_trials import length

COUNT = 6000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    return each_format(budget, lambda name, goes_on: length(name, COUNT, goes_on))


CAMPAIGN = Campaign(5, "crafted lengths", run)
