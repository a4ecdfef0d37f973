"""Row 3: 64 bytes taken out of every format's sample log, at every place in turn."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from soak.readers import each_format
from tests.format_trials import delete

DELETIONS = 3000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    return each_format(budget, lambda name, goes_on: delete(name, DELETIONS, goes_on))


CAMPAIGN = Campaign(3, "64 bytes deleted", run)
