"""A recording -> PX4 ULog (.ulg): the log that a PX4 vehicle would have written.

Header: magic, version 1, start time. Then records of u16 size, u8 kind, body: B flags, F formats, I
information, A subscriptions, D data. Topics are PX4's: vehicle_attitude_setpoint (q_d), vehicle_attitude
(q), vehicle_local_position_setpoint (vz) and vehicle_local_position (north-east-down); and, where the vehicle
has rotors, vehicle_angular_velocity, vehicle_thrust_setpoint and vehicle_torque_setpoint. Times are
microseconds since boot. There is no radio: nothing arrives late; a drop-out is a pause of the logger,
written as an O record.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.ingest.formats.common.clock import SECOND_NS
from flysid.ingest.synth.telemetry import (
    MS_NS,
    Recording,
    Telemetry,
    as_bytes,
    heard,
    in_sending_order,
    throttle,
)
from flysid.ingest.synth.writers.mavlink import quaternion

MAGIC = b"ULog\x01\x12\x35\x01"
TYPES = {
    "<u8": "uint64_t",
    "<f8": "double",
    "<f4": "float",
    "<u4": "uint32_t",
    "<i4": "int32_t",
    "<u2": "uint16_t",
    "u1": "uint8_t",
    "?": "bool",
}
Fields = list[tuple[str, str]]

SETPOINT: Fields = [
    ("timestamp", "<u8"),
    ("yaw_sp_move_rate", "<f4"),
    ("q_d", "4<f4"),
    ("thrust_body", "3<f4"),
]
ATTITUDE: Fields = [("timestamp", "<u8"), ("timestamp_sample", "<u8"), ("q", "4<f4")]
CLIMB: Fields = [("timestamp", "<u8"), *((n, "<f4") for n in ("x", "y", "z", "yaw", "vx", "vy", "vz"))]
POSITION: Fields = [
    ("timestamp", "<u8"), ("timestamp_sample", "<u8"),
    *((n, "<f4") for n in ("x", "y", "z", "vx", "vy", "vz", "heading")),
]  # fmt: skip
VECTOR: Fields = [("timestamp", "<u8"), ("timestamp_sample", "<u8"), ("xyz", "3<f4")]
TOPICS = {
    "vehicle_attitude_setpoint": SETPOINT,
    "vehicle_local_position_setpoint": CLIMB,
    "vehicle_attitude": ATTITUDE,
    "vehicle_local_position": POSITION,
}
ROTORS = dict.fromkeys(
    ("vehicle_angular_velocity", "vehicle_thrust_setpoint", "vehicle_torque_setpoint"), VECTOR
)
RELEASE = 0x010F02FF  # 1.15.2


def topics(recording: Recording) -> dict[str, npt.NDArray[np.void]]:
    """The rows of every topic, in the order in which what is due at once is written."""
    command = recording.command
    state = recording.state
    found = {
        "vehicle_attitude_setpoint": _setpoint(recording),
        "vehicle_local_position_setpoint": _climb(command),
        "vehicle_attitude": _attitude(state),
        "vehicle_local_position": _position(state),
    }
    return found | _efforts(state) if "throttle" in state.values else found


def facts(recording: Recording) -> dict[str, str]:
    """What the log says of the vehicle: its own number in its fleet, in the 24 digits of a board's."""
    return {"sys_name": "PX4", "ver_hw": "FLYSID_SYNTH", "sys_uuid": f"{recording.system:024d}"}


