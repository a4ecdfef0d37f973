"""Tables in text: CSV and its kin, as spreadsheets, PlotJuggler, MATLAB, pandas and ground stations export.

One line a row, one stream called `table`; what its columns are says `layouts`. A column of numbers becomes
float64, null where a cell is empty or says "nan", and null and counted, with its row, where it is no number.
A line with another number of cells, or without a time that fits its neighbours, is skipped and counted. Of a
last line without its end the last cell is read where its shape shows that it is whole (`endings`); else it is
null and counted. Quotes may enclose separators, not line ends.

A batch of sound lines is parsed by Arrow at once; only where it balks are lines taken apart (`cells`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow.csv import ConvertOptions, ParseOptions, ReadOptions, read_csv

from flysid.errors import FormatError
from flysid.flight import BOOT, ROW_NUMBER, TIME, field_metadata
from flysid.ingest.formats.base import HEAD_BYTES, Limits, Parts, StreamPart, Summary
from flysid.ingest.formats.common.arrow_arrays import RESERVED
from flysid.ingest.formats.common.clock import SECOND_NS, IntArray, is_outlier
from flysid.ingest.formats.common.columns import numbers
from flysid.ingest.formats.common.instance_names import table_key
from flysid.ingest.formats.common.line_batches import whole_lines
from flysid.ingest.formats.common.odd_cells import OddCells
from flysid.ingest.formats.common.table_columns import once_each
from flysid.ingest.formats.common.table_kinds import Column
from flysid.ingest.formats.common.table_numbers import MISSING, numbers_in
from flysid.ingest.formats.common.table_times import TableClock
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.common.transfer import is_text
from flysid.ingest.formats.csv.cells import Lines, cells_in, column_of, split_lines
from flysid.ingest.formats.csv.endings import last_line
from flysid.ingest.formats.csv.layouts import BLANKS, Layout, cells_of, layout_of
from flysid.ingest.formats.csv.preamble import read_preamble

STREAM = "table"
MAX_LINE_BYTES = 1 << 20
SNIFFED_BYTES = 1 << 12
TAIL_BYTES = 1 << 12
BATCH_BYTES = 1 << 22
_AROUND = re.compile(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)")
_BETWEEN = re.compile(rb"[ \t]+")
RAGGED = "not the cells that the table has"
UNREAD = "a time that is missing or cannot be read"
STRAY = "a time that fits no neighbour"
BLOCK_BYTES = 1 << 19  # stays in a processor's cache while Arrow takes it apart


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """Confidence that these bytes begin a table: less than any real log can claim."""
    first = head[:SNIFFED_BYTES]
    is_likely = b"\0" not in first or is_text(first.replace(b"\0", b""))  # a lost sector reads as zeros
    return 0.5 if is_likely and layout_of(head) is not None else 0.0


@dataclass
class _Reader:
    """What is remembered between batches."""

    layout: Layout
    schema: pa.Schema
    tally: Tally = field(default_factory=Tally)
    clock: TableClock = field(default_factory=TableClock)
    odd: OddCells = field(default_factory=OddCells)
    rows: int = 0


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a table; see `Format.read`."""
    layout = layout_of(bytes(view[:HEAD_BYTES]))
    if layout is None:
        raise FormatError(
            "no table of numbers: too few lines have the same number of cells",
            path=name,
            byte=0,
            hint="columns between commas, semicolons, tabs, bars or blanks; one line a row, names first",
        )
    layout = _with_time(layout, view, name, limits)
    reader = _Reader(layout, _schema(layout))
    facts = read_preamble(layout, bytes(view[: layout.start]), reader.tally)
    size = min(limits.batch_bytes, BATCH_BYTES)
    for lines in whole_lines(view, layout.start, size, MAX_LINE_BYTES, partial(_ending, reader)):
        if lines.data:
            part = _part(reader, lines.data, lines.start)
            if part.num_rows:
                yield StreamPart(STREAM, part)
        reader.tally.truncated |= lines.is_cut
        reader.tally.skip(lines.end, lines.stop, lines.fault)
    return _summary(reader, facts)


