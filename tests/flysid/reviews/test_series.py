"""Flights in a row: what a change of gains did beyond chance, vehicles apart, in 25 lines."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.workers import Bounds
from flysid.loops.stick_response import Loop
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.review import review_flight
from flysid.reviews.reviewed import Review
from flysid.reviews.series import Series, series
from flysid.reviews.series_effects import Figure, effects, scatter_of_equals
from flysid.reviews.series_plant import compare_plants
from flysid.reviews.tracking import review as review_tracking
from tests.drawn import is_rarer
from tests.flysid.reviews.copter_log import copter_log, even, wander

LOGS = Path("../shared/logs/blackbox")
needs_logs = pytest.mark.skipif(not LOGS.is_dir(), reason="needs ../shared/logs")


def figure(values: list[float], halves: list[float] | None = None) -> Figure:
    wide = halves or [np.nan] * len(values)
    return Figure("lag", "roll lag", "ms", np.array(values), np.array(wide))


def test_an_effect_is_found_with_its_size() -> None:
    gains = [
        {"p_roll": p, "d_roll": d} for p, d in ((40, 20), (40, 20), (50, 30), (60, 20), (60, 30), (70, 20))
    ]
    lags = [
        20.0 - 10.0 * np.log(g["p_roll"] / 40) + e
        for g, e in zip(gains, (0.1, -0.1, 0.2, 0, -0.2, 0.1), strict=True)
    ]
    by_p, by_d = effects(figure(lags), gains)
    assert by_p.gains == (("p_roll", 40, 70),)
    assert by_p.is_clear
    assert by_p.interval[0] <= -10.0 * np.log(70 / 40) <= by_p.interval[1]
    assert by_p.words.startswith("roll lag 20 -> 14 ms while p_roll 40 -> 70 (change -5")
    assert not by_d.is_clear
    assert "unchanged beyond the scatter" in by_d.words


def test_gains_that_rose_together_are_not_told_apart() -> None:
    gains = [{"p_roll": p, "d_roll": p / 2} for p in (40.0, 50.0, 60.0, 70.0)]
    (both,) = effects(figure([20.0, 17.9, 16.1, 14.0]), gains)
    assert [name for name, *_ in both.gains] == ["p_roll", "d_roll"]
    assert "not to be told apart" in both.words


def test_chance_is_called_an_effect_in_one_series_of_twenty(fresh_seed: int) -> None:
    rng = np.random.default_rng(fresh_seed)
    gains = [{"p_roll": p} for p in (40.0, 40.0, 50.0, 50.0, 60.0, 70.0)]
    draws = [rng.normal(12.0, 2.0, 6).tolist() for _ in range(600)]
    clear = sum(effect.is_clear for lags in draws for effect in effects(figure(lags), gains))
    assert not is_rarer(clear, len(draws), 0.05), clear


def test_one_flight_each_does_not_tell_gains_from_flights() -> None:
    gains = [{"p_roll": 40.0}, {"p_roll": 60.0}]
    (effect,) = effects(figure([20.0, 14.0], [1.0, 1.0]), gains)
    assert not effect.is_clear
    assert effect.words.startswith("roll lag 20 -> 14 ms while p_roll 40 -> 60 (change -6")
    assert "one flight each cannot tell" in effect.words
    assert not list(effects(figure([20.0, 14.0]), gains)), (
        "a figure without an interval tells nothing of two flights"
    )


def test_neighbours_are_compared_by_the_scatter_of_equal_gains() -> None:
    gains = [
        {"p_roll": p, "i_roll": i, "d_roll": d}
        for p, i, d in ((40.0, 80.0, 20.0), (40.0, 80.0, 20.0), (60.0, 80.0, 30.0), (60.0, 120.0, 20.0))
    ]
    lags = [20.0, 22.0, 14.0, 15.0]
    found = list(effects(figure(lags, [0.5] * 4), gains))
    assert [effect.knows_scatter for effect in found] == [True, True]
    assert not any(effect.is_clear for effect in found), "equal gains differ by 2 ms"


def test_equal_gains_scatter() -> None:
    gains = [{"p": 1.0}, {"p": 1.0}, {"p": 2.0}, {"p": 2.0}, {"p": 3.0}]
    sigma, free = scatter_of_equals(np.array([1.0, 3.0, 5.0, 5.0, 9.0]), gains)
    assert sigma == pytest.approx(1.0)
    assert free == 2
    assert scatter_of_equals(np.array([1.0, np.nan, 5.0, np.nan, 9.0]), gains)[1] == 0


def loop(gain: float, seed: int) -> Loop:
    """Spectra of an integrator with a lag, as sticks show it in a little noise."""
    rng = np.random.default_rng(seed)
    f = np.arange(0.0, 30.5, 0.5)
    s = 2j * np.pi * np.maximum(f, 0.1)
    turned = gain / (s * (0.03 * s + 1.0))
    blocks = []
    for _ in range(12):
        asked = rng.normal(size=len(f)) + 1j * rng.normal(size=len(f))
        given = asked * (1.0 + 0.02 * rng.normal(size=len(f)))
        rows = np.array([asked, given, turned * given * (1.0 + 0.05 * rng.normal(size=len(f)))])
        blocks.append(rows.conj()[:, None] * rows[None])
    return Loop(f, (np.array(blocks),))


def test_another_vehicle_is_not_the_same() -> None:
    same = compare_plants("roll", [(f"flight{i}", loop(40.0, i)) for i in range(4)])
    assert same is not None
    assert same.is_same
    other = compare_plants(
        "roll", [*((f"flight{i}", loop(40.0, i)) for i in range(4)), ("odd", loop(80.0, 9))]
    )
    assert other is not None
    assert not other.is_same
    assert other.flight == "odd"
    assert "not the same vehicle, in odd it answers" in other.words
    assert compare_plants("roll", [("one", loop(40.0, 1))]) is None


def copter(folder: Path, name: str, p: float, lag_s: float, seed: int) -> tuple[Review, LoggedFlight]:
    time_s = even(40.0, 100.0)
    rng = np.random.default_rng(seed)
    columns = {
        "RDes": wander(time_s, seed, 40.0),
        "R": wander(time_s - lag_s, seed, 40.0) + rng.normal(0.0, 2.0, len(time_s)),
    }
    gains = {"ATC_RAT_RLL_P": p, "ATC_RAT_RLL_I": 0.1, "ATC_RAT_RLL_D": 0.004, "STAT_RUNTIME": 100.0 * seed}
    flight = copter_log(folder, {"RATE": (time_s, columns)}, parameters=gains, name=name)
    review = review_flight(flight)
    return review, flight


def test_flights_stand_in_the_order_of_their_numbers_and_say_what_p_did(tmp_path: Path) -> None:
    flown = [(2, 0.10, 0.060), (9, 0.10, 0.061), (10, 0.15, 0.050), (11, 0.15, 0.049), (30, 0.20, 0.041)]
    found = series([copter(tmp_path, f"f{n}.bin", p, lag, n) for n, p, lag in reversed(flown)])
    (own,) = found.vehicles
    assert [one.name for one in own.flights] == ["f2", "f9", "f10", "f11", "f30"]
    assert [d.flight for d in own.changed] == ["f10", "f30"]
    assert own.changed[0].words == "ATC_RAT_RLL_P 0.1 -> 0.15"
    lag = next(effect for effect in own.effects if effect.figure == "roll lag")
    assert lag.is_clear
    assert lag.words.startswith("roll lag 61 -> 41 ms while ATC_RAT_RLL_P 0.1 -> 0.2")
    assert any(lag.words in line for line in found.lines())


def test_vehicles_are_kept_apart_and_one_flight_is_no_series(tmp_path: Path) -> None:
    flights = [copter(tmp_path, f"f{n}.bin", 0.1, 0.05, n) for n in range(4)]

    def of(number: int, vehicle: str) -> tuple[Review, LoggedFlight]:
        review, flight = flights[number]
        assert isinstance(flight.log, FlightLog)
        named = replace(flight.log.flight, info={"autopilot": "betaflight", "vehicle": vehicle})
        return review, LoggedFlight(FlightLog(named))

    three = [of(0, "C+R GreenReaper"), of(1, "Hiro1"), of(2, "C+R GreenReaper")]
    assert [own.vehicle for own in series(three).vehicles] == ["C+R GreenReaper"]
    both = series([*three, of(3, "Hiro1")])
    assert [own.vehicle for own in both.vehicles] == ["C+R GreenReaper", "Hiro1"]
    assert [one.name for own in both.vehicles for one in own.flights] == ["f0", "f2", "f1", "f3"]
    assert len(both.lines()) <= 25
    many = series([of(n % 4, f"vehicle {k}") for k in range(9) for n in range(2)])
    assert len(many.lines()) <= 25
    assert many.lines()[-1] == "and 5 vehicles more: see the page"


@pytest.mark.parametrize("count", [3, 30])
def test_a_terminal_of_25_lines_is_enough(tmp_path: Path, count: int) -> None:
    flights = [copter(tmp_path, f"f{n}.bin", 0.1 + 0.01 * n, 0.06, n) for n in range(3)]
    found = series([flights[n % 3] for n in range(count)])
    lines = found.lines()
    assert len(lines) <= 25
    assert lines[0] == f"copter: {count} flights, by the numbers in their names"
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["vehicles"][0]["vehicle"] == "copter"


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """The blackbox flights of two vehicles."""
    place = tmp_path_factory.mktemp("series") / "data"
    logs = sorted(p for p in LOGS.iterdir() if p.name.startswith(("greenreaper", "hiro")))
    list(ingest_logs(find_logs(logs, Bounds()), place, bounds=Bounds()))
    return open_lake(place)


@pytest.fixture(scope="module")
def flown(stored: Lake) -> Series:
    """Their series, of the section that it rests on."""
    pairs = []
    for log in stored.logs:
        flight = LoggedFlight(log, log.manifest.damage, log.manifest.source.name)
        sections = (review_tracking(flight),)
        pairs.append((Review(flight.name, flight.info, flight.clock, sections), flight))
    return series(pairs)


@needs_logs
def test_the_series_of_ten_flights_says_what_its_gains_did(flown: Series) -> None:
    own = next(v for v in flown.vehicles if v.vehicle == "C+R GreenReaper")
    assert [one.name[-2:] for one in own.flights] == [
        "14",
        "15",
        "18",
        "21",
        "24",
        "26",
        "28",
        "30",
        "35",
        "38",
    ]
    lag = next(effect for effect in own.effects if effect.figure == "roll lag")
    assert lag.gains[0] == ("p_roll", 46.0, 74.0)
    assert lag.is_clear
    assert lag.start == pytest.approx(12.0, abs=1.5)
    assert lag.end == pytest.approx(7.0, abs=2.0)
    lines = own.lines()
    assert len(lines) <= 25
    assert any(line.startswith("yaw lag 11 ms under the same gains all along") for line in lines)
    assert all(same.is_same for same in own.sameness)
    assert {same.axis for same in own.sameness} >= {"roll", "pitch"}


@needs_logs
def test_settings_between_neighbours_are_those_of_the_headers(flown: Series) -> None:
    own = next(v for v in flown.vehicles if v.vehicle == "Hiro1")
    assert [difference.words for difference in own.changed] == [
        "pitchPID 55,50,25 -> 55,50,20, rollPID 45,40,25 -> 45,40,20",
        "pitchPID 55,50,20 -> 50,50,20, rollPID 45,40,20 -> 40,40,20",
    ]


@needs_logs
def test_what_is_proposed_stays_within_a_quarter_and_states_what_it_brings(flown: Series) -> None:
    actions = [action for own in flown.vehicles for action in own.actions]
    assert actions
    for action in actions:
        for change in action.changes:
            assert 0.75 <= change.new / change.old <= 1.25
            assert change.new == round(change.new)
        assert "phase margin" in action.predicted
        assert "lag at 3 Hz" in action.predicted
        assert "motors" in action.risk


def test_three_flights_of_one_set_of_gains_propose_nothing_without_a_plant(tmp_path: Path) -> None:
    flights = [copter(tmp_path, f"f{n}.bin", 0.1, 0.06, n) for n in range(3)]
    (own,) = series(flights).vehicles
    assert not own.actions
    assert not own.effects
    assert "No change of a gain did anything beyond the scatter between flights." in own.lines()
