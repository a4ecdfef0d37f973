"""Row 41: 2,000 blackbox logs of INAV, EmuFlight and Rotorflight: every number written comes back."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.blackbox_trials import trials

LOGS = 2000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome; the seed of a log that is read otherwise is named."""
    yield trials(LOGS, budget.clock())


CAMPAIGN = Campaign(41, "logs of Betaflight's relatives", run)
