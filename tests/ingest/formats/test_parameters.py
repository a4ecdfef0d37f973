"""Parameters of MAVLink: integers as bytes (PX4) and as converted floats (ArduPilot), by sender."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

import flysid
from flysid.flight import Flight
from flysid.ingest.formats.base import Limits
from tests.command import call
from tests.parameter_trials import trials, values_in, written

PX4, ARDUPILOT, GENERIC = 12, 3, 0
INT32, REAL32 = 6, 9


def heartbeat(autopilot: int) -> Any:
    return mavlink.MAVLink_heartbeat_message(2, autopilot, 0, 0, 4, 3)


def value(name: str, number: float, kind: int = INT32, in_bytes: bool = True) -> Any:
    return mavlink.MAVLink_param_value_message(name.encode(), packed(number, kind, in_bytes), kind, 3, 0)


def packed(number: float, kind: int, in_bytes: bool) -> float:
    if kind == REAL32 or not in_bytes:
        return number
    return float(struct.unpack("<f", struct.pack("<i", int(number)))[0])


def log(folder: Path, messages: list[tuple[tuple[int, int], Any]]) -> Path:
    path = folder / "t.tlog"
    path.write_bytes(written(messages))
    return path


def test_integers_of_px4_are_whole_numbers(tmp_path: Path) -> None:
    """SYS_AUTOSTART was 5.607e-42 for 4001, and nan for -5."""
    told = [heartbeat(PX4), value("SYS_AUTOSTART", 4001), value("A", -5), value("MC_P", 6.5, REAL32)]
    log(tmp_path, [((1, 1), message) for message in told])
    assert call("ingest", "t.tlog", "-o", "data", cwd=tmp_path).returncode == 0
    (flight,) = [line for line in call("ls", "data", cwd=tmp_path).stdout.splitlines() if "t-" in line]
    done = call("show", "data", flight.split()[0], "--params", cwd=tmp_path)
    assert [
        line.split()[:2] for line in done.stdout.splitlines() if line.startswith(("SYS", "A ", "MC"))
    ] == [
        ["A", "-5"],
        ["MC_P", "6.5"],
        ["SYS_AUTOSTART", "4001"],
    ]


def test_capabilities_outweigh_the_autopilot_and_a_station_packs_as_its_target(tmp_path: Path) -> None:
    empty = [0] * 8
    can = mavlink.MAVLink_autopilot_version_message(131_072, 0, 0, 0, 0, empty, empty, empty, 0, 0, 0)
    sets = [
        (one, mavlink.MAVLink_param_set_message(one, 1, b"N", packed(77, INT32, one == 2), INT32))
        for one in (1, 2)
    ]
    told: list[tuple[tuple[int, int], Any]] = [
        *(((255, 190), message) for _, message in sets),
        ((1, 1), heartbeat(PX4)),
        ((1, 1), can),
        ((1, 1), value("N", 77, in_bytes=False)),
        ((2, 1), heartbeat(PX4)),
        ((2, 1), value("N", 77)),
    ]
    flight = flysid.read(log(tmp_path, told))
    assert values_in(flight, "1.1/PARAM_VALUE") == values_in(flight, "2.1/PARAM_VALUE") == {"N": 77.0}
    assert flight["255.190/PARAM_SET"]["param_value"].to_pylist() == [77.0, 77.0]


@pytest.mark.parametrize(("in_bytes", "numbers"), [(True, [4001, -5, 0]), (False, [4001, -5, 0])])
def test_values_tell_where_nothing_else_does(tmp_path: Path, in_bytes: bool, numbers: list[int]) -> None:
    told = [heartbeat(GENERIC), *(value(f"P{n}", n, in_bytes=in_bytes) for n in numbers)]
    flight = flysid.read(log(tmp_path, [((7, 1), message) for message in told]))
    assert list(values_in(flight, "7.1/PARAM_VALUE").values()) == numbers


@pytest.mark.parametrize("batch", [400, 8 << 20])
def test_an_encoding_is_remembered_from_batch_to_batch(tmp_path: Path, batch: int) -> None:
    told = [heartbeat(PX4), *(value(f"P{k}", k) for k in range(200))]
    path = log(tmp_path, [((1, 1), message) for message in told])
    flight = flysid.read(path, limits=Limits(batch_bytes=batch))
    assert values_in(flight, "1.1/PARAM_VALUE") == {f"P{k}": float(k) for k in range(200)}


@pytest.mark.parametrize(
    ("kind", "raw", "text"),
    [
        (6, struct.pack("<i", -4001), "-4001"),
        (10, struct.pack("<d", 0.125), "0.125"),
        (8, struct.pack("<q", 1 << 60), str(1 << 60)),
        (6, b"4001", "4001"),
        (11, b"anything", "anything"),
    ],
)
def test_extended_parameters_are_numbers_in_words(tmp_path: Path, kind: int, raw: bytes, text: str) -> None:
    message = mavlink.MAVLink_param_ext_value_message(b"CAM", raw.ljust(128, b"\0"), kind, 1, 0)
    flight = flysid.read(log(tmp_path, [((1, 100), heartbeat(8)), ((1, 100), message)] * 3))
    assert flight["PARAM_EXT_VALUE"]["param_value"].to_pylist() == [text] * 3


def test_what_mavlogdump_printed_is_read_alike_and_what_it_lost_is_named(tmp_path: Path) -> None:
    rows: list[tuple[str, dict[str, object]]] = [
        ("HEARTBEAT", {"type": 2, "autopilot": PX4, "base_mode": 0, "custom_mode": 0, "system_status": 4}),
        ("PARAM_VALUE", {"param_id": "SYS", "param_value": packed(4001, 6, True), "param_type": 6}),
        ("PARAM_VALUE", {"param_id": "NEG", "param_value": packed(-5, 6, True), "param_type": 6}),
        ("PARAM_VALUE", {"param_id": "P", "param_value": 0.5, "param_type": 9}),
    ]
    lines = [
        json.dumps(
            {"meta": {"type": kind, "timestamp": 1.7e9 + k, "srcSystem": 1, "srcComponent": 1}, "data": data}
        )
        for k, (kind, data) in enumerate(rows)
    ]
    (tmp_path / "t.json").write_text("\n".join(lines) + "\n")
    flight: Flight = flysid.read(tmp_path / "t.json")
    assert values_in(flight, "PARAM_VALUE") == {"SYS": 4001.0, "NEG": None, "P": 0.5}
    done = call("ingest", "t.json", "-o", "data", cwd=tmp_path)
    assert done.returncode == 3
    assert "PARAM_VALUE.param_value: 'NaN' in message 2 is not a number" in done.stderr


def test_drawn_logs_of_several_senders_keep_every_value(fresh_seed: int) -> None:
    """A failure names its seed: `tests.parameter_trials.draw(seed)` draws the log again."""
    outcome = trials(100, lambda: True, fresh_seed)
    assert not outcome.failures, "\n".join(outcome.failures)
    assert outcome.trials == 100
