"""Row 8: MCAP records longer than today's fields, against what was written: every kind, every size to 64."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from soak import Budget, Campaign, Outcome
from tests.ingest.formats.test_mcap_padded import SHAPES, assert_whole, combinations, pads
from tests.samplelogs.mcap_padded import EXTENSIBLE, padded_mcap

Trial = tuple[frozenset[str], dict[int, bytes]]


def together() -> Iterator[Trial]:
    """All kinds longer, in every combination of features, then by every size and content."""
    for features, pad in itertools.product(combinations(), (b"", b"\x01\xff\xff")):
        yield features, dict.fromkeys(EXTENSIBLE, pad)
    for size, features in itertools.product(range(1, 65), SHAPES.values()):
        for pad in pads(size):
            yield features, dict.fromkeys(EXTENSIBLE, pad)


def alone() -> Iterator[Trial]:
    """One kind longer, by every size and content."""
    for op, size, features in itertools.product(EXTENSIBLE, range(1, 65), SHAPES.values()):
        for pad in pads(size):
            yield features, {op: pad}


def run(budget: Budget) -> Iterator[Outcome]:
    """Two outcomes: kinds together, kinds alone."""
    for name, trials in (("MCAP, all records longer", together()), ("MCAP, one kind longer", alone())):
        goes_on = budget.shares(2)[0].clock()
        outcome = Outcome(name)
        for features, longer in trials:
            if not goes_on():
                break
            with outcome.trial():
                try:
                    assert_whole(padded_mcap(features, longer))
                except (AssertionError, ValueError) as error:
                    outcome.failures.append(f"trial {outcome.trials}: {error}"[:200])
        yield outcome


CAMPAIGN = Campaign(8, "longer MCAP records", run)
