"""Row 4: every single-byte edit of a definition of every format that has any outside a checksum."""

from __future__ import annotations

from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from soak.readers import each_format
from tests.format_trials import FORMATS, definitions_of, edit


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    names = [name for name in FORMATS if definitions_of(name)]
    return each_format(budget, edit, names)


CAMPAIGN = Campaign(4, "every edit of a definition", run)
