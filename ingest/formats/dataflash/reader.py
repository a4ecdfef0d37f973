"""ArduPilot DataFlash logs (.bin) -> one table per message definition, on the vehicle's clock.

Framing: `frames`; definitions and units: `layouts`; messages without a time of their own lie between
their neighbours in the file (`vehicle_time`). Time bases: TimeUS (since 2015), TimeMS, and in the oldest logs
only GPS week and milliseconds. UTC comes from GPS messages with a fix. Written from ArduPilot's description
of the format; the schema's metadata names the fields that tell instances apart.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.errors import FormatError
from flysid.facts.modes import family_by_parameters
from flysid.flight import KEY, ClockMap, Damage
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary, release
from flysid.ingest.formats.common.clock import SECOND_NS, IntArray, UtcFit
from flysid.ingest.formats.common.columns import ByteMatrix, RecordLayout, gather, message_schema
from flysid.ingest.formats.common.gps_weeks import WEEK_NS, note_of, weeks_lost
from flysid.ingest.formats.common.vehicle_time import Clocked, Source, VehicleTime
from flysid.ingest.formats.dataflash.frames import LOOK_AHEAD, Messages, Walker
from flysid.ingest.formats.dataflash.layouts import FMT_ID, HEADER_BYTES, Definition, Units
from flysid.ingest.formats.dataflash.rules import HEAD

SNIFF_BYTES = 16384
FIRST_BYTES = 2048
SNIFF_MESSAGES = 3
SYSTEM = 1
GPS_EPOCH_NS = 315_964_800 * SECOND_NS
LEAP_SECONDS = ((1_483_228_800, 18), (1_435_708_800, 17), (1_341_100_800, 16), (1_230_768_000, 15), (0, 14))
MAX_NS = (1 << 63) - 1
MOST_WEEKS = MAX_NS // 2 // WEEK_NS  # the sum of weeks, milliseconds, lost weeks and 1980 stays a number
MOST_MS = MAX_NS // 8 // 1_000_000
TELLING = frozenset({"UNIT", "MULT", "FMTU", "MSG", "PARM", "DSF"})
TIME_COLUMNS = frozenset({"TimeUS", "TimeMS", "T", "Time", "GMS", "GWk", "Week", "Wk"})
FIRMWARE = re.compile(
    r"(?:ArduPilot |APM:)?(?:Ardu)?(Copter|Plane|Rover|Sub|Blimp|Tracker)2?\s+V?(\d[\w.\-]*)", re.I
)


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """Confidence that these bytes begin a DataFlash log: does it define a message, and chain?"""
    if HEAD + bytes([FMT_ID]) not in head[:SNIFF_BYTES]:
        return 0.0
    few = 0
    for part in (head[:FIRST_BYTES], head):  # most logs show in their first formats what they are
        few = len(Walker().walk(memoryview(part), 0, len(part))[0])
        if few >= SNIFF_MESSAGES:
            return 0.95
    return 0.6 if few else 0.0


@dataclass
class _Reader:
    """What is remembered between batches."""

    walker: Walker = field(default_factory=Walker)
    units: Units = field(default_factory=Units)
    time: VehicleTime = field(default_factory=lambda: VehicleTime({SYSTEM}, has_one_clock=True))
    schemas: dict[str, pa.Schema] = field(default_factory=dict)
    undecoded: dict[str, int] = field(default_factory=dict)
    dropped: int = 0
    row: int = 0
    gps_zero: list[int] = field(default_factory=list)
    info: dict[str, str] = field(default_factory=dict)
    parameters: set[str] = field(default_factory=set)


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a DataFlash log; see `Format.read`."""
    reader = _Reader()
    position = 0
    while position < len(view):
        start = position
        size = min(limits.batch_bytes + LOOK_AHEAD, len(view) - start)
        limit = size if start + size == len(view) else limits.batch_bytes
        messages, position = reader.walker.walk(view[start : start + size], start, limit)
        yield from _parts(reader, messages)
        release(view, start, position)
    if reader.row == 0:
        raise FormatError("no DataFlash message", path=name, hint="check that this is an ArduPilot .bin log")
    return _summary(reader)


