"""Several sets of gains beside each other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli.gains import command
from flysid.loops.between_flights import FlightScatter
from flysid.loops.contradictions import contradiction_of
from flysid.loops.gain_sets import differences, gain_sets
from flysid.loops.judged import Judged, find_margins
from flysid.loops.margins import Figure, Margins
from flysid.loops.stick_response import Loop
from tests.drawn import is_seldom
from tests.flysid.loops.simulated import PID, Vehicle, fly

LOGS = Path("../shared/logs/blackbox")


def flown(p: float, phase: Figure, flights: int = 1, across: Figure | None = None) -> Judged:
    known = Figure(12.0, 11.0, 13.0)
    margins = Margins((2.0, 40.0), known, phase, Figure(None, 7.8, float("inf")), known, known, known, known)
    names = tuple(f"flight-{k}" for k in range(flights))
    gains = {"rollPID P": p, "I": 45.0, "D": 25.0}
    own = replace(margins, phase_deg=across or phase)
    return Judged("roll", names, gains, miss=0.03, margins=margins, across=own)


def fly_set(p: float, *gains: float, seconds: float = 60.0) -> Judged:
    """A set of gains in flights of vehicles of these gains."""
    law = replace(PID, p=PID.p * p / 46.0, gains={"rollPID P": p, "I": 45.0})
    loop = Loop.of([fly(Vehicle(gain), law, seconds, k) for k, gain in enumerate(gains)])
    names = tuple(f"flight-{gain:g}" for gain in gains)
    return Judged("roll", names, law.gains, miss=0.0, loop=loop, controller=law)


LOW = flown(46.0, Figure(48.0, 46.0, 50.0), 2)
HIGH = flown(55.0, Figure(36.0, 33.0, 39.0))


def test_sets_stand_in_one_table() -> None:
    refused = Judged("roll", ("f",), {"rollPID P": 64.0, "I": 47.0}, "too quiet", "fly")
    heading, first, _, last = gain_sets([LOW, HIGH, refused])
    assert heading[:3] == ("AXIS", "GAINS", "FLIGHTS")
    cells = ("12.0 +-1.0", "48 +-2", "> 7.8", "12.00 +-1.00", "12.0 +-1.0")
    assert first == ("roll", "P 46, I 45, D 25", "2", *cells)
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


def test_sets_are_compared_by_the_scatter_between_flights() -> None:
    wide = flown(46.0, Figure(48.0, 46.0, 50.0), across=Figure(48.0, 36.0, 60.0))
    (said,) = differences([wide, HIGH])
    assert "48 deg [36, 60], no clear difference to 1 of 1 other" in said
    unknown = replace(wide, across=None)
    (said,) = differences([unknown, HIGH])
    assert "largest phase margin at P 46, I 45, D 25: 48 deg, but flights scatter too much" in said
    assert gain_sets([unknown, HIGH])[1][4] == "48 +-?"


def test_intervals_of_a_mean_of_flights_hold_it(fresh_seed: int) -> None:
    rng = np.random.default_rng(fresh_seed)
    f = np.linspace(2.0, 30.0, 20)
    held = 0
    for _ in range(400):
        away = rng.normal(0.0, 0.2, int(rng.integers(2, 6)))
        plants = [(f, (np.exp(level) / f).astype(np.complex128)) for level in away]
        scatter = FlightScatter.of(plants, 20.0)
        assert scatter is not None
        loop = Loop(f, tuple(np.zeros((5, 3, 3, len(f)), dtype=np.complex128) for _ in away))
        moved = np.log(np.abs(scatter.moves(f, loop)))
        held += bool(abs(away.mean()) <= scatter.reach(moved)[0])
    assert not is_seldom(held, 400, 0.95), held


def test_a_flight_known_below_the_crossover_says_nothing_of_the_scatter() -> None:
    near, far = np.linspace(2.0, 5.0, 7), np.linspace(2.0, 30.0, 20)
    plants = ((far, 1.0), (near, 9.0), (far, 1.1))
    curves = [(f, (gain / f).astype(np.complex128)) for f, gain in plants]
    scatter = FlightScatter.of(curves, 12.0)
    assert scatter is not None
    assert np.ptp(scatter.away.real) < 0.11
    assert FlightScatter.of(curves[:2], 12.0) is None


def test_intervals_of_several_flights_hold_the_scatter_between_them() -> None:
    (alike,) = find_margins([fly_set(46.0, 70.0, 70.0, 70.0)])
    (apart,) = find_margins([fly_set(46.0, 55.0, 70.0, 90.0)])
    assert alike.margins is not None
    assert apart.margins is not None
    widths = [m.crossover_hz.high - m.crossover_hz.low for m in (alike.margins, apart.margins)]
    assert widths[1] > 3.0 * widths[0]
    assert alike.across is None, "nothing to compare it with"


def test_a_single_flight_takes_the_scatter_from_the_others() -> None:
    one, other = find_margins([fly_set(46.0, 55.0, 70.0, 90.0), fly_set(50.0, 70.0)])
    assert other.margins is not None
    assert other.across is not None
    own, across = other.margins.crossover_hz, other.across.crossover_hz
    assert across.high - across.low > 3.0 * (own.high - own.low)
    assert one.margins is one.across


def test_stronger_gains_that_cross_lower_are_a_contradiction() -> None:
    soft, hard = find_margins([fly_set(46.0, 80.0), fly_set(50.0, 55.0)])
    said = contradiction_of(hard, [soft, hard])
    assert said.startswith("contradiction: P 46 -> 50, all else equal, yet crossover falls from ")
    assert "Most likely the flights differ" in said
    assert contradiction_of(soft, [soft, hard]) == ""


def test_what_gains_explain_is_no_contradiction() -> None:
    sets = find_margins([fly_set(46.0, 70.0), fly_set(60.0, 70.0)])
    assert [contradiction_of(own, sets) for own in sets] == ["", ""]


@pytest.mark.skipif(not LOGS.is_dir(), reason="no real logs here")
def test_two_real_flights_that_contradict_physics_are_named(tmp_path: Path) -> None:
    for number in (26, 28):
        name = f"greenreaper_flight{number}.bfl"
        (tmp_path / name).write_bytes((LOGS / name).read_bytes())
    done = CliRunner().invoke(command, [str(tmp_path), "--axis", "roll"])
    assert done.exit_code == 0, done.output
    said = " ".join(done.stdout.split())
    assert "contradiction: P 55 -> 59, all else equal, yet crossover falls from 15.5 Hz [14.3, 16.6]" in said
    assert "clearly" not in said, "one flight each"
    (row,) = [line for line in done.stdout.splitlines() if line.startswith("roll") and "  1  " in line][1:]
    assert " +-" in row
