"""A DataFlash log as ArduPilot writes it: formats first, then units, then 50 Hz of attitude and more."""

from __future__ import annotations

import math
import struct
from collections import Counter

from tests.samplelogs import Record, record_at

SUFFIX = ".bin"
RESYNC_BYTES = 96  # without checksums the message before damage cannot be believed
CODES = dict(zip("bBhHiIfdcCeELMqQ", "bBhHiIfdhHiIiBqQ", strict=True)) | {"n": "4s", "N": "16s", "Z": "64s"}
TYPES = {
    128: ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
    129: ("UNIT", "QbZ", "TimeUS,Id,Label"),
    130: ("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    131: ("MULT", "Qbd", "TimeUS,Id,Mult"),
    10: ("ATT", "QccCf", "TimeUS,Roll,Pitch,Yaw,Err"),
    11: ("GPS", "QBIHLLe", "TimeUS,Status,GMS,GWk,Lat,Lng,Alt"),
    12: ("MSG", "QZ", "TimeUS,Message"),
    13: ("IMU", "QBfff", "TimeUS,I,AccX,AccY,AccZ"),
    14: ("NOTE", "hB", "Level,Kind"),
}


Types = dict[int, tuple[str, str, str]]


def pack(number: int, *values: object, types: Types = TYPES) -> bytes:
    """One message."""
    form = types[number][1]
    raw = [v.encode() if isinstance(v, str) else v for v in values]
    return b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(CODES[c] for c in form), *raw)


def fmt(number: int, types: Types = TYPES) -> bytes:
    """The FMT of a message."""
    name, form, labels = types[number]
    length = 3 + struct.calcsize("<" + "".join(CODES[c] for c in form))
    return pack(128, number, length, name, form, labels)


def build() -> bytes:
    """All formats, units, 2 s of flight."""
    out = [fmt(number) for number in TYPES]
    out += [
        pack(129, 1, ord(i), label)
        for i, label in (("s", "s"), ("d", "deg"), ("D", "deglatitude"), ("m", "m"))
    ]
    out += [pack(129, 1, ord("#"), "instance")]
    out += [
        pack(131, 1, ord(i), f) for i, f in (("F", 1e-6), ("B", 1e-2), ("G", 1e-7), ("-", 0.0), ("0", 1.0))
    ]
    out += [
        pack(130, 1, 10, "sddd-", "FBBB-"),
        pack(130, 1, 11, "s---DDm", "F---GGB"),
        pack(130, 1, 13, "s#---", "F----"),
    ]
    out.append(pack(12, 1, "ArduCopter V4.3.1 (0123abcd)"))
    for i in range(45):
        us = 10_000_000 + 20_000 * i
        out.append(pack(10, us, round(1000 * math.sin(0.1 * i)), -i, 100 * i, 0.25 * i))
        out += [pack(13, us + 100 + k, k, 0.5 * i, -0.5, -9.8 - k) for k in (0, 1)]
        if i % 10 == 0:
            out.append(pack(11, us + 500, 3, 200_000_000 + 20 * i, 2300, 491234567, -12345678, 12345 + i))
            out.append(pack(14, i, 7))
    return b"".join(out)


def records(blob: bytes) -> list[Record]:
    """Every message; all of them are rows."""
    lengths = {n: 3 + struct.calcsize("<" + "".join(CODES[c] for c in TYPES[n][1])) for n in TYPES}
    found = []
    at = 0
    while at < len(blob):
        found.append(Record(at, at + lengths[blob[at + 2]], 1))
        at = found[-1].end
    return found


def at_risk(blob: bytes, byte: int) -> int:
    """A FMT decides over all messages of its kind, and its number over those of the kind that it claims."""
    every = records(blob)
    hit = record_at(every, byte)
    if blob[hit.start + 2] != 128:
        return 2
    kinds = Counter(blob[r.start + 2] for r in every)
    number = blob[hit.start + 3]
    if number == 128:
        return len(every)
    claimed = max(count for kind, count in kinds.items() if kind != number) if byte == hit.start + 3 else 0
    return kinds[number] + 2 + claimed


def defining(blob: bytes) -> list[tuple[int, int, int]]:
    """The FMT of attitudes; the kinds that its number could claim, where they do not follow, have 5 rows."""
    hit = next(r for r in records(blob) if blob[r.start + 2 : r.start + 4] == bytes([128, 10]))
    return [(hit.start, hit.end, 45 + 1 + 5)]
