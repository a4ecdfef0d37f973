"""A tlog as a ground station writes it: v1 and v2 frames, two senders, signed frames, 20 ms apart."""

from __future__ import annotations

import math
import struct
from typing import Any

from tests.samplelogs import Record

SUFFIX = ".tlog"
STEPS = 60
EPOCH_US = 1_700_000_000_000_000


def sender(system: int = 1, component: int = 1) -> Any:
    """pymavlink's encoder."""
    from pymavlink.dialects.v20 import ardupilotmega

    return ardupilotmega.MAVLink(None, srcSystem=system, srcComponent=component)


def frame(mav: Any, message: Any, *, v1: bool = False) -> bytes:
    """One encoded frame; the sequence number advances as it does on a link."""
    packed = bytes(message.pack(mav, force_mavlink1=v1))
    mav.seq = (mav.seq + 1) % 256
    return packed


def stamped(micros: int, packed: bytes) -> bytes:
    """A tlog record."""
    return struct.pack(">Q", micros) + packed


def build() -> bytes:
    """60 steps of 20 ms: attitude, position, now and then a heartbeat, a text, a ground station."""
    vehicle = sender()
    station = sender(255, 190)
    signed = sender()
    signed.signing.secret_key = bytes(range(32))
    signed.signing.sign_outgoing = True
    signed.signing.timestamp = 1
    out = []
    for i in range(STEPS):
        ms = 5000 + 20 * i
        micros = EPOCH_US + 20_000 * i
        angle = math.sin(0.1 * i)
        out.append(
            stamped(
                micros, frame(vehicle, vehicle.attitude_encode(ms, angle, 0.5, -1, 0, 0, 0), v1=i % 3 == 0)
            )
        )
        signed.seq = vehicle.seq
        position = vehicle.local_position_ned_encode(ms, i, -i, 2.5, 0.25, 0, 0)
        out.append(stamped(micros + 900, frame(signed if i % 10 == 5 else vehicle, position)))
        vehicle.seq = signed.seq if i % 10 == 5 else vehicle.seq
        if i % 10 == 0:
            out.append(stamped(micros + 1500, frame(vehicle, vehicle.heartbeat_encode(2, 3, 81, i, 4))))
            out.append(stamped(micros + 1700, frame(station, station.heartbeat_encode(6, 8, 0, 0, 4))))
        if i % 25 == 7:
            out.append(
                stamped(micros + 1900, frame(vehicle, vehicle.statustext_encode(6, f"step {i}".encode())))
            )
    return b"".join(out)


def records(blob: bytes) -> list[Record]:
    """Every frame with its timestamp; all lengths are as pymavlink wrote them."""
    found = []
    at = 0
    while at < len(blob):
        marker = blob[at + 8]
        size = blob[at + 9]
        total = size + 8 if marker == 0xFE else size + 12 + 13 * (blob[at + 10] & 1)
        found.append(Record(at, at + 8 + total, 1))
        at += 8 + total
    return found
