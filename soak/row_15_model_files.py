"""Row 15: hostile model files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome, peak_memory
from tests.input_trials import hostile_models


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome; 5,000 files."""
    memory = Outcome("")
    with tempfile.TemporaryDirectory() as folder, peak_memory(memory):
        outcome = hostile_models(Path(folder), 5000, budget.clock(), seed=15)
    outcome.peak_mb = memory.peak_mb
    yield outcome


CAMPAIGN = Campaign(15, "hostile model files", run)
