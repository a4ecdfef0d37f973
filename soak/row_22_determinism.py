"""Row 22: the same fit and judgement three times, with one and with two workers: the same bytes."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.fault_trials import equal_runs


def run(_: Budget) -> Iterator[Outcome]:
    """One outcome."""
    with tempfile.TemporaryDirectory() as folder:
        yield equal_runs(Path(folder), [1, 2, 1])


CAMPAIGN = Campaign(22, "determinism over workers", run)
