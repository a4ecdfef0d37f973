"""A table as pandas writes it: time, a command, two outputs, a mode in words and a column with gaps."""

from __future__ import annotations

import math

from tests.samplelogs import Record, record_at

SUFFIX = ".csv"
ROWS = 150
HARMLESS = b" +-0123456789\t\r\n"  # part of the number behind them: nothing tells
RESYNC_BYTES = 120  # garbage without a line end swallows the line behind it


def build() -> bytes:
    """A header with units and its rows, 20 ms apart."""
    lines = ["time_s,pitch_cmd [deg],v_x [m/s],z (m),mode,rssi"]
    for i in range(ROWS):
        command = 5 * math.sin(0.1 * i)
        speed = 0.3 * math.cos(0.07 * i)
        rssi = f"{200 - i % 7}" if i % 10 == 0 else ""
        lines.append(f"{100 + 0.02 * i:.3f},{command:.4f},{speed:.5f},{-0.01 * i:.3f},HOVER,{rssi}")
    return "\n".join(lines).encode() + b"\n"


def records(blob: bytes) -> list[Record]:
    """Every line."""
    found = []
    at = 0
    for number, line in enumerate(blob.splitlines(keepends=True)):
        found.append(Record(at, at + len(line), int(number > 0)))
        at += len(line)
    return found


def left_of(piece: bytes) -> tuple[int, bool]:
    """A line that lacks a part of its last cell at most is a row without that cell."""
    return int(piece.count(b",") == 5), False


def at_risk(blob: bytes, byte: int) -> int:
    """The header decides over all lines; a damaged line end joins two."""
    hit = record_at(records(blob), byte)
    return ROWS if hit.start == 0 else 2