def _with_time(layout: Layout, view: memoryview, name: str, limits: Limits) -> Layout:
    """The layout with one reading of its times; raises FormatError where several are plausible."""
    time = layout.time
    if time is None:
        return layout
    cells = cells_of(_last_line(view, layout.start).decode("utf-8", "replace"), layout.separator)
    last = [] if time.forms else numbers_in(cells[time.parts[0] : time.parts[0] + 1], time.style)
    told = time.resolved(last[0] if last else time.first[-1], limits.time_unit, limits.date_order, name)
    return replace(layout, time=told)


def _last_line(view: memoryview, start: int) -> bytes:
    """The last line that has an end, of those from `start` on; a megabyte is searched where it is long."""
    for size in (TAIL_BYTES, MAX_LINE_BYTES):
        first = max(start, len(view) - size)
        _, mark, line = bytes(view[first:]).rpartition(b"\n")[0].rpartition(b"\n")
        if mark or first == start:
            break
    return line


def _schema(layout: Layout) -> pa.Schema:
    """time_ns, boot, then the columns with their units; a name that is taken gets a number."""
    fields = [pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32())]
    names = once_each([column.name for column in layout.columns], RESERVED)
    for name, column in zip(names, layout.columns, strict=True):
        fields.append(pa.field(name, _kind(column), metadata=field_metadata(column.unit)))
    source = layout.time.source if layout.time is not None else ROW_NUMBER
    return pa.schema(fields, metadata={"time_source": source, "message": STREAM, **table_key(names)})


def _kind(column: Column) -> pa.DataType:
    return pa.string() if column.is_text else pa.float64()


def _part(reader: _Reader, data: bytes, base: int) -> pa.Table:
    """The rows of a batch of whole lines: parsed at once, or cell by cell where something is wrong."""
    sound = _sound(reader, data)
    columns, time_ns = sound if sound is not None else _pick(reader, data, base)
    heads = [numbers(time_ns), numbers(reader.clock.boots(time_ns))]
    return pa.Table.from_arrays([*heads, *columns], schema=reader.schema)


def _sound(reader: _Reader, data: bytes) -> tuple[list[pa.Array], IntArray] | None:
    """Columns and times of a batch that holds nothing but rows of numbers and plain words; None otherwise."""
    layout = reader.layout
    if b'"' in data:
        return None
    worded = b"n" in data or b"N" in data  # as all words for missing and infinite values are
    if layout.separator == BLANKS:
        data = _BETWEEN.sub(b" ", _AROUND.sub(b"", data))
    names = [str(i) for i in range(len(layout.columns))]
    try:
        table = read_csv(
            pa.BufferReader(data),
            read_options=ReadOptions(use_threads=False, column_names=names, block_size=BLOCK_BYTES),
            parse_options=ParseOptions(delimiter=layout.separator.decode(), quote_char=False),
            convert_options=ConvertOptions(
                column_types=dict(zip(names, _parsed_kinds(layout), strict=True)),
                null_values=sorted(MISSING) if worded else [""],
                strings_can_be_null=False,
                decimal_point=layout.decimal,
            ),
        )
    except pa.ArrowInvalid:
        return None
    parsed = [column.combine_chunks() for column in table.columns]
    texts = {i: pc.utf8_trim_whitespace(c) for i, c in enumerate(parsed) if pa.types.is_string(c.type)}
    columns = []
    for i, column in enumerate(layout.columns):
        found = column_of(texts[i], column) if i in texts else None
        if found is not None and len(found.wrong):
            return None
        columns.append(parsed[i].cast(pa.float64(), safe=False) if found is None else found.values)
    time_ns = _sound_times(reader, parsed, texts)
    if time_ns is None or not all(map(_is_finite, columns)):
        return None
    reader.rows += len(time_ns)
    return columns, time_ns


def _parsed_kinds(layout: Layout) -> list[pa.DataType]:
    """The types that the columns are parsed as: text where it takes a second look."""
    kinds = [pa.float64() if layout.is_plain(i) else pa.string() for i in range(len(layout.columns))]
    if layout.time is None:
        return kinds
    if layout.time.is_exact and layout.is_plain(layout.time.parts[0]):
        kinds[layout.time.parts[0]] = pa.int64()
    elif layout.time.forms:
        for part in layout.time.columns:
            kinds[part] = pa.string()
    return kinds


