"""Row 1: the sample log of every format, cut at every byte."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from soak.readers import each_format
from tests.format_trials import cut


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    return each_format(budget, lambda name, goes_on: cut(name, 1, goes_on))


CAMPAIGN = Campaign(1, "truncation at every byte", run)
