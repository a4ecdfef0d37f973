"""Row 2: single bits of every format's sample log flipped."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from soak.readers import each_format
from tests.format_trials import flip

FLIPS = 10_000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    return each_format(budget, lambda name, goes_on: flip(name, FLIPS, goes_on))


CAMPAIGN = Campaign(2, "single-bit flips", run)
