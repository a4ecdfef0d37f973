"""Row 33: 2,000 telemetry logs whose losses are known: reading and recording count the true ones."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.loss_trials import trials

LOGS = 2000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome; the seed of a log that is counted wrong is named."""
    yield trials(LOGS, budget.clock())


CAMPAIGN = Campaign(33, "losses of links", run)
