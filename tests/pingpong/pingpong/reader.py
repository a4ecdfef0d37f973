"""Ping-pong logs: 8 bytes `PINGPONG`, then records of two little-endian float64, 50 a second: jet, height."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from flysid.flight import ClockMap, Damage
from flysid.ingest.formats.base import Format, Limits, Parts, StreamPart, Summary

MAGIC = b"PINGPONG"
RECORD = np.dtype([("jet", "<f8"), ("height", "<f8")])
PERIOD_NS = 20_000_000
FORMAT = Format("pingpong", "ping-pong log (.ping)", (".ping",), "pingpong.reader")


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """1 where the magic stands at the beginning."""
    return 1.0 if head.startswith(MAGIC) else 0.0


def read(view: memoryview, name: str, limits: Limits) -> Parts:  # noqa: ARG001
    """One stream; bytes of an unfinished record at the end are counted as skipped."""
    body = view[len(MAGIC) :]
    count, left = divmod(len(body), RECORD.itemsize)
    records = np.frombuffer(bytes(body[: count * RECORD.itemsize]), RECORD)
    times = np.arange(count, dtype=np.int64) * PERIOD_NS
    columns = {name: records[name] for name in RECORD.names or ()}
    yield StreamPart("ball", pa.table({"time_ns": times, "boot": np.zeros(count, np.int32), **columns}))
    return Summary(
        Damage(bytes_skipped=left, truncated=left > 0),
        (ClockMap(0, 0, int(times[-1]) if count else 0),),
        {"autopilot": "none"},
    )
