"""What `mavlogdump --format json --show-source` prints of a telemetry log: attitude, a heartbeat, words."""

from __future__ import annotations

import json
import math

from tests.samplelogs import Record, record_at

SUFFIX = ".json"
COUNT = 100
HARMLESS = b" \t\r\n"
RESYNC_BYTES = 260  # garbage without a line end swallows the line behind it


def build() -> bytes:
    """20 s: attitude at 5 Hz, a heartbeat every second, words now and then."""
    lines = []
    for k in range(COUNT):
        stamp = 1_700_000_000.0 + 0.2 * k
        turn = {"roll": 0.1 * math.sin(0.3 * k), "pitch": 0.02 * k, "yaw": 1.5}
        rates = {"rollspeed": 0.01, "pitchspeed": -0.25, "yawspeed": 0.0}
        lines.append(_line("ATTITUDE", stamp, {"time_boot_ms": 5_000 + 200 * k, **turn, **rates}))
        if k % 5 == 0:
            about = {"type": 2, "autopilot": 3, "base_mode": 81, "custom_mode": 5}
            lines.append(_line("HEARTBEAT", stamp, {**about, "system_status": 4, "mavlink_version": 3}))
        if k % 40 == 7:
            words = {"severity": 6, "text": f"EKF3 IMU{k} is using GPS", "id": 0, "chunk_seq": 0}
            lines.append(_line("STATUSTEXT", stamp, words))
    return "\n".join(lines).encode() + b"\n"


def _line(kind: str, stamp: float, data: dict[str, object]) -> str:
    meta = {"type": kind, "timestamp": stamp, "srcSystem": 1, "srcComponent": 1}
    return json.dumps({"meta": meta, "data": data})


def records(blob: bytes) -> list[Record]:
    """Every line."""
    found = []
    at = 0
    for line in blob.splitlines(keepends=True):
        found.append(Record(at, at + len(line), 1))
        at += len(line)
    return found


def left_of(piece: bytes) -> tuple[int, bool]:
    """A line without its end is whole where its brackets are closed."""
    is_whole = piece.endswith(b"}}")
    return int(is_whole), is_whole


def at_risk(blob: bytes, byte: int) -> int:
    """A line; a damaged line end joins two."""
    return 2 if byte == record_at(records(blob), byte).end - 1 else 1
