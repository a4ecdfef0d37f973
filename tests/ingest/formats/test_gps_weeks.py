"""Dates of GPS receivers that fell back by 1,024 weeks: corrected and said, where the log shows it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

import flysid
from flysid.flight import Flight
from tests.command import call
from tests.parameter_trials import written
from tests.samplelogs import ulog

WEEK_S = 604_800
GPS_S = 315_964_800
TRUE_WEEK = 2360  # in March 2025
HEAD = b"\xa3\x95"


def dataflash(week: int) -> bytes:
    """A log of 100 fixes at 5 Hz in this week."""
    blob = _fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    blob += _fmt(20, 18, "GPS", "QBIH", "TimeUS,Status,GMS,GWk")
    for k in range(100):
        fields = (1_000_000 + 200_000 * k, 3, 200_000_000 + 200 * k, week)
        blob += HEAD + bytes([20]) + struct.pack("<QBIH", *fields)
    return blob


def _fmt(number: int, length: int, name: str, letters: str, columns: str) -> bytes:
    body = struct.pack("<BB4s16s64s", number, length, name.encode(), letters.encode(), columns.encode())
    return HEAD + bytes([128]) + body


def began(flight: Flight) -> float:
    """Seconds since 1970 of the first fix, by the flight's map to UTC."""
    clock = flight.clocks[0]
    assert clock.utc_offset_ns is not None
    return (clock.utc_offset_ns + clock.slope * clock.first_ns) / 1e9


@pytest.mark.parametrize("lost", [0, 1024, 2048])
def test_weeks_that_a_dataflash_log_lacks_are_added_and_said(tmp_path: Path, lost: int) -> None:
    """A flight of 2025 was dated 2005 without a word."""
    (tmp_path / "a.bin").write_bytes(dataflash(TRUE_WEEK - lost))
    flight = flysid.read(tmp_path / "a.bin")
    assert began(flight) == pytest.approx(GPS_S + TRUE_WEEK * WEEK_S + 200_000 - 18, abs=0.01)
    done = call("doctor", "a.bin", cwd=tmp_path)
    assert done.returncode == 0
    assert (f"the GPS dates lay {lost:,} weeks low" in " ".join(done.stderr.split())) == bool(lost)
    assert flight["GPS"]["GWk"].to_pylist() == [TRUE_WEEK - lost] * 100


@pytest.mark.parametrize("letters", ["QBIH", "QBQQ", "QBqq"])
def test_a_week_that_no_calendar_holds_dates_nothing_and_loses_nothing(tmp_path: Path, letters: str) -> None:
    """A damaged week, the first or any, lost the whole log."""
    form = struct.Struct("<" + letters)
    blob = _fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    blob += _fmt(20, form.size + 3, "GPS", letters, "TimeUS,Status,GMS,GWk")
    for k in range(20):
        week = 15_000 if k in (0, 7) else TRUE_WEEK
        fields = (1_000_000 + 200_000 * k, 3, 200_000_000 + 200 * k, week)
        blob += HEAD + bytes([20]) + form.pack(*fields)
    (tmp_path / "a.bin").write_bytes(blob)
    flight = flysid.read(tmp_path / "a.bin")
    assert flight["GPS"].num_rows == 20
    assert began(flight) == pytest.approx(GPS_S + TRUE_WEEK * WEEK_S + 200_000 - 18, abs=0.3)
    assert call("doctor", "a.bin", cwd=tmp_path).returncode == 0


@pytest.mark.parametrize("lost", [0, 1024])
def test_weeks_that_a_ulog_lacks_are_added_and_said(tmp_path: Path, lost: int) -> None:
    layout = b"vehicle_gps_position:uint64_t timestamp;uint64_t time_utc_usec;"
    blob = ulog.build()[:16] + ulog.record("F", layout) + ulog.subscribe(7, 0, "vehicle_gps_position")
    first_us = (GPS_S + (TRUE_WEEK - lost) * WEEK_S) * 1_000_000
    for k in range(100):
        blob += ulog.data(7, struct.pack("<QQ", 1_000_000 + 200_000 * k, first_us + 200_000 * k))
    (tmp_path / "a.ulg").write_bytes(blob)
    flight = flysid.read(tmp_path / "a.ulg")
    assert began(flight) == pytest.approx(GPS_S + TRUE_WEEK * WEEK_S, abs=1.1)
    assert ("1,024 weeks low" in flight.info.get("clock_note", "")) == bool(lost)


@pytest.mark.parametrize("lost", [0, 1024])
def test_a_vehicle_on_a_link_whose_dates_lack_weeks_is_named(tmp_path: Path, lost: int) -> None:
    unix_us = (GPS_S + (TRUE_WEEK - lost) * WEEK_S) * 1_000_000
    heartbeat = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    dates = [mavlink.MAVLink_system_time_message(unix_us + 20_000 * k, 1000 + 20 * k) for k in range(50)]
    told: list[tuple[tuple[int, int], Any]] = [((1, 1), message) for message in (heartbeat, *dates)]
    (tmp_path / "a.tlog").write_bytes(written(told))
    flight = flysid.read(tmp_path / "a.tlog")
    assert ("1,024 weeks low" in flight.info.get("clock_note", "")) == bool(lost)
    assert np.diff(flight["SYSTEM_TIME"]["time_unix_usec"].to_numpy())[0] == 20_000
