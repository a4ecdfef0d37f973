"""A small ULog with every kind of record, written here; the sample log of the contract tests."""

from __future__ import annotations

import struct

from tests.samplelogs import Record, record_at

SUFFIX = ".ulg"
UNCHECKED = True
HEAD = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
POINT = "point:float x;float y;"
TOPIC = (
    "topic:uint64_t timestamp;point p;uint16_t[3] arr;point[2] path;char[8] label;bool on;"
    "uint8_t[3] _padding0;"
)
OTHER = "other:uint64_t timestamp;double value;int32_t count;"


def record(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def named(key: str, value: bytes) -> bytes:
    return bytes([len(key)]) + key.encode() + value


def topic_payload(k: int, time_us: int) -> bytes:
    label = f"row {k}".encode().ljust(8, b"\0")
    return struct.pack("<Qff3H4f8s?", time_us, k, -k, k, k + 1, k + 2, 1, 2, 3, k / 3, label, k % 2 == 0)


def other_payload(k: int, time_us: int) -> bytes:
    return struct.pack("<Qdi", time_us, k / 7, -k)


def data(number: int, payload: bytes) -> bytes:
    return record("D", struct.pack("<H", number) + payload)


def subscribe(number: int, instance: int, name: str) -> bytes:
    return record("A", struct.pack("<BH", instance, number) + name.encode())


def definitions() -> bytes:
    """Flags, formats, information, parameters and their defaults."""
    return b"".join(
        [
            record("B", bytes(40)),
            record("F", POINT.encode()),
            record("F", TOPIC.encode()),
            record("F", OTHER.encode()),
            record("I", named("char[3] sys_name", b"PX4")),
            record("I", named("uint32_t ver_sw_release", struct.pack("<I", 0x010D00FF))),
            record("M", b"\0" + named("char[5] console", b"hello")),
            record("P", named("float MPC_XY_P", struct.pack("<f", 0.95))),
            record("P", named("int32_t SYS_AUTOSTART", struct.pack("<i", 4001))),
            record("Q", b"\3" + named("float MPC_XY_P", struct.pack("<f", 1.0))),
        ]
    )


def build() -> bytes:
    """Two topics, one of them twice, at 100 Hz for 0.6 s, with everything else in between."""
    parts = [HEAD, definitions()]
    parts += [subscribe(0, 0, "topic"), subscribe(1, 1, "topic"), subscribe(2, 0, "other")]
    for k in range(60):
        time_us = 2_000_000 + 10_000 * k
        parts.append(data(0, topic_payload(k, time_us)))
        if k % 2:
            parts.append(data(1, topic_payload(-k % 50, time_us + 1)))
        parts.append(data(2, other_payload(k, time_us + 2)))
        if k == 20:
            parts.append(record("L", b"6" + struct.pack("<Q", time_us) + b"take-off"))
            parts.append(record("C", b"4" + struct.pack("<HQ", 7, time_us + 5) + "caf\u00e9".encode()))
        if k == 30:
            parts.append(record("O", struct.pack("<H", 25)))
            parts.append(record("P", named("float MPC_XY_P", struct.pack("<f", 0.8))))
        if k % 25 == 24:
            parts.append(record("S", SYNC))
    return b"".join(parts)


ROWS = {"D": 1, "P": 1, "Q": 2, "L": 1, "C": 1, "O": 1, "M": 1}


def records(blob: bytes) -> list[Record]:
    found = [Record(0, len(HEAD), 0)]
    at = len(HEAD)
    while at < len(blob):
        size, kind = struct.unpack_from("<HB", blob, at)
        found.append(Record(at, at + 3 + size, ROWS.get(chr(kind), 0)))
        at += 3 + size
    return found


def at_risk(blob: bytes, byte: int) -> int:
    """The magic costs everything; a format or subscription all rows of its topics; flags nothing."""
    found = records(blob)
    hit = record_at(found, byte)
    whole = sum(r.rows for r in found)
    if byte < 4:
        return whole
    kind = chr(blob[hit.start + 2]) if byte >= len(HEAD) else ""
    if kind == "F":
        return 60 if b"other" in blob[hit.start : hit.end] else 90
    if kind == "A":
        return {0: 60, 1: 30, 2: 60}[blob[hit.start + 4]]
    return hit.rows
