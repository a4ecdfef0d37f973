"""Tables in parquet files, as pandas, polars, MATLAB and DuckDB write them: one stream called `table`.

Units come from the fields' metadata (`unit`, `units`), else from the names, as in text (`table_columns`). The
time is the index that pandas had, a column that is called a time, or one of stamps. A file is read one row
group at a time; where a group is damaged, its columns are read one by one, and what is lost is counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from flysid.errors import FormatError
from flysid.flight import BOOT, ROW_NUMBER, TIME
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary
from flysid.ingest.formats.common.arrow_arrays import numeric
from flysid.ingest.formats.common.clock import SECOND_NS, BoolArray, IntArray, is_outlier
from flysid.ingest.formats.common.odd_cells import OddCells
from flysid.ingest.formats.common.table_numbers import floats, numbers_in
from flysid.ingest.formats.common.table_times import NO_TURN, TableClock, rises, to_ns
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.common.time_columns import find_time, unused_times
from flysid.ingest.formats.common.time_units import TIME_UNITS_NS, time_unit
from flysid.ingest.formats.parquet.columns import (
    DATES,
    Column,
    Sample,
    TimeColumn,
    as_floats,
    as_text,
    columns_of,
    plain,
    sample_of,
    time_candidates,
)
from flysid.stretch import FloatArray
from flysid.tabular import FORMAT as DATASET
from flysid.tabular import META

MAGIC = b"PAR1"
STREAM = "table"
FREE_BYTES = 64 << 20  # below this, the ratio is not held against a row group
CELL_BYTES = 8
SAMPLE_ROWS = 500
DAMAGE = (pa.ArrowException, OSError, ValueError, OverflowError, KeyError, IndexError)


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """Certain where the file begins as parquet does."""
    return 1.0 if head.startswith(MAGIC) else 0.0


@dataclass
class _Reader:
    """What is remembered between row groups."""

    file: pq.ParquetFile
    columns: list[Column]
    schema: pa.Schema
    time: TimeColumn | None
    sample: Sample
    limits: Limits
    size: int
    tally: Tally = field(default_factory=Tally)
    clock: TableClock = field(default_factory=TableClock)
    odd: OddCells = field(default_factory=OddCells)
    rows: int = 0
    read_to: int = 0


@dataclass(frozen=True)
class _Group:
    """A row group: its number, rows, and bytes [start, end) in the file; 0, 0 where these are not known."""

    number: int
    rows: int
    start: int
    end: int
    fault: str = ""


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a table; see `Format.read`."""
    file = _open(view, name)
    schema = _schema_of(file, name)
    if DATASET.encode() in (schema.metadata or {}).get(META, b""):
        raise FormatError(
            "this is a dataset that flysid wrote, not a log", path=name, hint=f"flysid fit {name} -o RUN"
        )
    groups = list(_groups(file, len(view), limits))
    sample = _sample(file, groups)
    columns, refused = columns_of(schema, sample)
    time = _time_of(file, groups, schema, sample, limits, name)
    source = ROW_NUMBER if time is None else time.source
    made = pa.schema(
        [pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32()), *(c.field for c in columns)],
        metadata={"time_source": source, "message": STREAM},
    )
    if not columns:
        raise FormatError("a parquet file without a column of numbers or words", path=name)
    reader = _Reader(file, columns, made, time, sample, limits, len(view))
    for label, kind in refused.items():
        reader.tally.undecode(f"{STREAM}.{label}", file.metadata.num_rows, f"columns of {kind} are not read")
    if time is None:
        for label, why in unused_times(sample.columns, sample.rows).items():
            reader.tally.undecode(f"{STREAM}.{label}", file.metadata.num_rows, why)
    for group in groups:
        yield from _parts(reader, group)
    missing = file.metadata.num_rows - sum(group.rows for group in groups)
    reader.odd.tell(reader.tally)
    if missing:
        reader.tally.undecode(STREAM, abs(missing), "the footer's counts of rows disagree")
    if reader.clock.late:
        reader.tally.out_of_order[STREAM] = reader.clock.late
    return Summary(reader.tally.freeze(), reader.clock.clocks(), {"time": source})


