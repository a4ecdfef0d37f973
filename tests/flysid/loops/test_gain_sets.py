"""Several sets of gains beside each other."""

from flysid.loops.gain_sets import differences, gain_sets
from flysid.loops.judged import Judged
from flysid.loops.margins import Figure, Margins


def flown(p: float, phase: Figure, flights: int = 1) -> Judged:
    known = Figure(12.0, 11.0, 13.0)
    margins = Margins((2.0, 40.0), known, phase, Figure(None, 7.8, float("inf")), known, known, known, known)
    names = tuple(f"flight-{k}" for k in range(flights))
    return Judged("roll", names, {"rollPID P": p, "I": 45.0, "D": 25.0}, miss=0.03, margins=margins)


LOW = flown(46.0, Figure(48.0, 46.0, 50.0), 2)
HIGH = flown(55.0, Figure(36.0, 33.0, 39.0))


def test_sets_stand_in_one_table() -> None:
    refused = Judged("roll", ("f",), {"rollPID P": 64.0, "I": 47.0}, "too quiet", "fly")
    heading, first, _, last = gain_sets([LOW, HIGH, refused])
    assert heading[:3] == ("AXIS", "GAINS", "FLIGHTS")
    assert first == ("roll", "P 46, I 45, D 25", "2", "12.0", "48", "> 7.8", "12.00", "12.0")
    assert last[:4] == ("roll", "P 64, I 47", "1", "refused, see above")


def test_one_set_needs_no_table() -> None:
    assert gain_sets([LOW]) == []
    assert differences([LOW]) == []


def test_what_intervals_part_is_clear_and_nothing_else() -> None:
    (said,) = differences([LOW, HIGH])
    assert "largest phase margin at P 46, I 45, D 25: 48 deg [46, 50], clearly" in said
    (said,) = differences([LOW, flown(55.0, Figure(45.0, 42.0, 47.0))])
    assert "48 deg [46, 50], no clear difference to 1 of 1 other" in said
    (said,) = differences([LOW, flown(55.0, Figure(None, why="the flights scatter too much"))])
    assert "largest phase margin: not determined" in said
