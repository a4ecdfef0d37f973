"""Row 32: 10,000 logs whose messages belong to several things: no row lost, invented or mixed.

A failure names its seed. `--seed N` begins at seed N: a campaign that was stopped goes on from there.
"""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.keyed_trials import trials

LOGS = 10_000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome for all logs."""
    first = budget.seed or 0
    yield trials(LOGS - first, budget.clock(), first)


CAMPAIGN = Campaign(32, "logs with keyed rows", run)
