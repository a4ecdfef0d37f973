"""Where a vehicle flew, from the positions in its log."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from flysid.dataset import FloatArray
from flysid.facts.clock import log_clock
from flysid.flight import BOOT, TIME, field_scale, message_of
from flysid.flightwriter import float_values, int_values
from flysid.ingest.align.signals import Log
from flysid.ingest.formats.common.scrub_rules import Position, ScrubColumn, has_fix, places
from flysid.ingest.lake.flight_export import seconds_of

ESTIMATES = ("GLOBAL_POSITION_INT", "vehicle_global_position", "POS")
"""Streams with the estimator's own position: smoother than a receiver's."""
INTEGER_DEGREES = 1e-7


def read_track(log: Log) -> pa.Table | None:
    """`time_s`, `boot`, `lat_deg`, `lon_deg`, and `alt_m` where there is one; None without a position.

    `time_s` is in seconds since the log began (`facts.clock`).
    The estimator's position is taken where the log has it, else the stream with most rows. Rows without a fix
    are left out.
    """
    found = [(stream, place) for stream in log.rows if (place := _place(log, stream)) is not None]
    if not found:
        return None

    def preference(candidate: tuple[str, Position]) -> tuple[bool, int]:
        message = message_of(candidate[0])
        return message in ESTIMATES, log.rows[candidate[0]]

    stream, place = max(found, key=preference)
    altitudes = place.altitudes[:1]
    names = [column.name for column in (place.lat, place.lon, *altitudes)]
    table = log.table(stream, [TIME, BOOT, *names])
    lat_deg, lon_deg = (_degrees(table, name) for name in names[:2])
    kept = has_fix(lat_deg, lon_deg)
    columns = {
        "time_s": seconds_of(table, log_clock(log.clocks))[kept],
        "boot": int_values(table[BOOT])[kept].astype(np.int32),
        "lat_deg": lat_deg[kept],
        "lon_deg": lon_deg[kept],
    }
    if altitudes:
        columns["alt_m"] = _numbers(table, names[2])[kept]
    return pa.table(columns) if kept.any() else None


def _place(log: Log, stream: str) -> Position | None:
    if not log.rows[stream]:
        return None
    found = places([ScrubColumn(name, name) for name in log.columns(stream)])
    return found[0] if found else None


def _numbers(table: pa.Table, name: str) -> FloatArray:
    return np.asarray(float_values(table[name]) * field_scale(table.schema.field(name)))


def _degrees(table: pa.Table, name: str) -> FloatArray:
    """Degrees; whole numbers without a stated scale are 1e-7 deg, as MAVLink and receivers send them."""
    values = _numbers(table, name)
    field = table.schema.field(name)
    is_raw = pa.types.is_integer(field.type) and field_scale(field) == 1.0
    return np.asarray(values * INTEGER_DEGREES) if is_raw else values
