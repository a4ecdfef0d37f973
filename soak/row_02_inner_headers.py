"""Row 2: headers planted inside the messages of sound DataFlash logs, random ones and real ones."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.ingest.formats.test_dataflash import LOGS
from tests.inner_headers import plant_headers, plant_in_log

LOGS_OF_RANDOM_FORMATS = 10_000
IN_A_REAL_LOG = 1000


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome for the random logs, one per real log."""
    real = sorted(LOGS.iterdir()) if LOGS.is_dir() else []
    first, *rest = budget.shares(1 + len(real))
    yield plant_headers(LOGS_OF_RANDOM_FORMATS, first.clock())
    for path, share in zip(real, rest, strict=True):
        yield plant_in_log(path, IN_A_REAL_LOG, share.clock())


CAMPAIGN = Campaign(2, "headers inside messages", run)
