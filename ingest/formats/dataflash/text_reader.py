"""ArduPilot DataFlash logs as text (.log), as ground stations write them from a .bin.

    FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns
    ATT, 27231064, -0.41, 0.37, 91.30

One message a line, fields behind ", ". Numbers are printed as physical values: hundredths are divided out
and latitudes are degrees, so only factors of other fields (TimeUS) remain. A line that does not fit its FMT,
and a last line without its end, is skipped and counted. Whole numbers become int64, others float64.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.errors import FormatError
from flysid.flight import KEY, ClockMap, Damage, Region
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary
from flysid.ingest.formats.common.arrow_arrays import strings
from flysid.ingest.formats.common.clock import IntArray
from flysid.ingest.formats.common.columns import RecordLayout, message_schema, numbers, schema_field
from flysid.ingest.formats.common.line_batches import whole_lines
from flysid.ingest.formats.common.vehicle_time import Clocked, VehicleTime
from flysid.ingest.formats.dataflash.layouts import (
    FMT_ID,
    HEADER_BYTES,
    Definition,
    Definitions,
    Units,
    packed_length,
)
from flysid.ingest.formats.dataflash.reader import (
    SYSTEM,
    TIME_COLUMNS,
    by_stream,
    firmware_in,
    note_utc,
    stated_time,
    vehicle_facts,
)

FMT_LINE = re.compile(rb"(?:^|\n)FMT, ?\d+, ?\d+, ?\w+, ?\w+, ?\w")
WHOLE = frozenset("bBhHiIqQ")
REAL = frozenset("fdgcCeEL")
DIVIDED = frozenset("cCeEL")
MAX_LINE_BYTES = 4096
_LINE_HEAD = re.compile(
    r"(?=([A-Z][A-Z0-9]{1,3}), (-?\d+,.*))"
)  # also inside a word: its separator is damaged
_FMT_INSIDE = re.compile(rb"FMT, ?\d+, ?\d+, ?[A-Z][A-Z0-9]{0,3}, ?\w+, ?[\w,]+\s*$")
# its name is damaged too, maybe all up to its time
_LOST_HEAD = re.compile(r"[\x00-\x08\x0e-\x1f\x7f\ufffd][A-Z0-9]{0,3},? ?\d{4,},")
BATCH_BYTES = 4 << 20  # as Python strings, lines take twenty times their bytes
Column = npt.NDArray[np.int64] | npt.NDArray[np.float64] | list[str]


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """Confidence that these bytes begin a DataFlash text log: is there a line that defines a message?"""
    return 0.9 if b"FMT," in head and FMT_LINE.search(head) else 0.0


@dataclass
class _TextReader:
    """What is remembered between batches."""

    definitions: Definitions = field(default_factory=Definitions)
    by_name: dict[str, int] = field(default_factory=dict)
    units: Units = field(default_factory=Units)
    time: VehicleTime = field(default_factory=lambda: VehicleTime({SYSTEM}, has_one_clock=True))
    schemas: dict[str, pa.Schema] = field(default_factory=dict)
    undecoded: dict[str, int] = field(default_factory=dict)
    regions: list[Region] = field(default_factory=list)
    truncated: bool = False
    gps_zero: list[int] = field(default_factory=list)
    row: int = 0
    info: dict[str, str] = field(default_factory=dict)
    parameters: set[str] = field(default_factory=set)


@dataclass
class _TextLines:
    """Lines of one definition in a batch: their numbers, their spans in the file, their fields."""

    rows: list[int] = field(default_factory=list)
    spans: list[tuple[int, int]] = field(default_factory=list)
    cells: list[list[str]] = field(default_factory=list)


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a text log; see `Format.read`."""
    reader = _TextReader()
    size = max(min(limits.batch_bytes, BATCH_BYTES), MAX_LINE_BYTES)
    for lines in whole_lines(view, 0, size, size):
        reader.truncated |= lines.is_cut
        if lines.fault:
            _skip(reader, lines.end, lines.stop, lines.fault)
        yield from _parts(reader, lines.data, lines.start)
    if reader.row == 0:
        raise FormatError("no DataFlash line", path=name, hint="check that this is an ArduPilot .log")
    return _summary(reader)