def _open(view: memoryview, name: str) -> pq.ParquetFile:
    try:
        return pq.ParquetFile(pa.BufferReader(pa.py_buffer(view)), page_checksum_verification=True)
    except DAMAGE as error:
        raise FormatError(
            f"the footer of this parquet file is missing or damaged: {_first_line(error)}",
            path=name,
            byte=max(0, len(view) - 8),
            hint="copy it again; nothing can be read from a parquet file that is cut or still being written",
        ) from error


def _schema_of(file: pq.ParquetFile, name: str) -> pa.Schema:
    try:
        return file.schema_arrow
    except DAMAGE as error:
        raise FormatError(f"the schema is not understood: {_first_line(error)}", path=name) from error


def _groups(file: pq.ParquetFile, size: int, limits: Limits) -> Iterator[_Group]:
    """The row groups, with what forbids to read them."""
    for number in range(file.metadata.num_row_groups):
        group = file.metadata.row_group(number)
        expanded = max(group.total_byte_size, group.num_rows * group.num_columns * CELL_BYTES)
        if group.num_rows < 0 or expanded > limits.max_chunk_bytes:
            fault = f"it expands to more than {limits.max_chunk_bytes:,} bytes"
            yield _Group(number, max(0, group.num_rows), 0, 0, fault)
        elif not _is_sound(file, number):
            yield _Group(number, group.num_rows, 0, 0)
        else:
            yield _place(file, number, size, limits)


def _is_sound(file: pq.ParquetFile, number: int) -> bool:
    """Whether a row group can be begun; asking Arrow for damaged metadata of a column ends the process."""
    first = file.iter_batches(batch_size=1, row_groups=[number], use_threads=False)
    try:
        return next(first, None) is not None
    except DAMAGE:
        return False


def _place(file: pq.ParquetFile, number: int, size: int, limits: Limits) -> _Group:
    """A row group with its place in the file."""
    group = file.metadata.row_group(number)
    chunks = [group.column(k) for k in range(group.num_columns)]
    repeats = [file.metadata.schema.column(k).max_repetition_level for k in range(group.num_columns)]
    starts = [c.data_page_offset for c in chunks]
    starts += [c.dictionary_page_offset for c in chunks if c.dictionary_page_offset]
    start = min(starts, default=0)
    packed = sum(c.total_compressed_size for c in chunks)
    plain_bytes = sum(c.total_uncompressed_size for c in chunks)
    flat = {c.num_values for c, repeat in zip(chunks, repeats, strict=True) if not repeat}
    fault = ""
    if start < 0 or packed < 0 or start + packed > size:
        fault = "it lies outside the file"
    elif flat - {group.num_rows}:
        fault = "its columns have unlike numbers of rows"
    elif plain_bytes > max(FREE_BYTES, limits.max_ratio * packed):
        fault = f"it expands to more than {limits.max_ratio:g} times its size"
    return _Group(number, group.num_rows, max(0, start), min(size, start + packed), fault)


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


# ------------------------------------------------------------------------------------------------ time


def _sample(file: pq.ParquetFile, groups: list[_Group]) -> Sample:
    """The first rows as text; none where they cannot be read."""
    numbers = [group.number for group in groups if not group.fault and group.rows][:1]
    try:
        batch = next(file.iter_batches(batch_size=SAMPLE_ROWS, row_groups=numbers, use_threads=False), None)
        return Sample() if batch is None or not numbers else sample_of(pa.Table.from_batches([batch]))
    except DAMAGE:
        return Sample()


def _time_of(
    file: pq.ParquetFile, groups: list[_Group], schema: pa.Schema, sample: Sample, limits: Limits, name: str
) -> TimeColumn | None:
    """The column that tells the time, with its unit; None where rows are only numbered.

    Dates beside times of day come first, then what the file itself types as times or numbers, then text.
    """
    text = find_time(sample.columns, sample.rows)
    if text is None or len(text.parts) == 1:
        typed = _typed_time(file, groups, schema, limits.time_unit, name)
        if typed is not None or text is None:
            return typed
    column = sample.names[text.parts[0]]
    last = _last_cell(file, groups, column)
    numbers = [] if text.forms else numbers_in([last], text.style)
    told = text.resolved(
        numbers[0] if numbers else float(text.first[-1]), limits.time_unit, limits.date_order, name
    )
    return TimeColumn(column, DATES, text=told)


