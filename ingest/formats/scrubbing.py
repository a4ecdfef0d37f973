"""`flysid scrub`: a log that can be shared, in the format that it came in.

Every format has a scrubber: a generator of the new file's bytes. What it cannot read it leaves out, because
what cannot be read cannot be cleaned. Rules: `scrub_rules`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from flysid.errors import UsageError
from flysid.files import new_file, writing_to
from flysid.flight import field_scale
from flysid.flightwriter import float_values
from flysid.ingest.formats.base import Format, Limits
from flysid.ingest.formats.common.packed_names import packed_as
from flysid.ingest.formats.common.scrub_rules import (
    UNREADABLE,
    Fix,
    Gps,
    Position,
    Scrubber,
    ScrubColumn,
    has_fix,
    places,
)
from flysid.ingest.formats.opening import open_log
from flysid.ingest.formats.registry import all_formats, format_of, sole_log
from flysid.stretch import FloatArray

Function = Callable[[memoryview, Scrubber, Limits], Iterator[bytes]]
OTHERS = ("ADSB", "AIS_", "TRANSPONDER", "TRAFFIC")  # where others were

KEPT = (
    "Kept: times of day, the magnetic field (which tells the latitude within a few degrees), barometric "
    "pressure, velocities and positions relative to the start."
)


@dataclass(frozen=True)
class Scrubbed:
    """What was removed: (what, where) -> fields; and what a person should know besides."""

    format: str
    removed: Mapping[tuple[str, str], int]
    notes: tuple[str, ...]


def scrubbers() -> Mapping[str, Function]:
    """Format name -> its scrubber."""
    return {
        fmt.name: importlib.import_module(fmt.scrubber).scrub
        for fmt in all_formats().values()
        if fmt.scrubber is not None
    }


def scrub_log(
    log: str | Path, out: str | Path, *, gps: Gps = "shift", force: bool = False, limits: Limits | None = None
) -> Scrubbed:
    """Write a copy of a log without what should not be shared. The copy appears whole or not at all.

    A packed log is unpacked first. The copy is packed as its name says: .gz, .zst, or not at all.

    Parameters
    ----------
    log : the log; it is not changed. A member of an archive as `flights.zip/one.tlog`.
    out : the copy's path.
    gps : "shift" moves all positions so that their median lies off the coast of Africa, "remove" empties
        them.
    force : replace `out` where it exists.
    limits : the settings of the reader.

    Raises
    ------
    FormatError : not a log. UsageError : no scrubber for its format, `out` is the log or exists, or is
        called .zip.
    WriteError : `out` cannot be written.
    """
    log = Path(log)
    out = Path(out)
    limits = limits or Limits()
    if out.exists() and log.exists() and out.samefile(log):
        raise UsageError("the copy would replace the log", path=out, hint="choose another name with -o")
    if out.suffix.lower() == ".zip":
        raise UsageError(
            "a copy is one log, not an archive",
            path=out,
            hint="-o with the log's own suffix, or that and .gz",
        )
    if out.exists() and not force:
        raise UsageError("the target exists", path=out, hint="choose another with -o, or add --force")
    with open_log(sole_log(log), alone=True) as opened:
        fmt = format_of(opened, limits)
        if fmt.name not in scrubbers():
            raise UsageError(
                f"{fmt.title} cannot be scrubbed yet", path=log, hint="formats: " + ", ".join(scrubbers())
            )
        scrubber = Scrubber(gps, middle(opened.view, opened.name, fmt))
        zeros = fmt.zeros_ahead(opened.view)
        _write(out, packed_as(out.name, scrubbers()[fmt.name](opened.view[zeros:], scrubber, limits)))
        if zeros:
            scrubber.note(UNREADABLE, "zeros ahead of the log", zeros)
        if opened.lost:
            scrubber.note(UNREADABLE, f"in its packing: {opened.lost}", 1)
    return Scrubbed(fmt.name, dict(sorted(scrubber.removed.items())), tuple(scrubber.notes))


def _write(out: Path, pieces: Iterator[bytes]) -> None:
    with new_file(out) as temporary, writing_to(out), temporary.open("wb") as file:
        for piece in pieces:
            file.write(piece)


def middle(view: memoryview, name: str, fmt: Format) -> Fix | None:
    """The median of a log's positions: of its receivers' if it has any, else of whatever names a position.

    Not the first: simulators and receivers begin with positions that are far off. Where an altitude cannot be
    negative, the lowest one, so that none is after the shift.
    """
    unsigned = False
    found: dict[bool, list[FloatArray]] = {True: [], False: []}
    for part in fmt.read(view, name, Limits()):
        if any(word in part.stream.upper() for word in OTHERS):
            continue
        of_receiver = "gps" in part.stream.lower() or "navsat" in part.stream.lower()
        for place in places([_column(c) for c in part.table.schema if _is_number(c.type)]):
            found[of_receiver].append(_fixes(part.table, place))
            unsigned |= any(
                pa.types.is_unsigned_integer(part.table.schema.field(a.key).type) for a in place.altitudes
            )
    fixes = np.concatenate([np.empty((0, 3)), *(f for f in found[True] if len(f))])
    if not len(fixes):
        fixes = np.concatenate([fixes, *found[False]])
    if not len(fixes):
        return None
    east = (fixes[:, 1] - fixes[0, 1] + 540.0) % 360.0 - 180.0
    lowest_or_middle = np.nanmin if unsigned else np.nanmedian
    altitude = lowest_or_middle(fixes[:, 2]) if np.isfinite(fixes[:, 2]).any() else 0.0
    return Fix(float(np.median(fixes[:, 0])), float(fixes[0, 1] + np.median(east)), float(altitude))


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def _column(field: pa.Field) -> ScrubColumn:
    return ScrubColumn(field.name, field.name, field_scale(field))


def _fixes(table: pa.Table, place: Position) -> FloatArray:
    """(n, 3) latitude, longitude, altitude (or NaN) of the rows with a fix."""
    lat, lon = (_values(table, c, 1e-7) for c in (place.lat, place.lon))
    alt = _values(table, place.altitudes[0], 1e-3) if place.altitudes else np.full(len(lat), np.nan)
    return np.column_stack([lat, lon, alt])[has_fix(lat, lon)]


def _values(table: pa.Table, column: ScrubColumn, integers: float) -> FloatArray:
    raw = table[column.key]
    values = float_values(raw)
    if column.scale not in (None, 1.0):
        return values * float(column.scale or 1.0)
    return values * (integers if pa.types.is_integer(raw.type) else 1.0)
