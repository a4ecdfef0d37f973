"""Tables in text: CSV and its kin, as spreadsheets, PlotJuggler, MATLAB, pandas and ground stations export.

One line a row, one stream called `table`; what its columns are says `layouts`. A column of numbers becomes
float64, null where a cell is empty or says "nan", and null and counted where it is no number. A line with
another number of cells, or without a time that fits its neighbours, is skipped and counted. Of a last line
without its end the last cell is read where its shape shows that it is whole (`endings`); else it is null and
counted. Quotes may enclose separators, not line ends.

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
from flysid.ingest.formats.common.clock import SECOND_NS, IntArray, is_outlier
from flysid.ingest.formats.common.columns import numbers
from flysid.ingest.formats.common.line_batches import whole_lines
from flysid.ingest.formats.common.table_times import UNUSED, TableClock, time_unit
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.csv.cells import (
    Lines,
    as_int64,
    column_of,
    count_ns,
    split_lines,
    stamps,
    stated_times,
    with_fraction,
)
from flysid.ingest.formats.csv.endings import last_line
from flysid.ingest.formats.csv.layouts import (
    BLANKS,
    COMMENT,
    MISSING,
    Column,
    Layout,
    cells_of,
    is_instruction,
    is_printable,
    layout_of,
    numbers_in,
    text_of,
)

STREAM = "table"
MAX_LINE_BYTES = 1 << 20
BATCH_BYTES = 1 << 22
_AROUND = re.compile(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)")
_BETWEEN = re.compile(rb"[ \t]+")
BLOCK_BYTES = 1 << 19  # stays in a processor's cache while Arrow takes it apart


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """Confidence that these bytes begin a table: less than any real log can claim."""
    return 0.5 if b"\0" not in head[:4096] and layout_of(head) is not None else 0.0


@dataclass
class _Reader:
    """What is remembered between batches."""

    layout: Layout
    schema: pa.Schema
    tally: Tally = field(default_factory=Tally)
    clock: TableClock = field(default_factory=TableClock)
    rows: int = 0


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a table; see `Format.read`."""
    layout = layout_of(bytes(view[:HEAD_BYTES]))
    if layout is None:
        raise FormatError(
            "no table of numbers: too few lines have the same number of cells",
            path=name,
            byte=0,
            hint="columns between commas, semicolons, tabs or blanks; one line a row, names in the first",
        )
    layout = _with_time_unit(layout, view, name, limits.time_unit)
    reader = _Reader(layout, _schema(layout))
    _preamble(reader, bytes(view[: layout.start]))
    size = min(limits.batch_bytes, BATCH_BYTES)
    for lines in whole_lines(view, layout.start, size, MAX_LINE_BYTES, partial(_ending, reader)):
        if lines.data:
            part = _part(reader, lines.data, lines.start)
            if part.num_rows:
                yield StreamPart(STREAM, part)
        reader.tally.truncated |= lines.is_cut
        reader.tally.skip(lines.end, lines.stop, lines.fault)
    return _summary(reader)


def _with_time_unit(layout: Layout, view: memoryview, name: str, told: str) -> Layout:
    """The layout with a unit of time; raises FormatError where several are plausible."""
    found = layout.time
    if found is None or found.unit:
        return layout
    tail = bytes(view[max(layout.start, len(view) - MAX_LINE_BYTES) :]).rpartition(b"\n")[0]
    cells = cells_of(tail.rpartition(b"\n")[2].decode("utf-8", "replace"), layout.separator)
    last = numbers_in(cells[found.index : found.index + 1], layout.decimal_comma) or found.first[-1:]
    unit, why = time_unit(found.name, found.first, float(last[0]), told, name)
    return replace(layout, time=replace(found, unit=unit, why=why))


def _schema(layout: Layout) -> pa.Schema:
    """time_ns, boot, then the columns with their units; a name that is taken gets an underscore."""
    fields = [pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32())]
    for column in layout.columns:
        name = column.name + ("_" if column.name in (TIME, BOOT) else "")
        fields.append(pa.field(name, _kind(column), metadata=field_metadata(column.unit)))
    source = layout.time.source if layout.time is not None else ROW_NUMBER
    return pa.schema(fields, metadata={"time_source": source, "message": STREAM})


def _kind(column: Column) -> pa.DataType:
    return pa.string() if column.is_text else pa.float64()


def _trim(values: pa.Array) -> pa.Array:
    if pa.types.is_string(values.type):
        return pc.utf8_trim_whitespace(values)
    return values if pa.types.is_floating(values.type) else values.cast(pa.float64(), safe=False)


