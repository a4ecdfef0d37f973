"""Row 31: ROS 2 bags whose recorder was killed at random moments, read as SQLite reads a copy of them.

SQLite itself writes them, with a write-ahead log or a journal; of four in ten a side file is damaged then.
The seeds are fixed: a failure names its own.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.killed_bags import compare

BAGS = 2000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome for all bags."""
    outcome = Outcome("killed recorders")
    goes_on = budget.clock()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(BAGS):
            if not goes_on():
                break
            with outcome.trial():
                try:
                    said = compare(Path(folder), seed)
                except Exception as error:  # noqa: BLE001 - this is what the trials look for
                    said = f"seed {seed}: {type(error).__name__}: {error}"
            outcome.failures += [said] if said else []
            for left in Path(folder).iterdir():
                left.unlink()
    yield outcome


CAMPAIGN = Campaign(31, "bags of killed recorders", run)
