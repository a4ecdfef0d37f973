"""Row 9: `kill -9` during ingest at 100 random points, then the same command again."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.fault_trials import killed_ingests, write_logs, write_newer_logs


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome for telemetry logs, one for the newer formats and packed logs."""
    kinds = {"ingest": write_logs, "ingest, newer formats": write_newer_logs}
    names = budget.chosen(tuple(kinds))
    for name, share in zip(names, budget.shares(max(1, len(names))), strict=False):
        with tempfile.TemporaryDirectory() as folder:
            yield killed_ingests(Path(folder), 100, share.clock(), seed=100, name=name, write=kinds[name])


CAMPAIGN = Campaign(9, "kill -9 during ingest", run)
