"""Row 3: garbage and zeros of 1 to 4,096 bytes between the records of every format's sample log."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from soak.readers import each_format
from tests.format_trials import insert

INSERTIONS = 3000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    return each_format(budget, lambda name, goes_on: insert(name, INSERTIONS, goes_on))


CAMPAIGN = Campaign(3, "garbage inserted", run)
