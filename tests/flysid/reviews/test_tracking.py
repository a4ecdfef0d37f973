"""How loops follow their setpoints: known lags come back, and a log that does not show them gives none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flysid.reviews.fact import Fact, Grade, Picture, Section, Table, order
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.tracking import review
from tests.flysid.reviews.copter_log import ARMED, DISARMED, FLYING, LANDED, Floats, copter_log, even, wander

LOGS = Path("../shared/logs")
needs_logs = pytest.mark.skipif(not LOGS.is_dir(), reason="needs ../shared/logs")


def facts(section: Section) -> dict[str, Fact]:
    return {fact.key: fact for fact in section.facts}


def sentences(section: Section) -> list[str]:
    return [finding.text for finding in order(section.findings)]


def late(time_s: Floats, seed: int, size: float, lag_s: float, noise: float) -> tuple[Floats, Floats]:
    """A setpoint and what follows it by so much."""
    rng = np.random.default_rng(seed)
    return wander(time_s, seed, size), wander(time_s - lag_s, seed, size) + rng.normal(
        0.0, noise, len(time_s)
    )


def rates(
    folder: Path, seed: int, rate_hz: float = 100.0, lags: tuple[float, float, float] = (0.04, 0.04, 0.08)
) -> LoggedFlight:
    """A minute of body rates that come late."""
    time_s = even(60.0, rate_hz)
    columns = {}
    for k, axis in enumerate("RPY"):
        columns[f"{axis}Des"], columns[axis] = late(time_s, seed + k, 40.0, lags[k], 4.0)
    return copter_log(folder, {"RATE": (time_s, columns)})


@pytest.mark.parametrize("seed", range(4))
def test_a_known_lag_lies_in_its_interval(tmp_path: Path, seed: int) -> None:
    lags = tuple(np.random.default_rng(seed).uniform(0.01, 0.09, 3))
    found = facts(review(rates(tmp_path, 10 * seed, lags=(lags[0], lags[1], lags[2]))))
    for axis, lag in zip(("roll", "pitch", "yaw"), lags, strict=True):
        fact = found[f"tracking.rate_{axis}_lag"]
        assert fact.interval is not None
        assert isinstance(fact.value, float)
        assert fact.value == pytest.approx(1000.0 * lag, abs=2.0)
        assert fact.interval[0] - 1.0 <= 1000.0 * lag <= fact.interval[1] + 1.0
        assert fact.fields == (f"RATE.{axis[0].upper()}Des", f"RATE.{axis[0].upper()}")


def test_errors_are_those_of_the_rows_in_the_air(tmp_path: Path) -> None:
    time_s = even(60.0, 50.0)
    asked, came = late(time_s, 3, 20.0, 0.06, 2.0)
    came = np.where((time_s < 10.99) | (time_s > 41.01), 500.0, came)
    events = [(5.0, ARMED), (10.99, FLYING), (41.01, LANDED), (45.0, DISARMED)]
    flight = copter_log(tmp_path, {"RATE": (time_s, {"RDes": asked, "R": came})}, events=events)
    fact = facts(review(flight))["tracking.rate_roll_rms"]
    inside = (time_s >= 10.99) & (time_s <= 41.01)
    assert fact.value == pytest.approx(np.sqrt(np.mean((came - asked)[inside] ** 2)), rel=1e-4)


def test_a_log_at_10_hz_tells_no_lag_of_the_rates_and_says_what_logs_them(tmp_path: Path) -> None:
    section = review(rates(tmp_path, 5, rate_hz=10.0))
    fact = facts(section)["tracking.rate_roll_lag"]
    assert fact.value is None
    assert "logged at 10 Hz, which shows nothing above 5 Hz" in fact.missing
    assert "LOG_BITMASK" in fact.remedy
    assert not any("rate" in text for text in sentences(section))


def test_what_does_not_follow_has_no_lag(tmp_path: Path) -> None:
    time_s = even(60.0, 100.0)
    columns = {"RDes": wander(time_s, 1, 40.0), "R": wander(time_s, 2, 40.0)}
    fact = facts(review(copter_log(tmp_path, {"RATE": (time_s, columns)})))["tracking.rate_roll_lag"]
    assert fact.value is None
    assert "of the motion follows the setpoint" in fact.missing


def test_a_setpoint_of_zeros_is_no_setpoint(tmp_path: Path) -> None:
    time_s = even(30.0, 100.0)
    flight = copter_log(tmp_path, {"RATE": (time_s, {"R": wander(time_s, 2, 40.0)})})
    found = facts(review(flight))
    assert "tracking.rate_roll_rms" not in found
    assert found["tracking.rate"].missing
    assert "LOG_BITMASK" in found["tracking.rate"].remedy


def test_yaw_is_an_angle(tmp_path: Path) -> None:
    time_s = even(60.0, 25.0)
    asked = (50.0 * time_s + wander(time_s, 4, 10.0)) % 360.0
    came = (50.0 * (time_s - 0.2) + wander(time_s - 0.2, 4, 10.0)) % 360.0
    found = facts(review(copter_log(tmp_path, {"ATT": (time_s, {"DesYaw": asked, "Yaw": came})})))
    apart = (came - asked + 180.0) % 360.0 - 180.0
    error = np.sqrt(np.mean(apart**2))
    assert error < 20.0
    assert found["tracking.attitude_yaw_rms"].value == pytest.approx(error, rel=1e-3)


def test_yaw_that_comes_half_a_second_late_is_the_first_sentence(tmp_path: Path) -> None:
    section = review(rates(tmp_path, 7, lags=(0.03, 0.03, 0.5)))
    first = order(section.findings)[0]
    assert first.text.startswith("Yaw rate follows 5")
    assert first.grade is Grade.BAD
    assert "Roll and pitch follow well, the rates 30 ms late" in sentences(section)


def test_angles_are_judged_by_their_own_gain(tmp_path: Path) -> None:
    time_s = even(60.0, 50.0)
    columns = {}
    for name, seed in (("Roll", 1), ("Pitch", 2)):
        columns[f"Des{name}"], columns[name] = late(time_s, seed, 2.0, 0.2, 0.1)
    well = review(copter_log(tmp_path, {"ATT": (time_s, columns)}, parameters={"ATC_ANG_RLL_P": 4.5}))
    assert sentences(well)[0].startswith("Roll and pitch follow within")
    stiff = {"ATC_ANG_RLL_P": 18.0, "ATC_ANG_PIT_P": 18.0}
    slow = review(copter_log(tmp_path, {"ATT": (time_s, columns)}, parameters=stiff))
    assert sentences(slow)[0].startswith("Roll and pitch follow 2")
    assert sentences(slow)[0].endswith("ms late")
    assert not any("within" in text for text in sentences(slow))


def shaking(folder: Path, hz: float, size: float, rate_hz: float, seed: int = 3) -> LoggedFlight:
    """A rate that swings by itself, and gains to halve."""
    time_s = even(40.0, rate_hz)
    asked, came = late(time_s, seed, 10.0, 0.03, 0.5)
    came = came + size * np.sqrt(2.0) * np.sin(2.0 * np.pi * hz * time_s)
    gains = {f"ATC_RAT_RLL_{term}": value for term, value in (("P", 0.135), ("I", 0.135), ("D", 0.0036))}
    return copter_log(folder, {"RATE": (time_s, {"RDes": asked, "R": came})}, parameters=gains)


@pytest.mark.parametrize(("hz", "size"), [(8.0, 12.0), (17.0, 6.0), (31.0, 40.0)])
def test_an_oscillation_has_its_frequency_and_its_size(tmp_path: Path, hz: float, size: float) -> None:
    section = review(shaking(tmp_path, hz, size, 400.0))
    found = facts(section)
    assert found["tracking.oscillation_roll"].value == pytest.approx(size, rel=0.05)
    assert found["tracking.oscillation_roll_frequency"].value == pytest.approx(hz, abs=0.5)
    assert sentences(section)[0].startswith(f"Oscillates in roll at {hz:.0f} Hz, ")
    (action,) = section.actions
    assert action.changes[0].words == "ATC_RAT_RLL_P 0.135 -> 0.0675"
    assert all(change.new >= 0.5 * change.old for change in action.changes)


def test_a_slow_log_does_not_tell_an_oscillation_s_frequency(tmp_path: Path) -> None:
    section = review(shaking(tmp_path, 15.05, 60.0, 25.0))
    fact = facts(section)["tracking.oscillation_roll_frequency"]
    assert fact.value is None
    assert fact.missing == "it cannot be told from 25 Hz: 10, 15, 35 or 40 Hz"
    first = order(section.findings)[0]
    assert first.text == "Oscillates in roll, 60 deg/s"
    assert "cannot be told from 25 Hz" in first.more
    assert not section.actions, "whether the loop or a rotor shakes it is not known"


def test_a_pilot_s_quick_sticks_are_no_oscillation(tmp_path: Path) -> None:
    time_s = even(40.0, 200.0)
    asked = 60.0 * np.sin(2.0 * np.pi * 5.0 * time_s)
    came = 60.0 * np.sin(2.0 * np.pi * 5.0 * (time_s - 0.02))
    section = review(copter_log(tmp_path, {"RATE": (time_s, {"RDes": asked, "R": came})}))
    assert facts(section)["tracking.oscillation_roll"].value == 0.0
    assert not section.actions


def test_a_controller_at_its_limit_is_named(tmp_path: Path) -> None:
    time_s = even(50.0, 100.0)
    asked, came = late(time_s, 3, 40.0, 0.03, 2.0)
    out = np.clip(2.0 * wander(time_s, 8, 0.5), -1.0, 1.0)
    section = review(copter_log(tmp_path, {"RATE": (time_s, {"RDes": asked, "R": came, "ROut": out})}))
    share = float(np.mean(np.abs(out) >= 1.0))
    assert share > 0.05
    assert facts(section)["tracking.controller_roll_at_limit"].value == pytest.approx(100.0 * share, abs=0.1)
    assert f"The roll controller is at its limit {100.0 * share:.0f} % of the time" in sentences(section)


def test_modes_stand_beside_each_other(tmp_path: Path) -> None:
    time_s = even(60.0, 25.0)
    asked, came = late(time_s, 3, 8.0, 0.1, 0.1)
    came = np.where(time_s < 31.0, came, came + 3.0)
    modes = (np.array([1.0, 31.0]), {"ModeNum": np.array([0.0, 5.0])})
    section = review(copter_log(tmp_path, {"ATT": (time_s, {"DesRoll": asked, "Roll": came}), "MODE": modes}))
    (table,) = (shown for shown in section.shown if isinstance(shown, Table) and "by mode" in shown.title)
    for row, inside in zip(table.rows, (time_s < 31.0, time_s >= 31.0), strict=True):
        error = np.sqrt(np.mean((came - asked)[inside] ** 2))
        assert float(row[2]) == pytest.approx(error, rel=0.01)
    assert [row[0] for row in table.rows] == ["STABILIZE", "LOITER"]


def test_a_picture_shows_fifteen_seconds_in_which_it_moves(tmp_path: Path) -> None:
    time_s = even(60.0, 25.0)
    asked, came = late(time_s, 3, 8.0, 0.1, 0.1)
    busy = (time_s > 21.0) & (time_s < 36.0)
    columns = {"DesRoll": np.where(busy, asked, 0.0), "Roll": np.where(busy, came, 0.0)}
    section = review(copter_log(tmp_path, {"ATT": (time_s, columns)}))
    (picture,) = (shown for shown in section.shown if isinstance(shown, Picture))
    assert picture.title == "Roll"
    assert [line.style for line in picture.lines] == ["setpoint", "measured"]
    x = picture.lines[0].x
    assert x[0] == pytest.approx(21.0, abs=1.0)
    assert x[-1] - x[0] == pytest.approx(15.0, abs=0.1)


@pytest.mark.parametrize("seconds", [0.5, 3.0, 8.0])
def test_short_flights_tell_what_they_can(tmp_path: Path, seconds: float) -> None:
    time_s = even(seconds, 100.0)
    asked, came = late(time_s, 3, 20.0, 0.05, 1.0)
    section = review(copter_log(tmp_path, {"RATE": (time_s, {"RDes": asked, "R": came})}))
    fact = facts(section)["tracking.rate_roll_rms"]
    assert fact.value == pytest.approx(np.sqrt(np.mean((came - asked) ** 2)), rel=1e-3)
    assert not section.actions


def test_what_never_flew_is_not_judged(tmp_path: Path) -> None:
    time_s = even(20.0, 100.0)
    asked, came = late(time_s, 3, 20.0, 0.05, 1.0)
    flight = copter_log(
        tmp_path, {"RATE": (time_s, {"RDes": asked, "R": came})}, events=[(25.0, ARMED), (26.0, DISARMED)]
    )
    section = review(flight)
    assert not section.findings
    assert all(fact.value is None for fact in section.facts)
