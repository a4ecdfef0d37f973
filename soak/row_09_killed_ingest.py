"""Row 9: `kill -9` during ingest at 100 random points, then the same command again."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.fault_trials import killed_ingests


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome."""
    with tempfile.TemporaryDirectory() as folder:
        yield killed_ingests(Path(folder), 100, budget.clock(), seed=100)


CAMPAIGN = Campaign(9, "kill -9 during ingest", run)