def _parts(reader: _Reader, messages: Messages) -> Iterator[StreamPart]:
    """The tables of one batch, one per definition in it."""
    groups = _groups(messages)
    items = reader.walker.definitions.items
    kept: dict[int, IntArray] = {}
    for code, rows in groups.items():
        if items[code].layout is None:
            key = items[code].stream
            reader.undecoded[key] = reader.undecoded.get(key, 0) + len(rows)
        else:
            kept[code] = rows
            if items[code].name in TELLING:
                _learn(reader, items[code], _matrix(messages, rows, items[code]))
    clocked = {code: c for code, rows in kept.items() if (c := _read_clock(reader, messages, code, rows))}
    order = np.arange(reader.row, reader.row + len(messages), dtype=np.int64)
    reader.time.begin(list(clocked.values()), order, utc=False)
    for code, rows in kept.items():
        time_ns, boots = reader.time.times((SYSTEM, 1, code), rows, clocked.get(code))
        matrix = _matrix(messages, rows, items[code])
        if items[code].name.startswith("GPS"):
            records = _records(matrix, _layout_of(items[code]))
            reader.info.update(note_utc(reader.time.fit(), records, time_ns, boots))
        yield _table(reader, code, matrix, time_ns, boots)
    reader.row += len(messages)


def _matrix(messages: Messages, rows: IntArray, definition: Definition) -> ByteMatrix:
    """The bodies of the messages of one definition."""
    size = _layout_of(definition).size
    lengths = np.full(len(rows), size, dtype=np.int64)
    return gather(messages.buffer, messages.start[rows] + HEADER_BYTES, lengths, size)


def _layout_of(definition: Definition) -> RecordLayout:
    assert definition.layout is not None, "messages without a layout are counted, not decoded"
    return definition.layout


def _groups(messages: Messages) -> dict[int, IntArray]:
    """Definition index -> rising row numbers."""
    order = np.argsort(messages.code, kind="stable")
    codes = np.flatnonzero(np.bincount(messages.code))
    edges = np.searchsorted(messages.code[order], [*codes.tolist(), 1 << 20])
    return {int(code): order[edges[i] : edges[i + 1]] for i, code in enumerate(codes)}


def _records(matrix: ByteMatrix, layout: RecordLayout) -> npt.NDArray[np.void]:
    return matrix.view(layout.dtype).reshape(len(matrix))


# ---------------------------------------------------------------------------------- what messages tell


def _learn(reader: _Reader, definition: Definition, matrix: ByteMatrix) -> None:
    """Take in units, the firmware's name and counts of dropped messages."""
    layout = _layout_of(definition)
    names = layout.dtype.names or ()
    records = _records(matrix, layout)
    if definition.name == "UNIT" and {"Id", "Label"} <= set(names):
        reader.units.labels.update(
            (chr(int(i) & 255), _text(label))
            for i, label in zip(records["Id"], records["Label"], strict=True)
        )
    elif definition.name == "MULT" and {"Id", "Mult"} <= set(names):
        reader.units.factors.update(
            (chr(int(i) & 255), float(f)) for i, f in zip(records["Id"], records["Mult"], strict=True)
        )
    elif definition.name == "FMTU" and {"FmtType", "UnitIds", "MultIds"} <= set(names):
        for number, units, factors in zip(
            *(records[c] for c in ("FmtType", "UnitIds", "MultIds")), strict=True
        ):
            reader.units.of_message[int(number)] = (_text(units), _text(factors))
    elif definition.name == "DSF" and "Dp" in names:
        reader.dropped = max(reader.dropped, int(records["Dp"].max()))
    elif definition.name == "MSG" and "Message" in names and "firmware" not in reader.info:
        reader.info.update(firmware_in([_text(text) for text in records["Message"][:200].tolist()]))
    elif definition.name == "PARM" and "Name" in names and "vehicle" not in reader.info:
        reader.parameters.update(map(_text, set(records["Name"].tolist())))


