"""Tracking of logs that nobody here wrote, against rows that other readers read."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader
from pyulog import ULog
from scipy.signal import correlate

import flysid
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.fact import Fact, Section, order
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.tracking import review

LOGS = Path("../shared/logs")
pytestmark = pytest.mark.skipif(not LOGS.is_dir(), reason="needs ../shared/logs")


@cache
def reviewed(name: str) -> Section:
    return review(LoggedFlight(FlightLog(flysid.read(LOGS / name))))


def fact(name: str, key: str) -> Fact:
    return next(fact for fact in reviewed(name).facts if fact.key == f"tracking.{key}")


def value(name: str, key: str) -> float:
    found = fact(name, key).value
    assert isinstance(found, float)
    return found


def ardupilot_rows(name: str, message: str, *fields: str) -> list[np.ndarray]:
    """(N,) of each field, between EV's NOT_LANDED and LAND_COMPLETE, as pymavlink reads them."""
    log = DFReader.DFReader_binary(str(LOGS / name))
    rows = []
    times = {28: -np.inf, 18: np.inf}
    while (row := log.recv_match(type=[message, "EV"])) is not None:
        if row.get_type() == "EV":
            times[row.Id] = row.TimeUS
        else:
            rows.append((row.TimeUS, *(getattr(row, field) for field in fields)))
    log.close()
    table = np.array(rows)
    inside = (table[:, 0] >= times[28]) & (table[:, 0] <= times[18])
    return list(table[inside].T)


@pytest.mark.parametrize(
    ("key", "message", "asked", "came", "scale"),
    [
        ("rate_roll_rms", "RATE", "RDes", "R", 1.0),
        ("rate_pitch_rms", "RATE", "PDes", "P", 1.0),
        ("attitude_roll_rms", "ATT", "DesRoll", "Roll", 1.0),
        ("attitude_pitch_rms", "ATT", "DesPitch", "Pitch", 1.0),
        ("position_north_rms", "NTUN", "DPosX", "PosX", 0.01),
        ("velocity_north_rms", "NTUN", "DVelX", "VelX", 0.01),
    ],
)
def test_errors_of_a_copter_are_those_of_its_rows(
    key: str, message: str, asked: str, came: str, scale: float
) -> None:
    _, wanted, found = ardupilot_rows("dataflash/copter_437s.bin", message, asked, came)
    error = scale * np.sqrt(np.mean((found - wanted) ** 2))
    assert value("dataflash/copter_437s.bin", key) == pytest.approx(error, rel=0.01)


@pytest.mark.parametrize("name", ["ulog/quad_position_76s.ulg", "ulog/quad_stabilised_92s.ulg"])
@pytest.mark.parametrize(("axis", "k"), [("roll", 0), ("pitch", 1)])
def test_rates_of_px4_are_those_of_its_topics(name: str, axis: str, k: int) -> None:
    log = ULog(str(LOGS / name))
    topics = {d.name: d.data for d in log.data_list if d.multi_id == 0}
    landed, asked, gyro = (
        topics[t] for t in ("vehicle_land_detected", "vehicle_rates_setpoint", "vehicle_angular_velocity")
    )
    at = gyro["timestamp"]
    state = landed["landed"][np.searchsorted(landed["timestamp"], at, side="right") - 1]
    inside = (state == 0) & (at <= asked["timestamp"][-1])
    wanted = np.degrees(np.interp(at, asked["timestamp"], asked[axis]))
    came = np.degrees(gyro[f"xyz[{k}]"])
    error = np.sqrt(np.mean((came - wanted)[inside] ** 2))
    assert value(name, f"rate_{axis}_rms") == pytest.approx(error, rel=0.02)

    grid = np.arange(at[inside][0], at[inside][-1], 2000.0)
    s, m = (np.interp(grid, at, x) - x.mean() for x in (wanted, came))
    both = correlate(m, s)
    lags = 2.0 * (np.arange(len(both)) - len(s) + 1)
    near = (lags >= 0.0) & (lags <= 500.0)
    assert value(name, f"rate_{axis}_lag") == pytest.approx(lags[near][np.argmax(both[near])], abs=5.0)


@pytest.mark.parametrize(
    ("name", "key", "low", "high"),
    [
        ("dataflash/copter_437s.bin", "attitude_roll_lag", 125.0, 202.0),
        ("ulog/quad_position_76s.ulg", "rate_roll_lag", 58.0, 63.0),
        ("ulog/quad_stabilised_92s.ulg", "rate_roll_lag", 63.0, 73.0),
        ("blackbox/greenreaper_flight14.bfl", "rate_roll_lag", 11.0, 14.0),
        ("blackbox/greenreaper_flight38.bfl", "rate_roll_lag", 6.0, 8.0),
        ("blackbox/greenreaper_flight14.bfl", "rate_roll_rms", 13.7, 14.5),
        ("blackbox/greenreaper_flight38.bfl", "rate_roll_rms", 11.4, 12.5),
        ("ulog/quad_position_76s.ulg", "velocity_north_rms", 0.10, 0.12),
        ("ulog/quad_position_76s.ulg", "position_north_rms", 0.07, 0.09),
    ],
)
def test_figures_that_others_found(name: str, key: str, low: float, high: float) -> None:
    assert low <= value(name, key) <= high


def test_a_vehicle_that_shakes_says_so_and_what_a_slow_log_cannot() -> None:
    first, *rest = order(reviewed("dataflash/sitl_copter_49s.BIN").findings)
    assert first.text == "Oscillates in roll and pitch, 95 deg/s"
    assert "cannot be told from 25 Hz: 10, 15, 35 or 40 Hz" in first.more
    assert "motors at their minimum 18 to 31 % of the time" in first.more
    assert not any("follow" in finding.text for finding in rest)
    lag = fact("dataflash/sitl_copter_49s.BIN", "rate_roll_lag")
    assert lag.value is None
    assert "10 Hz" in lag.missing


def test_what_did_not_fly_says_only_that() -> None:
    section = reviewed("ulog/pyulog_sample.ulg")
    assert [f.missing for f in section.facts] == ["the vehicle did not fly in this log"]
    assert not section.findings


def test_a_flight_that_tips_over_does_not_follow_well() -> None:
    texts = [f.text for f in order(reviewed("ulog/quad_manual_aggressive_80s.ulg").findings)]
    assert texts[0] == "Roll misses its setpoint by 12 deg"
    assert not any("well" in text for text in texts)