def _skip(reader: _TextReader, start: int, end: int, reason: str) -> None:
    """Count bytes that are no message; neighbours become one region."""
    last = reader.regions[-1] if reader.regions else None
    if last is not None and last.end == start:
        reader.regions[-1] = Region(last.start, end, last.reason)
    else:
        reader.regions.append(Region(start, end, reason))


def _parts(reader: _TextReader, data: bytes, base: int) -> Iterator[StreamPart]:
    """The tables of one batch of whole lines."""
    groups = _group(reader, data, base)
    tables: dict[int, tuple[IntArray, list[Column]]] = {}
    for code, lines in groups.items():
        definition = reader.definitions.items[code]
        columns = _columns(reader, definition, lines)
        if lines.rows:
            tables[code] = np.array(lines.rows, dtype=np.int64), columns
            _learn(reader, definition, columns)
    reader.regions.sort(key=lambda region: region.start)
    yield from _tables(reader, tables, data.count(b"\n") + 1)


def _group(reader: _TextReader, data: bytes, base: int) -> dict[int, _TextLines]:
    """Lines by definition, split into as many fields as their FMT states; others are skipped."""
    groups: dict[int, _TextLines] = {}
    blank = start = base  # empty lines since `blank` mean nothing, unless damage follows or precedes them
    for row, line in enumerate(_split(data)):
        end = start + len(line)
        if extra := _before_fmt(line):
            line = line[extra:]
            start = start + extra
            _skip(reader, blank, start, "no format known for this line")
            blank = start
        head = end - len(line.lstrip(b"\r\n"))
        if reader.regions and reader.regions[-1].end == start:
            _skip(reader, start, head, "")
            blank = head
        if head == end:
            start = end
            continue
        name, _, rest = line.decode("utf-8", "replace").strip("\r\n").partition(", ")
        code = reader.by_name.get(name)
        if name == "FMT":
            code = _define(reader, rest)
        if code is None:
            reader.undecoded["lines of unknown kind"] = reader.undecoded.get("lines of unknown kind", 0) + 1
            _skip(reader, blank, end, "no format known for this line")
        else:
            count = len(reader.definitions.items[code].format)
            cells = [c.strip() for c in rest.split(",", count - 1)]
            if _swallowed(reader, code, cells[-1]):
                _skip(reader, blank, end, "two lines run into one")
            elif len(cells) == count:
                group = groups.setdefault(code, _TextLines())
                group.rows.append(row)
                group.spans.append((start, end))
                group.cells.append(cells)
            else:
                _skip(reader, blank, end, "not the fields that the format states")
        blank = start = end
    return groups


def _before_fmt(line: bytes) -> int:
    """Bytes of garbage, or of a line that lost its end, in front of a whole FMT; 0 where there are none."""
    found = _FMT_INSIDE.search(line, 1) if b"FMT, " in line[1:] else None
    return found.start() if found is not None else 0


def _swallowed(reader: _TextReader, code: int, text: str) -> bool:
    """Whether a text at the end of a line holds the line behind it, whose separator was damaged."""
    if reader.definitions.items[code].format[-1:] not in ("n", "N", "Z"):
        return False
    if _LOST_HEAD.search(text):
        return True
    for found in _LINE_HEAD.finditer(text):
        inner = reader.by_name.get(found[1])
        if inner is not None and found[2].count(",") >= len(reader.definitions.items[inner].format) - 1:
            return True
    return False


def _split(data: bytes) -> list[bytes]:
    """Lines that end with a line feed, whatever other control characters they hold."""
    return [line + b"\n" for line in data.split(b"\n")[:-1]]