def vehicle_facts(info: dict[str, str], parameters: set[str]) -> dict[str, str]:
    """What is known of the vehicle: a log that names none was written by the firmware with its parameters."""
    family = "" if info.get("vehicle") else family_by_parameters(parameters)
    return {"autopilot": "ardupilot", **({"vehicle": family} if family else {}), **info}


def firmware_in(texts: list[str]) -> dict[str, str]:
    """The vehicle and firmware that the first banner among `texts` names."""
    for text in texts:
        if found := FIRMWARE.search(text):
            return {"vehicle": found[1].lower(), "firmware": found[2]}
    return {}


def _text(raw: bytes) -> str:
    return bytes(raw).split(b"\0", 1)[0].decode("utf-8", "replace")


# -------------------------------------------------------------------------------------------- time


def _read_clock(reader: _Reader, messages: Messages, code: int, rows: IntArray) -> Clocked | None:
    """The times that the messages of a definition state."""
    definition = reader.walker.definitions.items[code]
    layout = _layout_of(definition)
    wanted = [n for n in layout.dtype.names or () if n in TIME_COLUMNS]
    if not wanted:
        return None
    end = max(layout.dtype.fields[n][1] + layout.dtype[n].itemsize for n in wanted)  # type: ignore[index]
    lengths = np.full(len(rows), end, dtype=np.int64)
    places = [layout.dtype.fields[n] for n in wanted]  # type: ignore[index]
    spec: Any = {
        "names": wanted,
        "formats": [p[0] for p in places],
        "offsets": [p[1] for p in places],
    }
    spec["itemsize"] = end
    head: np.dtype[np.void] = np.dtype(spec)
    matrix = gather(messages.buffer, messages.start[rows] + HEADER_BYTES, lengths, end)
    stated = stated_time(matrix.view(head).reshape(len(matrix)), reader.gps_zero)
    if stated is None:
        return None
    name, time_ns, is_boot, period = stated
    return reader.time.unwrapped(Clocked((SYSTEM, 1, code), name, rows, time_ns, is_boot, period))


