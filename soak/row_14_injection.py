"""Row 14: strings that want to be code, in every field that can reach a report; then in a browser."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.injection_trials import browsed, injections

TEXTS = 200


def run(budget: Budget) -> Iterator[Outcome]:
    """The plain check, and chromium where there is one (a part of the pages)."""
    plain, browser = budget.shares(2)
    with tempfile.TemporaryDirectory() as folder:
        yield injections(plain.clock(), TEXTS, pages=Path(folder))
        yield browsed(Path(folder), browser.clock()) or Outcome(
            "strings in a browser", remark="not tried: no chromium"
        )


CAMPAIGN = Campaign(14, "injection into reports", run)