def _last_cell(file: pq.ParquetFile, groups: list[_Group], name: str) -> str:
    """The last cell of a column as text; "" where it cannot be read."""
    for group in [group for group in groups if not group.fault and group.rows][-1:]:
        try:
            text = as_text(_whole(_read(file, group, [name])[name]))
            return str(text[len(text) - 1].as_py())
        except DAMAGE:
            break
    return ""


def _typed_time(
    file: pq.ParquetFile, groups: list[_Group], schema: pa.Schema, told: str, name: str
) -> TimeColumn | None:
    """The column of stamps or numbers that tells the time, with its unit."""
    sound = [group for group in groups if not group.fault and group.rows]
    for time in time_candidates(schema):
        if time.ticks is None:
            ends = [_numbers(file, group, time) for group in (*sound[:1], *sound[-1:])]
        else:
            ends = [_ticks(time.ticks, file.metadata.num_rows, 0).astype(np.float64)]
        readable = [values for values in ends if len(values)]
        if not readable or not rises(readable[0], time.moving):
            continue
        if time.unit == DATES:
            return time
        counted = time_unit(time.shown, readable[0], float(readable[-1][-1]), time.unit, told, name)
        return replace(time, unit=counted.unit, counted=counted)
    return None


def _ticks(rule: tuple[int, int], rows: int, before: int) -> IntArray:
    """(rows,) values of an evenly spaced index behind as many rows before."""
    return rule[0] + rule[1] * (before + np.arange(rows, dtype=np.int64))


def _numbers(file: pq.ParquetFile, group: _Group, time: TimeColumn) -> FloatArray:
    """(n,) the times in a group, as numbers; empty where it cannot be read."""
    try:
        column = _read(file, group, [time.name])[time.name].combine_chunks()
        return as_floats(column.cast(pa.int64()) if time.unit == DATES else column)
    except DAMAGE:
        return np.empty(0)


def _read(file: pq.ParquetFile, group: _Group, names: list[str]) -> pa.Table:
    return file.read_row_group(group.number, columns=names, use_threads=False)


def _times(reader: _Reader, table: pa.Table) -> tuple[IntArray, BoolArray]:
    """(n,) ns of every row, and which rows have a time."""
    time = reader.time
    if time is None:
        first = reader.rows
        return (first + np.arange(len(table), dtype=np.int64)) * SECOND_NS, np.ones(len(table), dtype=bool)
    if time.text is not None:
        return time.text.read(lambda part: as_text(_whole(table[reader.sample.names[part]])))
    if time.ticks is not None:
        ticks = _ticks(time.ticks, len(table), reader.rows)
        return to_ns(ticks.astype(np.float64), TIME_UNITS_NS[time.unit])
    column = _whole(table[time.name])
    origin = time.counted.origin if time.counted is not None else 0.0
    unit_ns = TIME_UNITS_NS[column.type.unit if time.counted is None else time.counted.unit]
    if pa.types.is_floating(column.type):
        values = column.cast(pa.float64()).to_numpy(zero_copy_only=False)
        return to_ns(values, unit_ns, origin)
    whole = column.cast(pa.int64(), safe=False)
    known = np.asarray(whole.is_valid().to_numpy(zero_copy_only=False), dtype=bool)
    ticks = np.asarray(whole.fill_null(0).to_numpy(zero_copy_only=False), dtype=np.int64) - int(origin)
    known &= np.abs(ticks) < (1 << 62) // unit_ns
    return np.where(known, ticks, 0) * unit_ns, known


def _whole(column: pa.ChunkedArray) -> pa.Array:
    """A column as one array."""
    values = column.combine_chunks()
    if not isinstance(values, pa.ChunkedArray):
        return values
    return pa.concat_arrays(values.chunks) if values.num_chunks else pa.array([], values.type)