def ulog_bytes(recording: Recording) -> bytes:
    """The whole log."""
    tables = topics(recording)
    raw = [as_bytes(table) for table in tables.values()]
    due, topic, row = in_sending_order(*(1000 * t["timestamp"].astype(np.int64) for t in tables.values()))
    pieces = [_preamble(recording, list(tables))]
    pauses = sorted(recording.lost)
    reached = heard(recording, due)
    for i in range(len(due)):
        while pauses and due[i] >= pauses[0][1]:
            start, end = pauses.pop(0)
            pieces.append(record("O", struct.pack("<H", min((end - start) // MS_NS, 0xFFFF))))
        if reached[i]:
            pieces.append(record("D", struct.pack("<H", topic[i]) + raw[topic[i]][row[i]]))
    return b"".join(pieces)


def record(kind: str, body: bytes) -> bytes:
    """One record of a log."""
    return struct.pack("<HB", len(body), ord(kind)) + body


def row_type(fields: Fields) -> np.dtype[Any]:
    """Of the rows of a topic."""
    parts = [
        (name, code[1:], (int(code[0]),)) if code[0].isdigit() else (name, code) for name, code in fields
    ]
    return np.dtype(parts)


def _preamble(recording: Recording, names: Sequence[str]) -> bytes:
    first_ns = int(recording.state.time_ns[0])
    utc_us = (recording.boot_utc_ns + first_ns) // SECOND_NS * 1_000_000
    layouts = TOPICS | ROTORS
    return preamble({name: layouts[name] for name in names}, facts(recording), first_ns // 1000, utc_us)


def preamble(
    layouts: Mapping[str, Fields],
    stated: Mapping[str, str],
    first_us: int,
    utc_us: int = 0,
    parameters: Mapping[str, float] = MappingProxyType({}),
) -> bytes:
    """What comes before the data: formats, facts, parameters and subscriptions, numbered as they stand.

    `layouts`: topic -> its fields; "topic#1" for its second instance.
    `stated`: facts about the vehicle.
    `first_us`, `utc_us`: time since boot at which the log begins, and the time of day then; 0 for unknown.
    `parameters`: written as integers where they are.
    """
    parts = [MAGIC + struct.pack("<Q", first_us), record("B", bytes(40))]
    topics = [(name, *name.partition("#")[::2]) for name in layouts]
    for name, topic, instance in topics:
        if not instance:
            declared = "".join(map(_declare, layouts[name]))
            parts.append(record("F", f"{topic}:{declared}".encode()))
    known = [(f"char[{len(value)}] {name}", value.encode()) for name, value in stated.items()]
    release = ("uint32_t ver_sw_release", struct.pack("<I", RELEASE))
    for key, value in (*known, release, ("uint64_t time_ref_utc_us", struct.pack("<Q", utc_us))):
        parts.append(record("I", _keyed(key, value)))
    for name, number in parameters.items():
        whole = isinstance(number, int)
        packed = struct.pack("<i" if whole else "<f", number)
        parts.append(record("P", _keyed(f"{'int32_t' if whole else 'float'} {name}", packed)))
    for i, (_, topic, instance) in enumerate(topics):
        parts.append(record("A", struct.pack("<BH", int(instance or 0), i) + topic.encode()))
    return b"".join(parts)


def _keyed(key: str, value: bytes) -> bytes:
    return bytes([len(key)]) + key.encode() + value


def _declare(field: tuple[str, str]) -> str:
    name, code = field
    count = f"[{code[0]}]" if code[0].isdigit() else ""
    return f"{TYPES[code.lstrip('0123456789')]}{count} {name};"


def _table(series: Telemetry, fields: Fields) -> npt.NDArray[np.void]:
    rows: npt.NDArray[np.void] = np.zeros(len(series), dtype=row_type(fields))
    rows["timestamp"] = series.time_ns // 1000
    if "timestamp_sample" in (rows.dtype.names or ()):
        rows["timestamp_sample"] = rows["timestamp"]
    return rows


def _setpoint(recording: Recording) -> npt.NDArray[np.void]:
    command = recording.command
    rows = _table(command, SETPOINT)
    rows["q_d"] = quaternion(np.radians(command["phi_in"]), -np.radians(command["theta_in"]))
    rows["thrust_body"][:, 2] = -throttle(recording, command.time_ns)
    return rows


def _climb(command: Telemetry) -> npt.NDArray[np.void]:
    rows = _table(command, CLIMB)
    for name in ("x", "y", "z", "yaw", "vx", "vy"):
        rows[name] = np.nan  # PX4 leaves what is not controlled undefined
    rows["vz"] = -command["vz_in"]
    return rows


def _attitude(state: Telemetry) -> npt.NDArray[np.void]:
    rows = _table(state, ATTITUDE)
    tilt = quaternion(np.radians(state["phi"]), -np.radians(state["theta"]))
    rows["q"] = _turn(tilt, np.radians(state["psi"]))
    return rows


def _turn(q: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """(N, 4) yaw applied before (to the left of) the tilt q."""
    c = np.cos(yaw_rad / 2)[:, None]
    s = np.sin(yaw_rad / 2)[:, None]
    w = q[:, :1]
    x = q[:, 1:2]
    y = q[:, 2:3]
    z = q[:, 3:]
    return np.hstack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])


def _efforts(state: Telemetry) -> dict[str, npt.NDArray[np.void]]:
    """Rates, and what controllers ask of the rotors (half at hover); axes forward, right, down."""
    rates, thrust, torque = (_table(state, VECTOR) for _ in range(3))
    rates["xyz"] = np.radians(np.column_stack([state["p"], -state["q"], -state["r"]]))
    thrust["xyz"][:, 2] = -np.clip(0.5 * state["throttle"], 0.0, 1.0)
    torque["xyz"] = 0.5 * np.column_stack([state[f"{axis}_effort"] for axis in ("roll", "pitch", "yaw")])
    return {
        "vehicle_angular_velocity": rates,
        "vehicle_thrust_setpoint": thrust,
        "vehicle_torque_setpoint": torque,
    }


def _position(state: Telemetry) -> npt.NDArray[np.void]:
    rows = _table(state, POSITION)
    c = np.cos(np.radians(state["psi"]))
    s = np.sin(np.radians(state["psi"]))
    rows["x"], rows["y"], rows["z"] = state["x"], state["y"], -state["z"]
    rows["vx"], rows["vy"] = c * state["vx"] - s * state["vy"], s * state["vx"] + c * state["vy"]
    rows["vz"], rows["heading"] = -state["vz"], np.radians(state["psi"])
    return rows
