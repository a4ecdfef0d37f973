"""Flight modes have names: by vehicle, by firmware, by release. A number without one names its vehicle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flysid.facts.modes import all_names, family_by_parameters, family_of, mode_names, mode_texts
from tests.command import call
from tests.parameter_trials import written

HEARTBEAT = ("1.1/HEARTBEAT", "custom_mode")
STATUS = ("vehicle_status", "nav_state")
TYPES = {
    number: entry.name.removeprefix("MAV_TYPE_").lower()
    for number, entry in mavlink.enums["MAV_TYPE"].items()
}


@pytest.mark.parametrize("kind", sorted(mavutil.AP_MAV_TYPE_MODE_MAP))
def test_every_vehicle_of_ardupilot_has_the_modes_that_pymavlink_lists(kind: int) -> None:
    known = mode_names(*HEARTBEAT, {"autopilot": "ardupilotmega", "vehicle": TYPES[kind]})
    listed = mavutil.mode_mapping_bynumber(kind)
    assert {number: known.get(number) for number in listed} == listed


@pytest.mark.parametrize("name", sorted(name for name in TYPES.values() if name.startswith("vtol")))
def test_a_vtol_of_ardupilot_is_a_plane(name: str) -> None:
    assert family_of(name) == "plane"


@pytest.mark.parametrize(
    ("firmware", "number", "name"),
    [
        ("1.10.1", 6, "AUTO_RCRECOVER"),
        ("1.15.0", 6, "POSITION_SLOW"),
        ("1.13.0", 6, "mode 6 (px4, vehicle type unknown)"),
        ("", 6, "mode 6 (px4, vehicle type unknown)"),
        ("", 5, "AUTO_RTL"),
        ("1.11.3", 16, "RATTITUDE"),
        ("1.12.0", 16, "mode 16 (px4, vehicle type unknown)"),
        ("1.14.3", 23, "mode 23 (px4, vehicle type unknown)"),
        ("1.15.0", 23, "EXTERNAL1"),
        ("1.16.1", 8, "mode 8 (px4, vehicle type unknown)"),
        ("1.17.0", 8, "ALTITUDE_CRUISE"),
        ("1.10.1", 7, "AUTO_RTGS"),
        ("1.17.0", 7, "mode 7 (px4, vehicle type unknown)"),
        ("1.18.0", 7, "GUIDED_COURSE"),
    ],
)
def test_px4_counts_anew_from_release_to_release(firmware: str, number: int, name: str) -> None:
    assert mode_texts([number], *STATUS, {"autopilot": "px4", "firmware": firmware}) == [name]


@pytest.mark.parametrize("name", sorted(mavutil.px4_map))
def test_a_heartbeat_of_px4_names_main_mode_and_the_mode_below(name: str) -> None:
    _, main, sub = mavutil.px4_map[name]
    [word] = mode_texts([main << 16 | sub << 24], *HEARTBEAT, {"autopilot": "px4"})
    same = {"STABILIZED": "STAB", "FOLLOWME": "AUTO_FOLLOW_TARGET"}
    assert word in (same.get(name, name), f"AUTO_{name}")


@pytest.mark.parametrize(
    ("autopilot", "firmware", "flags", "name"),
    [
        ("betaflight", "3.1.3", 1 << 27, "ACRO"),  # air mode alone
        ("betaflight", "4.2.9", 0b11, "ANGLE"),
        ("betaflight", "4.5.0", 1 | 1 << 7, "GPSRESCUE"),
        ("betaflight", "3.5.0", 1 | 1 << 10, "GPSRESCUE"),
        ("betaflight", "2025.12.0", 1 | 1 << 9 | 1 << 1, "POSHOLD"),
        ("inav", "7.1.0", 1 | 1 << 8 | 1 << 1, "NAVRTH"),
        ("inav", "7.1.0", 1 | 1 << 35, "NAVCOURSEHOLD"),
        ("emuflight", "0.4.3", 1 | 1 << 1 | 1 << 8, "NFE_RACE"),
        ("emuflight", "0.4.3", 1 | 1 << 9, "ACRO"),  # gravity compensation alone
        ("rotorflight", "4.5.0", 1 | 1 << 5 | 1 << 1, "RESCUE"),
        ("rotorflight", "4.5.0", 1 | 1 << 10, "ACRO"),
    ],
)
def test_flags_of_a_blackbox_are_modes(autopilot: str, firmware: str, flags: int, name: str) -> None:
    info = {"autopilot": autopilot, "firmware": firmware}
    assert mode_texts([flags], "slow", "flightModeFlags", info) == [name]


def test_a_value_that_is_missing_is_no_mode() -> None:
    assert mode_texts([float("nan"), 3], *STATUS, {"autopilot": "px4"}) == ["", "AUTO_MISSION"]


def test_parameters_tell_the_firmware_where_no_banner_does() -> None:
    assert family_by_parameters(["RTL_ALT", "SUPER_SIMPLE"]) == "copter"
    assert family_by_parameters(["SUPER_SIMPLE", "KFF_RDDRMIX"]) == ""
    assert family_by_parameters(["RTL_ALT"]) == ""


def test_names_are_of_every_firmware() -> None:
    assert {"RTL", "QRTL", "AUTO_RTL", "SURFACE", "SCAN", "VELOCITY"} <= all_names()


def _flight(kind: int, autopilot: int, numbers: list[int]) -> bytes:
    messages: list[tuple[tuple[int, int], Any]] = []
    for second in range(10 * len(numbers)):
        mode = numbers[second // 10]
        messages.append(((1, 1), mavlink.MAVLink_heartbeat_message(kind, autopilot, 129, mode, 4, 3)))
        messages += [((1, 1), mavlink.MAVLink_attitude_message(1000 * second, 0, 0, 0, 0, 0, 0))] * 2
    return written(messages)


@pytest.mark.parametrize(
    ("kind", "autopilot", "numbers", "words"),
    [
        (mavlink.MAV_TYPE_GROUND_ROVER, 3, [0, 11], ["MANUAL", "RTL"]),
        (mavlink.MAV_TYPE_VTOL_TILTROTOR, 3, [18, 21], ["QHOVER", "QRTL"]),
        (mavlink.MAV_TYPE_SUBMARINE, 3, [9], ["SURFACE"]),
        (mavlink.MAV_TYPE_QUADROTOR, 12, [4 << 16 | 5 << 24], ["AUTO_RTL"]),
        (mavlink.MAV_TYPE_QUADROTOR, 3, [42], ["mode 42 (quadrotor)"]),
    ],
)
def test_show_prints_the_modes_by_name(
    tmp_path: Path, kind: int, autopilot: int, numbers: list[int], words: list[str]
) -> None:
    log = tmp_path / "f.tlog"
    log.write_bytes(_flight(kind, autopilot, numbers))
    printed = call("show", log, "--events", cwd=tmp_path).stdout
    assert [line.split("mode", 1)[1].strip() for line in printed.splitlines()] == words


@pytest.mark.parametrize(
    ("lines", "word"),
    [
        (
            [("HEARTBEAT", {"type": 10, "autopilot": 3, "base_mode": 209, "custom_mode": 11})],
            "RTL",
        ),
        (
            [("MSG", {"Message": "ArduSub V4.1.0"}), ("MODE", {"ModeNum": 9, "Mode": 9})],
            "SURFACE",
        ),
    ],
)
def test_what_mavlogdump_printed_has_modes_by_name(
    tmp_path: Path, lines: list[tuple[str, dict[str, Any]]], word: str
) -> None:
    log = tmp_path / "f.json"
    printed = []
    for second in range(20):
        for kind, data in lines:
            meta = {"type": kind, "timestamp": 1_700_000_000.0 + second}
            clock = {} if kind == "HEARTBEAT" else {"TimeUS": 1_000_000 * second}
            printed.append(json.dumps({"meta": meta, "data": clock | data}))
    log.write_text("\n".join(printed) + "\n")
    assert word in call("show", log, "--events", cwd=tmp_path).stdout
