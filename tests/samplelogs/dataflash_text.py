"""The binary sample as a ground station writes it: one message a line, physical values."""

from __future__ import annotations

import math

from tests.samplelogs import Record, record_at
from tests.samplelogs.dataflash import TYPES

SUFFIX = ".log"
HARMLESS = b"\r\n"
RESYNC_BYTES = 120  # garbage without a line end swallows the line behind it


def build() -> bytes:
    """Formats, a banner, 45 steps of 20 ms."""
    lines = []
    for number, (name, form, labels) in TYPES.items():
        lines.append(f"FMT, {number}, 20, {name}, {form}, {labels}")
    lines.append("MSG, 1, ArduCopter V4.3.1, (0123abcd)")
    for i in range(45):
        us = 10_000_000 + 20_000 * i
        lines.append(f"ATT, {us}, {10 * math.sin(0.1 * i):.2f}, {-i / 100:.2f}, {i}, {0.25 * i}")
        lines += [f"IMU, {us + 100 + k}, {k}, {0.5 * i}, -0.5, {-9.8 - k}" for k in (0, 1)]
        if i % 10 == 0:
            alt = 123.45 + i / 100
            lines.append(
                f"GPS, {us + 500}, 3, {200_000_000 + 20 * i}, 2300, 49.1234567, -1.2345678, {alt:.2f}"
            )
            lines.append(f"NOTE, {i}, 7")
    return "\n".join(lines).encode() + b"\n"


def records(blob: bytes) -> list[Record]:
    """Every line."""
    found = []
    at = 0
    for line in blob.splitlines(keepends=True):
        found.append(Record(at, at + len(line), 1))
        at += len(line)
    return found


def at_risk(blob: bytes, byte: int) -> int:
    """A FMT decides over all lines of its kind; a damaged line end joins two lines."""
    every = records(blob)
    hit = record_at(every, byte)
    behind = [r for r in every if r.start == hit.end] if byte == hit.end - 1 else []
    return sum(_decides_over(blob, r) for r in (hit, *behind))


def _decides_over(blob: bytes, line: Record) -> int:
    """Rows that need this line, itself included."""
    cells = blob[line.start : line.end].split(b", ")
    if cells[0] != b"FMT":
        return 1
    same = sum(blob[r.start : r.end].startswith(cells[3] + b", ") for r in records(blob))
    return same + (cells[3] != b"FMT")


def defining(blob: bytes) -> list[tuple[int, int, int]]:
    """The FMT line of attitudes, and with its end that of GPS behind it."""
    hit = next(r for r in records(blob) if b" ATT, " in blob[r.start : r.end])
    return [(hit.start, hit.end, at_risk(blob, hit.end - 1))]