def _define(reader: _TextReader, rest: str) -> int | None:
    """Take in a FMT line; the index of FMT's own definition, or None where it is no FMT."""
    cells = [c.strip() for c in rest.split(",", 4)]
    if len(cells) < 5 or not (cells[0].isdigit() and cells[1].isdigit()):
        return None
    if cells[4].count(",") >= max(1, len(cells[3])):  # more labels than fields: two lines run into one
        return None
    number = int(cells[0])
    length = packed_length(cells[3]) or HEADER_BYTES
    if number != FMT_ID and number < 256:
        reader.definitions.add(number, length, cells[2], cells[3], cells[4].replace(" ", ""))
        reader.by_name[cells[2]] = reader.definitions.current.get(number, 0)
    return reader.definitions.current[FMT_ID]


def _columns(reader: _TextReader, definition: Definition, lines: _TextLines) -> list[Column]:
    """The fields as arrays; lines whose numbers are none are skipped and leave `lines`."""
    good = [_fits(definition.format, cells) for cells in lines.cells]
    if not all(good):
        for (start, end), fits in zip(lines.spans, good, strict=True):
            if not fits:
                _skip(reader, start, end, "a number was expected")
        lines.rows = [row for row, fits in zip(lines.rows, good, strict=True) if fits]
        lines.cells = [cells for cells, fits in zip(lines.cells, good, strict=True) if fits]
    columns: list[Column] = []
    for character, cells in zip(definition.format, zip(*lines.cells, strict=True), strict=False):
        if character in WHOLE:
            columns.append(np.array([int(c) for c in cells], dtype=np.int64))
        elif character in REAL:
            columns.append(np.array([float(c) for c in cells], dtype=np.float64))
        else:
            columns.append(list(cells))
    return columns


def _fits(form: str, cells: Sequence[str]) -> bool:
    try:
        for character, cell in zip(form, cells, strict=True):
            if character in WHOLE and not -(1 << 63) <= int(cell) < 1 << 63:
                return False
            if character in REAL:
                float(cell)
    except ValueError:
        return False
    return True


def _learn(reader: _TextReader, definition: Definition, columns: list[Column]) -> None:
    """Take in units and the firmware's name."""
    named = dict(zip(_names(definition), columns, strict=True))
    if definition.name == "UNIT" and {"Id", "Label"} <= set(named):
        reader.units.labels.update(zip(map(_letter, named["Id"]), map(str, named["Label"]), strict=True))
    elif definition.name == "MULT" and {"Id", "Mult"} <= set(named):
        reader.units.factors.update(zip(map(_letter, named["Id"]), map(float, named["Mult"]), strict=True))
    elif definition.name == "FMTU" and {"FmtType", "UnitIds", "MultIds"} <= set(named):
        for number, units, factors in zip(
            *(named[c] for c in ("FmtType", "UnitIds", "MultIds")), strict=True
        ):
            reader.units.of_message[int(number)] = (str(units), str(factors))
    elif definition.name == "MSG" and "Message" in named and "firmware" not in reader.info:
        reader.info.update(firmware_in([str(text) for text in named["Message"][:200]]))
    elif definition.name == "PARM" and "Name" in named and "vehicle" not in reader.info:
        reader.parameters.update(map(str, named["Name"]))


def _letter(identity: object) -> str:
    return chr(int(str(identity)) & 255)


def _names(definition: Definition) -> list[str]:
    """Column names: the layout's where it is sound, so that text and binary logs agree."""
    if definition.layout is not None:
        return [f.name for f in definition.layout.fields]
    labels = [
        *definition.labels,
        *(f"field{i + 1}" for i in range(len(definition.labels), len(definition.format))),
    ]
    return [f"{label}_{i}" if label in labels[:i] else label for i, label in enumerate(labels)]


