"""Tracking of a Crazyflie and of INAV: their fields, signs and units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import flysid
from flysid.flight import ClockMap
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.fact import Fact
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.tracking import review
from tests.flysid.reviews.copter_log import Floats, even, wander
from tests.samplelogs import crazyflie

LAG_S = 0.04


def flown(folder: Path, info: Mapping[str, str], stream: str, columns: Mapping[str, Floats]) -> LoggedFlight:
    """A log of one stream of 200 Hz."""
    path = folder / "log00.usd"
    path.write_bytes(crazyflie.build())
    time_ns = (1e9 * even(40.0, 200.0)).astype(np.int64)
    table = pa.table({"time_ns": time_ns, "boot": np.zeros(len(time_ns), dtype=np.int64), **columns})
    clock = ClockMap(0, int(time_ns[0]), int(time_ns[-1]))
    flight = replace(flysid.read(path), tables={stream: table}, clocks=(clock,), info=dict(info))
    return LoggedFlight(FlightLog(flight))


def facts(flight: LoggedFlight) -> dict[str, Fact]:
    return {fact.key: fact for fact in review(flight).facts}


def late(seed: int, size: float) -> tuple[Floats, Floats]:
    time_s = even(40.0, 200.0)
    return wander(time_s, seed, size), wander(time_s - LAG_S, seed, size)


def test_a_crazyflie_s_pitch_rate_is_its_gyro_with_the_other_sign(tmp_path: Path) -> None:
    roll, gyro_x = late(1, 30.0)
    pitch, gyro_y = late(2, 30.0)
    columns = {
        "controller.rollRate": roll,
        "gyro.x": gyro_x,
        "controller.pitchRate": pitch,
        "gyro.y": -gyro_y,
    }
    found = facts(flown(tmp_path, {"vehicle": "Crazyflie"}, "fixedFrequency", columns))
    for axis, asked, came in (("roll", roll, gyro_x), ("pitch", pitch, gyro_y)):
        error = np.sqrt(np.mean((came - asked) ** 2))
        assert found[f"tracking.rate_{axis}_rms"].value == pytest.approx(error, rel=1e-6)
        assert found[f"tracking.rate_{axis}_lag"].value == pytest.approx(1000.0 * LAG_S, abs=1.0)
    assert "controller.roll" in found["tracking.attitude"].remedy


def test_inav_s_navigation_is_in_centimetres(tmp_path: Path) -> None:
    asked, came = late(3, 200.0)
    columns = {"navTgtPos[0]": asked, "navPos[0]": came, "navTgtVel[2]": asked, "navVel[2]": came}
    info = {"autopilot": "inav", "firmware": "7.1.0", "vehicle": "plane"}
    found = facts(flown(tmp_path, info, "main", columns))
    error = 0.01 * np.sqrt(np.mean((came - asked) ** 2))
    assert found["tracking.position_north_rms"].value == pytest.approx(error, rel=1e-6)
    assert found["tracking.position_north_rms"].unit == "m"
    assert found["tracking.velocity_up_rms"].value == pytest.approx(error, rel=1e-6)
    assert "axisRate" in found["tracking.rate"].remedy
