"""Printed figures against plants that nobody has written down: kinds and seeds are drawn anew in every run.

Bounds are those of `tests.drawn`: a figure whose intervals hold the truth in LEAST of the records, or more,
does not fail by chance; one that is false beside the trial it was written for fails at once. For finer
figures: `python -m bench.truth`, and row 39 of the soak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from bench.truth.records import draw_record
from bench.truth.verbs import Score, scores
from tests.drawn import is_rarer, is_seldom

RECORDS = 22
LEAST = 0.8
"""Share of the records in which the interval of a figure holds the truth."""
FALSE_SHARE = 0.05
"""Share of the records in which a figure without a truth may be printed."""
ANSWERED = 0.8
"""Share of the records that have most of their figures printed."""


@pytest.fixture(scope="module")
def drawn(fresh_seed: int) -> list[list[Score]]:
    """The scores of every record; `python -m bench.truth 22 --seed FRESH_SEED` prints them as a table."""
    return [scores(draw_record(fresh_seed + k)) for k in range(RECORDS)]


def test_intervals_hold_the_truth(drawn: list[list[Score]]) -> None:
    assert not missed_figures(drawn)


def test_what_has_no_truth_is_not_printed(drawn: list[list[Score]]) -> None:
    """A settling time of what integrates, a bandwidth of it."""
    false = [{s.figure for s in record if s.true is None and s.low is not None} for record in drawn]
    assert not is_rarer(sum(map(bool, false)), RECORDS, FALSE_SHARE), false


def test_not_everything_is_refused(drawn: list[list[Score]]) -> None:
    """Bounds that refuse every figure would hold, too."""
    answerable = [[s.low is not None for s in record if s.true is not None] for record in drawn]
    answered = sum(2 * sum(record) > len(record) for record in answerable)
    assert not is_seldom(answered, RECORDS, ANSWERED), answered


def test_intervals_that_never_hold_are_seen(drawn: list[list[Score]]) -> None:
    """The same records with intervals beside the truth, as that of a settling time was in 10 of 10."""
    wrong = [
        [
            replace(s, low=2.0 + s.true, high=3.0 + s.true) if s.low is not None and s.true is not None else s
            for s in record
        ]
        for record in drawn
    ]
    assert "tf measured gain" in missed_figures(wrong)


def missed_figures(records: Sequence[Sequence[Score]]) -> dict[str, tuple[int, int]]:
    """(held, printed) of the figures whose intervals miss the truth in too many records."""
    seen = held_by_figure(records)
    return {name: counts for name, counts in seen.items() if is_seldom(*counts, LEAST)}


def held_by_figure(records: Sequence[Sequence[Score]]) -> dict[str, tuple[int, int]]:
    """(held, printed) of every figure, one of a kind per record: those of one record miss together."""
    found: dict[str, tuple[int, int]] = {}
    for record in records:
        for figure, score in {s.figure: s for s in reversed(record)}.items():
            if score.true is None or score.low is None:
                continue
            held, printed = found.get(figure, (0, 0))
            found[figure] = (held + score.held, printed + 1)
    return found