def _sound_times(reader: _Reader, parsed: list[pa.Array], texts: dict[int, pa.Array]) -> IntArray | None:
    """(n,) times in ns; None where one is missing or fits no neighbour."""
    time = reader.layout.time
    if time is None:
        return (reader.rows + np.arange(len(parsed[0]), dtype=np.int64)) * SECOND_NS
    first = parsed[time.parts[0]]
    if pa.types.is_string(first.type):
        time_ns, known = time.read(lambda part: texts[part])
    elif pa.types.is_integer(first.type):
        time_ns, known = time.count_whole(first.fill_null(0)), ~np.asarray(first.is_null())
    else:
        time_ns, known = time.count(first)
    if time.fraction >= 0 and not time.forms:
        time_ns, known = time.with_fraction(time_ns, known, parsed[time.fraction])
    time_ns = reader.clock.unwrapped(time_ns, time.turn)
    return time_ns if known.all() and not is_outlier(time_ns).any() else None


def _is_finite(column: pa.Array) -> bool:
    """Whether a column holds no infinity: cell by cell reading tells the word from a number too large."""
    return pa.types.is_string(column.type) or bool(pc.all(pc.is_finite(column)).as_py() in (True, None))


def _pick(reader: _Reader, data: bytes, base: int) -> tuple[list[pa.Array], IntArray]:
    """Columns and times of the lines of a batch that are rows; everything else is counted."""
    layout = reader.layout
    lines = split_lines(data, layout)
    rows = np.flatnonzero(lines.is_whole)
    number = reader.rows + np.cumsum(~lines.is_blank)  # of every line as a row, 1 for the first
    cells = [cells_in(lines, rows, layout, i) for i in range(len(layout.columns))]
    if layout.time is None:
        time_ns, known = (number[rows] - 1) * SECOND_NS, np.ones(len(rows), dtype=bool)
        fits = known
    else:
        time_ns, known = layout.time.read(lambda part: cells[part])
        kept = reader.clock.unwrapped(time_ns[known], layout.time.turn)
        fits = known.copy()
        fits[known] = ~is_outlier(kept)
        time_ns[known] = kept
    reader.rows += int((~lines.is_blank).sum())
    _count_skipped(reader, lines, {UNREAD: rows[~known], STRAY: rows[known & ~fits]}, base)
    if not fits.all():
        cells = [text.filter(numbers(fits)) for text in cells]
    columns = [_counted(reader, text, i, number[rows[fits]]) for i, text in enumerate(cells)]
    return columns, time_ns[fits]


def _counted(reader: _Reader, text: pa.Array, index: int, number: IntArray) -> pa.Array:
    """The cells of a column as its values; those that are none are noted with the numbers of their rows."""
    column = reader.layout.columns[index]
    found = column_of(text, column)
    if len(found.wrong):
        reader.odd.note(f"{STREAM}.{column.name}", number[found.wrong].tolist(), found.example)
    return found.values


def _ending(reader: _Reader, line: bytes, before: bytes) -> bytes:
    """A last line without its end as one that has it; without its last cell where that may be cut."""
    layout = reader.layout
    others = before.splitlines()
    found, is_whole = last_line(line, others, layout.separator, len(layout.columns))
    if found and not is_whole:
        reader.tally.truncated = True
        name = f"{STREAM}.{layout.columns[-1].name}"
        reader.tally.undecode(name, 1, "the file ends in it, without a line's end: it may be cut")
    return found


def _count_skipped(reader: _Reader, lines: Lines, untimely: dict[str, IntArray], base: int) -> None:
    """Count lines that are no rows, and rows without a time; `untimely` has these by what is wrong."""
    reasons = dict.fromkeys(np.flatnonzero(~lines.is_whole & ~lines.is_blank).tolist(), RAGGED)
    for why, rows in untimely.items():
        reasons.update(dict.fromkeys(rows.tolist(), why))
    for i, why in sorted(reasons.items()):
        reader.tally.skip(base + int(lines.start[i]), base + int(lines.end[i]), why)


def _summary(reader: _Reader, facts: dict[str, str]) -> Summary:
    time = reader.schema.metadata[b"time_source"].decode()
    reader.odd.tell(reader.tally)
    for name, why in reader.layout.unused_times.items():
        reader.tally.undecode(f"{STREAM}.{name}", reader.rows, why)
    if reader.clock.late:
        reader.tally.out_of_order[STREAM] = reader.clock.late
    return Summary(reader.tally.freeze(), reader.clock.clocks(), {**facts, "time": time})