def _preamble(reader: _Reader, before: bytes) -> None:
    """Lines before the first row: comments, header and units are understood, others are counted."""
    at = 0
    for raw in before.splitlines(keepends=True):
        line = raw.removeprefix(b"\xef\xbb\xbf").strip()
        text = text_of(line)
        cells = cells_of(text, reader.layout.separator)
        is_row = len(cells) == len(reader.layout.columns) and text.count('"') % 2 == 0
        is_read = is_row or text.startswith(COMMENT) or is_instruction(text)
        if line and not (is_read and is_printable(line)):
            reader.tally.skip(at, at + len(raw), "a line above the table")
        at += len(raw)


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
    kinds = {n: _kind(c) for n, c in zip(names, layout.columns, strict=True)}
    if layout.time is not None and layout.time.unit_ns == 1:
        kinds[names[layout.time.index]] = pa.int64()  # nanoseconds since 1970 do not fit a float
    try:
        table = read_csv(
            pa.BufferReader(data),
            read_options=ReadOptions(use_threads=False, column_names=names, block_size=BLOCK_BYTES),
            parse_options=ParseOptions(delimiter=layout.separator.decode(), quote_char=False),
            convert_options=ConvertOptions(
                column_types=kinds,
                null_values=sorted(MISSING) if worded else [""],
                strings_can_be_null=False,
                decimal_point="," if layout.decimal_comma else ".",
            ),
        )
    except pa.ArrowInvalid:
        return None
    columns = [column.combine_chunks() for column in table.columns]
    time_ns = _sound_times(reader, columns)
    if time_ns is None or not all(_is_finite(c) for c in columns):
        return None
    reader.rows += len(time_ns)
    return [_trim(c) for c in columns], time_ns


def _sound_times(reader: _Reader, columns: list[pa.Array]) -> IntArray | None:
    """(n,) times in ns; None where one is missing or fits no neighbour."""
    stated = reader.layout.time
    if stated is None:
        return (reader.rows + np.arange(len(columns[0]), dtype=np.int64)) * SECOND_NS
    values = columns[stated.index]
    if stated.unit_ns == 1:
        time_ns = as_int64(values.fill_null(0))
        known = ~np.asarray(values.is_null())
    elif stated.unit_ns:
        time_ns, known = count_ns(values, stated.unit_ns)
        if stated.nanoseconds >= 0:
            time_ns, known = with_fraction(time_ns, known, columns[stated.nanoseconds])
    else:
        time_ns, known = stamps(pc.utf8_trim_whitespace(values), stated.unit)
    return time_ns if known.all() and not is_outlier(time_ns).any() else None


def _is_finite(column: pa.Array) -> bool:
    """Whether a column holds no infinity: the word, or a number too large, as cell by cell reading tells."""
    return pa.types.is_string(column.type) or bool(pc.all(pc.is_finite(column)).as_py() in (True, None))


def _pick(reader: _Reader, data: bytes, base: int) -> tuple[list[pa.Array], IntArray]:
    """Columns and times of the lines of a batch that are rows; everything else is counted."""
    lines = split_lines(data, reader.layout)
    rows = np.flatnonzero(lines.is_whole)
    if reader.layout.time is None:
        number = np.cumsum(~lines.is_blank) - 1
        time_ns = (reader.rows + number[rows]) * SECOND_NS
        fits = np.ones(len(rows), dtype=bool)
    else:
        time_ns, fits = stated_times(lines, rows, reader.layout)
        fits[fits] = ~is_outlier(time_ns[fits])
    reader.rows += int((~lines.is_blank).sum())
    untimely = set(rows[~fits].tolist())
    rows = rows[fits]
    time_ns = time_ns[fits]
    _count_skipped(reader, lines, untimely, base)
    return [_counted_column(reader, lines, rows, i) for i in range(len(reader.layout.columns))], time_ns


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


def _count_skipped(reader: _Reader, lines: Lines, untimely: set[int], base: int) -> None:
    ragged = set(np.flatnonzero(~lines.is_whole & ~lines.is_blank).tolist())
    for i in sorted(ragged | untimely):
        why = "no time that fits its neighbours" if i in untimely else "not the cells that the table has"
        reader.tally.skip(base + int(lines.start[i]), base + int(lines.end[i]), why)


def _counted_column(reader: _Reader, lines: Lines, rows: IntArray, index: int) -> pa.Array:
    found = column_of(lines, rows, reader.layout, index)
    name = reader.layout.columns[index].name
    if found.wrong:
        reader.tally.undecode(f"{STREAM}.{name}", found.wrong, f"{found.example[:40]!r} is not a number")
    return found.values


def _summary(reader: _Reader) -> Summary:
    time = reader.schema.metadata[b"time_source"].decode()
    for name in reader.layout.unused_times:
        reader.tally.undecode(f"{STREAM}.{name}", reader.rows, UNUSED)
    if reader.clock.late:
        reader.tally.out_of_order[STREAM] = reader.clock.late
    return Summary(reader.tally.freeze(), reader.clock.clocks(), {"time": time})
