"""Row 16: every structure on 1 to 3,000,000 samples in up to 10,000 segments, 50 inputs, offsets of 1e9."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.large_trials import defaults, fits_of_sizes, sizes, structures


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per structure."""
    estimators = structures() | defaults()
    names = budget.chosen(list(estimators))
    for name, share in zip(names, budget.shares(max(1, len(names))), strict=True):
        yield fits_of_sizes(name, estimators[name], sizes(), share.clock())


CAMPAIGN = Campaign(16, "fits of unusual sizes", run)