def stated_time(records: npt.NDArray[np.void], gps_zero: list[int]) -> tuple[str, IntArray, bool, int] | None:
    """(field, nanoseconds, counts from boot, period) of a message's own time; None where it has none.

    Where nothing but GPS time is logged, it counts from the first fix, which `gps_zero` remembers.
    """
    names = records.dtype.names or ()
    week = _week_field(names)
    for name, unit in (("TimeUS", 1000), ("T", 1_000_000), ("TimeMS", 1_000_000)):
        if name not in names or (name == "TimeMS" and week) or (name == "T" and not week):
            continue
        if records.dtype[name].kind not in "iu" or records.dtype[name].shape:
            continue
        time_ns = np.clip(records[name], 0, MAX_NS // unit).astype(np.int64) * unit
        return name, time_ns, True, (1 << 32) * unit if records.dtype[name].itemsize == 4 else 0
    gps_ns = _gps_ns(records, names)
    if gps_ns is None:
        return None
    fixes = gps_ns[gps_ns > WEEK_NS]
    if not gps_zero and len(fixes):
        gps_zero.append(int(fixes[0]))
    if not gps_zero:
        return None
    return "GPS", np.where(gps_ns > WEEK_NS, gps_ns - gps_zero[0] + SECOND_NS, 0), False, 0


def _week_field(names: tuple[str, ...]) -> str:
    return next((n for n in ("GWk", "Week", "Wk") if n in names), "")


def _gps_ns(records: npt.NDArray[np.void], names: tuple[str, ...]) -> IntArray | None:
    """GPS time in nanoseconds since 1980, 0 where no date is as late; None without week and milliseconds."""
    week = _week_field(names)
    within = next((n for n in ("GMS", "TimeMS", "Time") if n in names), "")
    if (
        not week
        or not within
        or records.dtype[week].kind not in "iu"
        or records.dtype[within].kind not in "iu"
    ):
        return None
    is_date = (records[week] <= MOST_WEEKS) & (records[within] <= MOST_MS)
    weeks, milliseconds = (np.where(is_date, records[n], 0).astype(np.int64) for n in (week, within))
    return weeks * WEEK_NS + milliseconds * 1_000_000


def note_utc(
    fit: UtcFit, records: npt.NDArray[np.void], time_ns: IntArray, boots: IntArray
) -> dict[str, str]:
    """Anchor vehicle time to UTC by GPS messages that have a fix; says where their dates lacked weeks."""
    names = records.dtype.names or ()
    gps_ns = _gps_ns(records, names)
    if gps_ns is None:
        return {}
    fixed = gps_ns > WEEK_NS
    if "Status" in names and records.dtype["Status"].kind in "iu":
        fixed &= records["Status"] >= 2
    weeks = weeks_lost(gps_ns[fixed] + GPS_EPOCH_NS)
    gps_ns = gps_ns + weeks * WEEK_NS
    for boot in np.unique(boots[fixed]).tolist():
        rows = fixed & (boots == boot)
        fit.anchor(boot, time_ns[rows], utc_of_gps(gps_ns[rows]))
    return {"clock_note": note_of(weeks)} if weeks else {}


def utc_of_gps(gps_ns: IntArray) -> IntArray:
    """UTC nanoseconds since 1970 of GPS nanoseconds since 1980, leap seconds since 2009 taken off."""
    utc = gps_ns + GPS_EPOCH_NS
    first = int(utc[0]) // SECOND_NS
    leap = next(count for since, count in LEAP_SECONDS if first - count >= since)
    return utc - leap * SECOND_NS


# ------------------------------------------------------------------------------------------- tables


def _table(reader: _Reader, code: int, matrix: ByteMatrix, time_ns: IntArray, boots: IntArray) -> StreamPart:
    definition = reader.walker.definitions.items[code]
    if definition.stream not in reader.schemas:
        layout, key = reader.units.apply(definition)
        source = (SYSTEM, 1, code)
        metadata = {
            "time_source": reader.time.source_of(source).replace("arrival-mapped", "order-mapped"),
            "message": definition.name,
            **({KEY: key} if key else {}),
        }
        reader.schemas[definition.stream] = message_schema(layout.columns, metadata, received=False)
    schema = reader.schemas[definition.stream]
    table = _layout_of(definition).table(schema, (time_ns, boots), matrix)
    return StreamPart(definition.stream, table)


def _summary(reader: _Reader) -> Summary:
    walker = reader.walker
    items = walker.definitions.items
    unknown = {f"#{number}": count for number, count in sorted(walker.unknown.items())}
    found = walker.damage()
    damage = Damage(
        bytes_skipped=found.bytes_skipped,
        regions=found.regions,
        region_count=found.region_count,
        truncated=found.truncated,
        undecoded={**reader.undecoded, **unknown},
        time_outliers=by_stream(reader.time.outliers, items),
        out_of_order=by_stream(reader.time.out_of_order, items),
        dropouts={"messages": reader.dropped} if reader.dropped else {},
    )
    padding = {"padding_bytes": str(walker.padding)} if walker.padding else {}
    return Summary(damage, _clocks(reader), {**vehicle_facts(reader.info, reader.parameters), **padding})


def by_stream(counts: dict[Source, int], items: list[Definition]) -> dict[str, int]:
    """Counts per definition as counts per stream."""
    found: Counter[str] = Counter()
    for source, count in counts.items():
        found[items[source[2]].stream] += count
    return dict(sorted(found.items()))


def _clocks(reader: _Reader) -> tuple[ClockMap, ...]:
    return reader.time.fit().clocks() or (ClockMap(0, 0, max(0, reader.row - 1)),)
