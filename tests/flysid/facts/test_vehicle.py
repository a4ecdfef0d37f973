"""Whose flight a log is: told by the autopilot alone, and the same for every verb."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flysid.facts.vehicle import label_of, vehicle_of
from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import find_format
from tests.command import call
from tests.parameter_trials import written

LOGS = Path(__file__).parents[3] / ".." / "shared" / "logs"


def version(number: int, release: int) -> Any:
    empty = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        0, release << 24, 0, 0, 0, empty, empty, empty, 0, 0, 0, [number] * 18
    )


def read(messages: list[tuple[tuple[int, int], Any]], batch_bytes: int = 1 << 20) -> Flight:
    blob = memoryview(written(messages))
    return collect(blob, "f.tlog", find_format("tlog"), Limits(batch_bytes=batch_bytes))


def beats(count: int) -> list[tuple[tuple[int, int], Any]]:
    """Heartbeats and attitudes of an autopilot."""
    found: list[tuple[tuple[int, int], Any]] = []
    for second in range(count):
        found.append(((7, 1), mavlink.MAVLink_heartbeat_message(2, 3, 209, 0, 4, 3)))
        found.append(((7, 1), mavlink.MAVLink_attitude_message(1000 * second, 0, 0, 0, 0, 0, 0)))
    return found


@pytest.mark.parametrize("batch_bytes", [300, 1 << 20])
def test_the_board_is_the_autopilots_whenever_it_states_it(batch_bytes: int) -> None:
    """The version came last, or a camera's did: the log took the camera's number for the vehicle's."""
    late = [
        *beats(40),
        ((7, 1), version(1, 4)),
        *beats(3),
        ((7, 154), version(9, 2)),
        ((8, 1), version(5, 3)),
    ]
    info = read(late, batch_bytes).info
    assert info["uid2"] == "01" * 18
    assert info["firmware"] == "4.0.0"
    assert info["vehicle"] == "quadrotor"


def test_a_second_vehicle_lends_the_first_nothing() -> None:
    second = [((9, 1), mavlink.MAVLink_heartbeat_message(1, 12, 209, 0, 4, 3)), ((9, 1), version(3, 1))]
    info = read([*second, *beats(40)]).info
    assert (info["autopilot"], info["vehicle"]) == ("ardupilotmega", "quadrotor")
    assert "uid2" not in info


def test_telemetry_and_the_log_on_board_name_one_vehicle() -> None:
    board = {"autopilot": "ardupilot", "vehicle": "rover"}
    assert vehicle_of(board) == vehicle_of({"autopilot": "ardupilotmega", "vehicle": "surface_boat"})
    assert label_of(board) == "rover"
    assert label_of({}) == "-"


@pytest.mark.skipif(not LOGS.is_dir(), reason="needs ../shared/logs")
@pytest.mark.parametrize("verb", [["gains"], ["tf", "-r", "betaflight-rate", "-c", "roll_rate"]])
def test_flights_of_two_vehicles_are_pooled_by_no_verb(tmp_path: Path, verb: list[str]) -> None:
    """`gains` put two vehicles together that `tf` refuses."""
    for name in ("short_4kB.bfl", "btfl_002.bbl"):
        shutil.copy(LOGS / "blackbox" / name, tmp_path)
    done = call(verb[0], tmp_path, *verb[1:], cwd=tmp_path)
    assert done.returncode == 2
    assert "flights of 2 vehicles" in done.stderr
    assert "--vehicle" in done.stderr


@pytest.mark.skipif(not LOGS.is_dir(), reason="needs ../shared/logs")
def test_gains_takes_one_of_two_vehicles(tmp_path: Path) -> None:
    for name in ("short_4kB.bfl", "btfl_002.bbl"):
        shutil.copy(LOGS / "blackbox" / name, tmp_path)
    done = call("gains", tmp_path, "--vehicle", "MAMBA", cwd=tmp_path)
    assert "flights of 2 vehicles" not in done.stderr
    assert done.returncode in (0, 3)
