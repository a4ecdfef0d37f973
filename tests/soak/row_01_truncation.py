"""Row 1: the sample log of every format, cut at every byte."""

from __future__ import annotations

from collections.abc import Iterator

from tests.format_trials import FORMATS, cut, intact
from tests.soak import Budget, Campaign, Outcome, peak_memory


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    for name, share in zip(FORMATS, budget.shares(len(FORMATS)), strict=True):
        intact(name)
        memory = Outcome(name)
        with peak_memory(memory):
            outcome = cut(name, 1, share.clock())
        outcome.peak_mb = memory.peak_mb
        yield outcome


CAMPAIGN = Campaign(1, "truncation at every byte", run)
