"""Logs that nobody here wrote, as reviews read them; tests that need one are skipped without them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import flysid
from flysid.dataset import FloatArray
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.crash import end_at_crash
from flysid.reviews.logged import LoggedFlight

SHARED = Path(__file__).parents[4] / "shared" / "logs"
needs_shared = pytest.mark.skipif(not SHARED.exists(), reason="the shared logs are not here")


@cache
def logged(name: str) -> LoggedFlight:
    """A shared log under review."""
    return open_logged(SHARED / name)


def open_logged(path: Path) -> LoggedFlight:
    """A log of a file."""
    return end_at_crash(LoggedFlight(FlightLog(flysid.read(path))))


def ulog_values(name: str, topic: str, field: str, instance: int = 0) -> tuple[FloatArray, FloatArray]:
    """Seconds since boot and values as pyulog reads them."""
    pyulog = pytest.importorskip("pyulog")
    rows = next(d for d in pyulog.ULog(str(SHARED / name), [topic]).data_list if d.multi_id == instance).data
    return rows["timestamp"] * 1e-6, np.asarray(rows[field], dtype=float)


def dataflash_values(name: str, message: str, *fields: str) -> FloatArray:
    """(n, 1 + fields) seconds since boot and values as pymavlink reads them."""
    mavutil = pytest.importorskip("pymavlink.mavutil")
    reader = mavutil.mavlink_connection(str(SHARED / name))
    found = []
    while (row := reader.recv_match(type=[message])) is not None:
        found.append([row.TimeUS * 1e-6, *(getattr(row, field) for field in fields)])
    reader.close()
    return np.array(found, dtype=float)
