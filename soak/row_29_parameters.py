"""Row 29: 2,000 telemetry logs of several senders and both encodings of parameters: all values come back."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.parameter_trials import trials

LOGS = 2000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome; the seed of a log that fails is named."""
    yield trials(LOGS, budget.clock())


CAMPAIGN = Campaign(29, "parameters of several senders", run)
