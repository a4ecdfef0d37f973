"""Row 10: `kill -9` during fit and validate, 25 times each, in place of an older output."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.fault_trials import killed_fits, killed_validations


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per verb."""
    for share, trials in zip(budget.shares(2), (killed_fits, killed_validations), strict=True):
        with tempfile.TemporaryDirectory() as folder:
            yield trials(Path(folder), 25, share.clock())


CAMPAIGN = Campaign(10, "kill -9 during fit, validate", run)