# ------------------------------------------------------------------------------------------------ rows


def _parts(reader: _Reader, group: _Group) -> Iterator[StreamPart]:
    """The rows of a group, in batches; what cannot be read is counted."""
    table = None if group.fault else _table(reader, group)
    if table is None:
        why = f"row group {group.number}: {group.fault or 'its time cannot be read'}"
        _skip(reader, group.start, group.end, why)
        reader.tally.undecode(STREAM, group.rows, why)
        reader.rows += group.rows
        return
    time_ns, known = _times(reader, table)
    turn = NO_TURN if reader.time is None else reader.time.turn
    time_ns[known] = reader.clock.unwrapped(time_ns[known], turn)
    fits = known.copy()
    fits[known] = ~is_outlier(time_ns[known])
    reader.tally.undecode(STREAM, int((~known).sum()), "rows without a time")
    if strays := int((known & ~fits).sum()):
        reader.tally.time_outliers[STREAM] += strays
    columns = [_kept(reader, column, table) for column in reader.columns]
    reader.rows += len(table)
    if not fits.all():
        chosen = numeric(fits)
        columns = [column.filter(chosen) for column in columns]
        time_ns = time_ns[fits]
    heads = [numeric(time_ns), numeric(reader.clock.boots(time_ns))]
    whole = pa.Table.from_arrays([*heads, *columns], schema=reader.schema)
    step = max(1, reader.limits.batch_bytes * len(whole) // max(1, whole.nbytes))
    for start in range(0, len(whole), step):
        yield StreamPart(STREAM, whole.slice(start, step))


def _table(reader: _Reader, group: _Group) -> pa.Table | None:
    """A row group; damaged columns are null and counted. None where its time is lost."""
    tops = list(dict.fromkeys(column.path[0] for column in reader.columns))
    try:
        table = _read(reader.file, group, tops)
        if len(table) == group.rows:
            return table
    except DAMAGE:
        pass
    return _column_by_column(reader, group, tops)


def _column_by_column(reader: _Reader, group: _Group, tops: list[str]) -> pa.Table | None:
    schema = reader.file.schema_arrow
    found = {}
    lost = {}
    for name in tops:
        try:
            column = _read(reader.file, group, [name])[name]
            if len(column) != group.rows:
                raise ValueError(f"{len(column)} rows of {group.rows}")
            found[name] = column
        except DAMAGE as error:
            lost[name] = _first_line(error)
    if not found or (reader.time is not None and reader.time.name in lost):
        return None
    for name, why in lost.items():
        reader.tally.undecode(f"{STREAM}.{name}", group.rows, f"row group {group.number}: {why}")
        found[name] = pa.nulls(group.rows, schema.field(name).type)
    return pa.table([found[name] for name in tops], names=tops)


def _kept(reader: _Reader, column: Column, table: pa.Table) -> pa.Array:
    """A column of a group in its plain type; null where its values do not fit it."""
    values = _whole(table[column.path[0]])
    for step in column.path[1:]:
        values = pc.struct_field(values, [step])
    if column.style is not None:
        return _numbers_in(reader, column, values)
    try:
        return plain(values, column.field.type)
    except DAMAGE as error:
        reader.tally.undecode(f"{STREAM}.{column.field.name}", len(values), _first_line(error))
        return pa.nulls(len(values), column.field.type)


def _numbers_in(reader: _Reader, column: Column, values: pa.Array) -> pa.Array:
    """Text of numbers as numbers; cells that are none are noted with their rows."""
    assert column.style is not None
    text = as_text(values)
    found, wrong = floats(text, column.style)
    at = np.flatnonzero(wrong)
    if len(at):
        rows = (reader.rows + 1 + at).tolist()
        reader.odd.note(f"{STREAM}.{column.field.name}", rows, text[int(at[0])].as_py())
    return found


def _skip(reader: _Reader, start: int, end: int, why: str) -> None:
    """Count bytes as skipped: within the file and in rising order, whatever the footer says."""
    start = max(start, reader.read_to)
    reader.tally.skip(start, end, why)
    reader.read_to = max(reader.read_to, end)
