"""A recording -> AR.Drone navdata: the packets of UDP port 5554, raw or as a capture with the AT commands.

Packet, little-endian: u32 0x55667788, u32 state, u32 sequence, u32 vision flag, then options of u16 tag,
u16 size (these 4 bytes included), body; the last is 0xFFFF with the sum of all bytes before it. Options
written: 1 time (11 bits of seconds, 21 of microseconds), 0 demo (theta, phi, psi in millidegrees, altitude
in mm, vx, vy in mm/s), 6 references (commanded tilt, millidegrees), 9 pwm (vz_ref, mm/s), 10 altitude
(altitude_vz, mm/s). Nose up and right are positive in theta and phi.

In the capture commands go to port 5556 as AT*PCMD (shares of the limits, float bits printed as integers),
after the AT*CONFIG that give the limits: without those nobody can scale a log.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.ingest.formats.ardrone.layouts import AT_PORT, NAVDATA_PORT
from flysid.ingest.formats.common.clock import SECOND_NS
from flysid.ingest.synth.telemetry import (
    IntArray,
    Recording,
    arrival_utc_ns,
    as_bytes,
    heard,
    in_sending_order,
)
from flysid.ingest.synth.writers.ros_messages import LIMITS, fraction

MAGIC = 0x55667788
FLYING_STATE = 0x0F8000D1  # flying, everything works
HOVERING = 4 << 16
DRONE = bytes((192, 168, 1, 1))
GROUND = bytes((192, 168, 1, 2))
YAW_LIMIT = 1.745

OPTIONS: tuple[tuple[int, str, int, tuple[tuple[str, str], ...]], ...] = (
    (1, "time", 8, (("time", "<u4"),)),
    (0, "demo", 148, (("ctrl_state", "<u4"), ("battery", "<u4"), ("theta", "<f4"), ("phi", "<f4"),
                      ("psi", "<f4"), ("altitude", "<i4"), ("vx", "<f4"), ("vy", "<f4"), ("vz", "<f4"))),
    (6, "references", 88, (("ref_theta", "<i4"), ("ref_phi", "<i4"))),
    (9, "pwm", 76, (("motors", "8u1"), ("gaz", "3<f4"), ("vz_ref", "<f4"))),
    (10, "altitude", 56, (("altitude_vision", "<i4"), ("altitude_vz", "<f4"), ("altitude_ref", "<i4"),
                          ("altitude_raw", "<i4"))),
)  # fmt: skip


def navdata_bytes(recording: Recording) -> bytes:
    """All packets one after the other; what was lost leaves a gap in the sequence numbers."""
    kept = heard(recording, recording.state.time_ns)
    packets = as_bytes(_packets(recording))
    return b"".join(packets[i] for i in np.flatnonzero(kept).tolist())


def pcap_bytes(recording: Recording) -> bytes:
    """A capture of both ports at the ground station (Ethernet, IPv4, UDP; microseconds)."""
    packets = as_bytes(_packets(recording))
    commands = list(_commands(recording))
    due, source, row = in_sending_order(recording.command.time_ns, recording.state.time_ns)
    arrival = arrival_utc_ns(recording, due)
    parts = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)]
    parts += [_capture(int(arrival[0]), text, AT_PORT) for text in _configuration()]
    for i in np.flatnonzero(heard(recording, due)).tolist():
        payload, port = (packets[row[i]], NAVDATA_PORT) if source[i] else (commands[row[i]], AT_PORT)
        parts.append(_capture(int(arrival[i]), payload, port))
    return b"".join(parts)


def _dtype() -> np.dtype[Any]:
    """The whole packet; bytes of an option that are not named stay zero."""
    names = ["magic", "state", "sequence", "vision"]
    formats = ["<u4"] * 4
    offsets = [0, 4, 8, 12]
    at = 16
    for _, name, size, fields in OPTIONS:
        names += [f"{name}.tag", f"{name}.size"]
        formats += ["<u2", "<u2"]
        offsets += [at, at + 2]
        inside = at + 4
        for field, code in fields:
            names.append(field)
            formats.append(f"({code[0]},){code[1:]}" if code[0].isdigit() else code)
            offsets.append(inside)
            inside += np.dtype(formats[-1]).itemsize
        at += size
    names += ["end.tag", "end.size", "checksum"]
    formats += ["<u2", "<u2", "<u4"]
    offsets += [at, at + 2, at + 4]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at + 8})


def _packets(recording: Recording) -> npt.NDArray[np.void]:
    state = recording.state
    rows: npt.NDArray[np.void] = np.zeros(len(state), dtype=_dtype())
    rows["magic"], rows["state"], rows["sequence"] = MAGIC, FLYING_STATE, np.arange(1, len(state) + 1)
    for tag, name, size, _ in OPTIONS:
        rows[f"{name}.tag"] = tag
        rows[f"{name}.size"] = size
    rows["time"] = _wrapped_time(state.time_ns)
    rows["ctrl_state"] = HOVERING
    rows["battery"] = 90
    rows["theta"], rows["phi"], rows["psi"] = (
        1000.0 * v for v in (-state["theta"], state["phi"], state["psi"])
    )
    rows["vx"], rows["vy"] = 1000.0 * state["vx"], 1000.0 * state["vy"]
    height_mm = np.round(1000.0 * (state["z"] + recording.start_height_m))
    rows["altitude"] = rows["altitude_vision"] = rows["altitude_raw"] = height_mm
    rows["altitude_vz"] = 1000.0 * state["vz"]
    at = np.maximum(np.searchsorted(recording.command.time_ns, state.time_ns, side="right") - 1, 0)
    rows["ref_theta"] = np.round(-1000.0 * recording.command["theta_in"][at])
    rows["ref_phi"] = np.round(1000.0 * recording.command["phi_in"][at])
    rows["vz_ref"] = 1000.0 * recording.command["vz_in"][at]
    rows["end.tag"] = 0xFFFF
    rows["end.size"] = 8
    matrix = rows.view(np.uint8).reshape(len(rows), -1)
    rows["checksum"] = matrix[:, :-8].sum(axis=1, dtype=np.uint32)
    return rows


def _wrapped_time(time_ns: IntArray) -> IntArray:
    """11 bits of seconds above 21 bits of microseconds; wraps after 2,048 s."""
    microseconds = time_ns // 1000
    return np.asarray((microseconds // 1_000_000 % 2048 << 21) | microseconds % 1_000_000, dtype=np.int64)


def _configuration() -> Iterator[bytes]:
    limits = {"euler_angle_max": np.radians(LIMITS["theta_in"]), "control_vz_max": 1000 * LIMITS["vz_in"],
              "control_yaw": YAW_LIMIT}  # fmt: skip
    for number, (key, value) in enumerate(limits.items(), start=1):
        yield f'AT*CONFIG={number},"control:{key}","{value:.6g}"\r'.encode()


def _commands(recording: Recording) -> Iterator[bytes]:
    """One AT*PCMD per command: roll right, pitch nose up, climb up, yaw right; sequence numbers rise."""
    shares = np.column_stack(
        [fraction(recording, "phi_in"), -fraction(recording, "theta_in"), fraction(recording, "vz_in")]
    )
    bits = shares.astype("<f4").view("<i4").tolist()
    for number, (roll, pitch, climb) in enumerate(bits, start=10):
        yield f"AT*PCMD={number},1,{roll},{pitch},{climb},0\r".encode()


def _capture(time_ns: int, payload: bytes, port: int) -> bytes:
    """One captured frame: the drone answers on 5554, the ground station commands on 5556."""
    source, target = (DRONE, GROUND) if port == NAVDATA_PORT else (GROUND, DRONE)
    udp = struct.pack(">HHHH", port, port, 8 + len(payload), 0) + payload
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(udp), 0, 0x4000, 64, 17, 0, source, target)
    total = sum(struct.unpack(">10H", head))
    total = (total & 0xFFFF) + (total >> 16)
    checked = head[:10] + struct.pack(">H", ~((total & 0xFFFF) + (total >> 16)) & 0xFFFF) + head[12:]
    frame = b"\x02\0\0\0\0\x02" + b"\x02\0\0\0\0\x01" + b"\x08\x00" + checked + udp
    stamp = struct.pack("<IIII", time_ns // SECOND_NS, time_ns % SECOND_NS // 1000, len(frame), len(frame))
    return stamp + frame