def _tables(
    reader: _TextReader, tables: dict[int, tuple[IntArray, list[Column]]], lines: int
) -> Iterator[StreamPart]:
    clocked: dict[int, Clocked] = {}
    heads: dict[int, npt.NDArray[np.void]] = {}
    for code, (rows, columns) in tables.items():
        heads[code] = _time_records(reader.definitions.items[code], columns, len(rows))
        stated = stated_time(heads[code], reader.gps_zero)
        if stated is not None:
            name, time_ns, is_boot, _ = stated
            clocked[code] = Clocked((SYSTEM, 1, code), name, rows, time_ns, is_boot)
    order = np.arange(reader.row, reader.row + lines, dtype=np.int64)
    reader.time.begin(list(clocked.values()), order, utc=False)
    for code, (rows, columns) in tables.items():
        time_ns, boots = reader.time.times((SYSTEM, 1, code), rows, clocked.get(code))
        if reader.definitions.items[code].name.startswith("GPS"):
            reader.info.update(note_utc(reader.time.fit(), heads[code], time_ns, boots))
        yield _table(reader, code, columns, (time_ns, boots))
    reader.row += lines


def _time_records(definition: Definition, columns: list[Column], count: int) -> npt.NDArray[np.void]:
    """The whole-number columns that may tell the time, as records."""
    named = {
        n: c
        for n, c in zip(_names(definition), columns, strict=True)
        if n in TIME_COLUMNS | {"Status"} and not isinstance(c, list) and c.dtype.kind == "i"
    }
    records = np.zeros(count, dtype=[(n, "<i8") for n in named])
    for name, column in named.items():
        records[name] = column
    return records


def _table(
    reader: _TextReader, code: int, columns: list[Column], times: tuple[IntArray, IntArray]
) -> StreamPart:
    definition = reader.definitions.items[code]
    arrays = [strings(c) if isinstance(c, list) else numbers(c) for c in columns]
    if definition.stream not in reader.schemas:
        layout, key = _describe(reader, definition)
        metadata = {
            "time_source": reader.time.source_of((SYSTEM, 1, code)).replace("arrival-mapped", "order-mapped"),
            "message": definition.name,
            **({KEY: key} if key else {}),
        }
        fields = (schema_field(spec, array.type) for spec, array in zip(layout.fields, arrays, strict=True))
        reader.schemas[definition.stream] = message_schema(fields, metadata, received=False)
    heads = [numbers(times[0]), numbers(times[1].astype(np.int32))]
    return StreamPart(
        definition.stream, pa.Table.from_arrays(heads + arrays, schema=reader.schemas[definition.stream])
    )


def _describe(reader: _TextReader, definition: Definition) -> tuple[RecordLayout, str]:
    """Fields with units; factors only where the text still holds raw numbers."""
    if definition.layout is None:
        from flysid.ingest.formats.common.columns import Field

        return RecordLayout(definition.name, np.dtype([]), tuple(Field(n) for n in _names(definition))), ""
    layout, key = reader.units.apply(definition)
    fields = tuple(
        replace(spec, scale=1.0) if character in DIVIDED else spec
        for spec, character in zip(layout.fields, definition.format, strict=True)
    )
    return replace(layout, fields=fields), key


def _summary(reader: _TextReader) -> Summary:
    damage = Damage(
        bytes_skipped=sum(r.size for r in reader.regions),
        regions=tuple(reader.regions[: Damage.MAX_REGIONS]),
        region_count=len(reader.regions),
        truncated=reader.truncated,
        undecoded=reader.undecoded,
        time_outliers=by_stream(reader.time.outliers, reader.definitions.items),
        out_of_order=by_stream(reader.time.out_of_order, reader.definitions.items),
    )
    clocks = reader.time.fit().clocks() or (ClockMap(0, 0, max(0, reader.row - 1)),)
    return Summary(damage, clocks, vehicle_facts(reader.info, reader.parameters))
