"""A Crazyflie's uSD log of version 2: a fixed rate beside two kinds of events, as the firmware packs them."""

from __future__ import annotations

import math
import struct
import zlib

from tests.samplelogs import Record, record_at

SUFFIX = ".usd"
KNOWS_ITS_END = True
UNCHECKED = True
RESYNC_BYTES = (
    33  # an event counts where the head behind it is sound; garbage at the end takes the checksum along
)
FIXED = 0xFFFF
RANGE = 0
MARK = 7
KINDS: dict[int, tuple[str, list[str]]] = {
    FIXED: (
        "fixedFrequency",
        [*(f"gyro.{a}(f)" for a in "xyz"), "stabilizer.roll(f)", "motor.m1(H)", "pm.state(b)"],
    ),
    RANGE: ("estTOF", ["distance(f)", "range.zrange(H)"]),
    MARK: ("mark", []),
}
COUNT = 400


def header(version: int = 2) -> bytes:
    """What the events hold."""
    out = struct.pack("<BHH", 0xBC, version, len(KINDS))
    for number, (name, variables) in KINDS.items():
        words = b"".join(word.encode() + b"\0" for word in variables)
        out += struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(variables)) + words
    return out


def payload(number: int, k: int) -> bytes:
    """The variables of the k-th event of a kind."""
    if number == FIXED:
        turn = [30 * math.sin(0.1 * k + phase) for phase in range(3)]
        return struct.pack("<ffffHb", *turn, 5 * math.cos(0.05 * k), 30_000 + 7 * k, k % 3)
    return struct.pack("<fH", 0.4 + 0.001 * k, 400 + k) if number == RANGE else b""


def events(version: int = 2) -> list[bytes]:
    """Events in order: 100 Hz, every fourth followed by a range, every hundredth by a mark."""
    found = []
    for k in range(COUNT):
        numbers = [FIXED] + [RANGE] * (k % 4 == 0) + [MARK] * (k % 100 == 50)
        for place, number in enumerate(numbers):
            time_us = 12_345_678 + 10_000 * k + 1_300 * place
            head = (
                struct.pack("<HQ", number, time_us)
                if version == 2
                else struct.pack("<HI", number, time_us // 1000)
            )
            found.append(head + payload(number, k))
    return found


def build(version: int = 2) -> bytes:
    """The whole log with its checksum."""
    body = header(version) + b"".join(events(version))
    return body + struct.pack("<I", zlib.crc32(body))


def records(blob: bytes) -> list[Record]:
    """The header, every event, and the checksum."""
    at = len(header())
    found = [Record(0, at, 0)]
    for event in events():
        found.append(Record(at, at + len(event), 1))
        at += len(event)
    return [*found, Record(at, len(blob), 0)]


def at_risk(blob: bytes, byte: int) -> int:
    """The header decides over everything; an event over itself."""
    hit = record_at(records(blob), byte)
    return len(events()) if hit.start == 0 else hit.rows
