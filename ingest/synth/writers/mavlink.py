"""A recording -> MAVLink 2 telemetry log (.tlog), encoded by pymavlink.

Layout: for every message 8 bytes of big-endian microseconds (UTC of arrival at the ground), then the frame as
it came over the link. Vehicle time travels as time_boot_ms, so sources are sampled at whole milliseconds.

Signs (FRD body, NED local frame): nose-up pitch = -theta, roll = phi, yaw = psi, down = -z; the recording's
velocities are along the heading and are turned north and east.
Commanded tilt is ATTITUDE_TARGET.q (w, x, y, z), the commanded climb SET_POSITION_TARGET_LOCAL_NED.vz.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.formats.common.clock import SECOND_NS
from flysid.ingest.synth.telemetry import (
    MS_NS,
    Recording,
    Telemetry,
    arrival_utc_ns,
    heard,
    in_sending_order,
    throttle,
)

COMPONENT = 1
ONLY_ATTITUDE = 0b00000111  # ATTITUDE_TARGET: body rates are to be ignored
ONLY_VZ = 0b0000_1101_1101_1111  # SET_POSITION_TARGET: everything but vz is to be ignored

Message = Any
Encoder = Callable[[Any, int], Message]


def tlog_bytes(recording: Recording) -> bytes:
    """The whole log. Messages that were lost leave a gap in the sequence numbers, as on a real link."""
    due = in_sending_order(*(times for times, _ in _sources(recording)))[0]
    arrival_us = arrival_utc_ns(recording, due)[heard(recording, due)] // 1000
    frames = (frame for _, frame in timed_frames(recording))
    return b"".join(
        struct.pack(">Q", stamp) + frame for stamp, frame in zip(arrival_us.tolist(), frames, strict=True)
    )


def timed_frames(recording: Recording) -> Iterator[tuple[int, bytes]]:
    """(vehicle time in ns, frame) of every message that arrives, in the order they are sent."""
    from pymavlink.dialects.v20 import common

    sources = _sources(recording)
    due, kind, row = in_sending_order(*(times for times, _ in sources))
    link = common.MAVLink(None, srcSystem=recording.system, srcComponent=COMPONENT)
    for i in np.flatnonzero(heard(recording, due)).tolist():
        link.seq = i & 0xFF
        message = sources[kind[i]][1](link, int(row[i]))
        yield int(due[i]), bytes(message.pack(link))


def _sources(recording: Recording) -> list[tuple[Any, Encoder]]:
    """(send times, encoder of one row) per message type; ties are sent in this order."""
    command = recording.command
    state = recording.state
    first = int(state.time_ns[0])
    last = int(state.time_ns[-1])
    beats = np.arange(first, last + 1, SECOND_NS, dtype=np.int64)
    return [
        (beats, _heartbeat),
        (command.time_ns, _attitude_target(command, throttle(recording, command.time_ns))),
        (command.time_ns, _climb_target(command, recording.system)),
        (state.time_ns, _attitude(state)),
        (state.time_ns, _local_position(state)),
    ]


def _heartbeat(link: Any, _: int) -> Message:
    from pymavlink.dialects.v20 import common

    return link.heartbeat_encode(
        common.MAV_TYPE_QUADROTOR,
        common.MAV_AUTOPILOT_GENERIC,
        common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_GUIDED_ENABLED,
        0,
        common.MAV_STATE_ACTIVE,
    )


def _attitude_target(command: Telemetry, thrust: FloatArray) -> Encoder:
    time_ms = command.time_ns // MS_NS
    q = quaternion(np.radians(command["phi_in"]), -np.radians(command["theta_in"]))

    def encode(link: Any, k: int) -> Message:
        return link.attitude_target_encode(
            int(time_ms[k]), ONLY_ATTITUDE, q[k].tolist(), 0.0, 0.0, 0.0, float(thrust[k])
        )

    return encode


def _climb_target(command: Telemetry, system: int) -> Encoder:
    from pymavlink.dialects.v20 import common

    time_ms = command.time_ns // MS_NS
    down = -command["vz_in"]
    frame = common.MAV_FRAME_LOCAL_NED

    def encode(link: Any, k: int) -> Message:
        velocity = (0.0, 0.0, float(down[k]))
        return link.set_position_target_local_ned_encode(
            int(time_ms[k]), system, COMPONENT, frame, ONLY_VZ, *(0.0,) * 3, *velocity, *(0.0,) * 5
        )

    return encode


def _attitude(state: Telemetry) -> Encoder:
    time_ms = state.time_ns // MS_NS
    angles = np.radians(np.column_stack([state["phi"], -state["theta"], state["psi"]]))
    rates = np.gradient(angles, state.time_ns * 1e-9, axis=0)

    def encode(link: Any, k: int) -> Message:
        return link.attitude_encode(int(time_ms[k]), *angles[k].tolist(), *rates[k].tolist())

    return encode


def _local_position(state: Telemetry) -> Encoder:
    time_ms = state.time_ns // MS_NS
    c = np.cos(np.radians(state["psi"]))
    s = np.sin(np.radians(state["psi"]))
    north = c * state["vx"] - s * state["vy"]
    east = s * state["vx"] + c * state["vy"]
    ned = np.column_stack([state["x"], state["y"], -state["z"], north, east, -state["vz"]])

    def encode(link: Any, k: int) -> Message:
        return link.local_position_ned_encode(int(time_ms[k]), *ned[k].tolist())

    return encode


def quaternion(roll_rad: FloatArray, pitch_rad: FloatArray) -> FloatArray:
    """(N, 4) w, x, y, z of roll after pitch at heading 0 (Z-Y-X Euler angles)."""
    cr = np.cos(roll_rad / 2)
    sr = np.sin(roll_rad / 2)
    cp = np.cos(pitch_rad / 2)
    sp = np.sin(pitch_rad / 2)
    return np.column_stack([cr * cp, sr * cp, cr * sp, -sr * sp])
