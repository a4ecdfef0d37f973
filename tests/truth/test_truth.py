"""Printed figures against plants that nobody has written down: kinds and seeds are drawn anew in every run.

The bounds are exact binomials. Figures whose intervals hold the truth in LEAST of the records, or more, fail
once in 10,000 runs of the suite; one that is false beside the trial it was written for fails at once. For
finer figures: `python -m bench.truth`.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence

import pytest
from scipy.special import bdtr

from bench.truth.records import draw_record
from bench.truth.verbs import Score, scores

RECORDS = 22
LEAST = 0.8
FALSE_SHARE = 0.05
"""Share of the records in which a figure without a truth may be printed."""
FALSE_ALARMS = 1e-4


@pytest.fixture(scope="module")
def drawn() -> tuple[int, list[list[Score]]]:
    """The first seed, and the scores of every record."""
    first = secrets.randbelow(2**40)
    return first, [scores(draw_record(seed)) for seed in range(first, first + RECORDS)]


def test_intervals_hold_the_truth(drawn: tuple[int, list[list[Score]]]) -> None:
    first, records = drawn
    seen = held_by_figure(records)
    assert len(seen) > 10
    for figure, (held, printed) in seen.items():
        chance = float(bdtr(held, printed, LEAST)) if printed else 1.0
        assert chance > FALSE_ALARMS / (2.0 * len(seen)), (
            f"{figure}: {held} of {printed} intervals hold the truth; "
            f"python -m bench.truth {RECORDS} --seed {first}"
        )


def test_what_has_no_truth_is_not_printed(drawn: tuple[int, list[list[Score]]]) -> None:
    """A settling time of what integrates, a bandwidth of it."""
    first, records = drawn
    false = [{s.figure for s in r if s.true is None and s.low is not None} for r in records]
    count = sum(map(bool, false))
    chance = 1.0 - float(bdtr(count - 1, RECORDS, FALSE_SHARE)) if count else 1.0
    assert chance > FALSE_ALARMS / 2.0, f"{false}; python -m bench.truth {RECORDS} --seed {first}"


def test_not_everything_is_refused(drawn: tuple[int, list[list[Score]]]) -> None:
    """Bounds that refuse every figure would hold, too."""
    first, records = drawn
    answerable = [s for r in records for s in r if s.true is not None]
    refused = sum(s.low is None for s in answerable)
    assert refused < 0.5 * len(answerable), f"python -m bench.truth {RECORDS} --seed {first}"


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


def test_the_bundle_sees_intervals_that_are_too_narrow(drawn: tuple[int, list[list[Score]]]) -> None:
    """The same records with a settling time that is never held, as it was once in 0 of 10."""
    _, records = drawn
    wrong = [[Score(s.figure, s.true, 0.0, 0.0) for s in r if s.figure == "step settling"] for r in records]
    held, printed = held_by_figure(wrong)["step settling"]
    assert float(bdtr(held, printed, LEAST)) < FALSE_ALARMS / 40.0 or printed < 6
