"""Tables in parquet files, as pandas, polars, MATLAB and DuckDB write them: one stream called `table`.

Units come from the fields' metadata (`unit`, `units`), else from the names, as in text (`table_columns`). The
time is the index that pandas had, a column that is called a time, or one of stamps. A file is read one row
group at a time; where a group is damaged, its columns are read one by one, and what is lost is counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from flysid.errors import FormatError
from flysid.flight import BOOT, ROW_NUMBER, TIME
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary
from flysid.ingest.formats.common.arrow_arrays import numeric
from flysid.ingest.formats.common.clock import is_outlier
from flysid.ingest.formats.common.instance_names import table_key
from flysid.ingest.formats.common.odd_cells import OddCells
from flysid.ingest.formats.common.table_numbers import floats
from flysid.ingest.formats.common.table_times import NO_TURN, TableClock
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.common.time_columns import unused_times
from flysid.ingest.formats.parquet.columns import Column, Sample, TimeColumn, as_text, columns_of, plain
from flysid.ingest.formats.parquet.stretches import (
    CELL_BYTES,
    DAMAGE,
    FREE_BYTES,
    RowGroup,
    Stretches,
    cells,
    first_line,
    open_file,
    spelt_bytes,
    too_large,
)
from flysid.ingest.formats.parquet.times import columns_of_time, find_time, sample_rows, times_in
from flysid.tabular import FORMAT as DATASET
from flysid.tabular import META

MAGIC = b"PAR1"
STREAM = "table"


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
    spelt: int = 0  # bytes of text so far

    @property
    def timing(self) -> set[str]:
        """Names of the file's columns without which no row has a time."""
        return set() if self.time is None else columns_of_time(self.time, self.sample)


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a table; see `Format.read`."""
    file = _open(view, name)
    schema = _schema_of(file, name)
    if DATASET.encode() in (schema.metadata or {}).get(META, b""):
        raise FormatError(
            "this is a dataset that flysid wrote, not a log", path=name, hint=f"flysid fit {name} -o RUN"
        )
    groups = list(_groups(file, len(view), limits))
    large = too_large(file, [g.number for g in groups if g.is_sound and not g.fault], limits)
    kept = pa.schema([each for each in schema if each.name not in large], schema.metadata)
    sample = sample_rows(file, groups, kept)
    columns, refused = columns_of(schema, sample)
    columns = [column for column in columns if column.top not in large]
    time = find_time(file, groups, kept, sample, limits, name)
    source = ROW_NUMBER if time is None else time.source
    made = pa.schema(
        [pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32()), *(c.field for c in columns)],
        metadata={
            "time_source": source,
            "message": STREAM,
            **table_key([column.field.name for column in columns]),
        },
    )
    if not columns:
        raise FormatError("a parquet file without a column of numbers or words", path=name)
    reader = _Reader(file, columns, made, time, sample, limits, len(view))
    for label, kind in refused.items():
        reader.tally.undecode(f"{STREAM}.{label}", file.metadata.num_rows, f"columns of {kind} are not read")
    for label, why in large.items():
        reader.tally.undecode(f"{STREAM}.{label}", file.metadata.num_rows, why)
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
        return open_file(view)
    except DAMAGE as error:
        raise FormatError(
            f"the footer of this parquet file is missing or damaged: {first_line(error)}",
            path=name,
            byte=max(0, len(view) - 8),
            hint="copy it again; nothing can be read from a parquet file that is cut or still being written",
        ) from error


def _schema_of(file: pq.ParquetFile, name: str) -> pa.Schema:
    try:
        return file.schema_arrow
    except DAMAGE as error:
        raise FormatError(f"the schema is not understood: {first_line(error)}", path=name) from error


def _groups(file: pq.ParquetFile, size: int, limits: Limits) -> Iterator[RowGroup]:
    """The row groups, with what forbids to read them."""
    for number in range(file.metadata.num_row_groups):
        group = file.metadata.row_group(number)
        expanded = max(group.total_byte_size, group.num_rows * group.num_columns * CELL_BYTES)
        if group.num_rows < 0 or expanded > limits.max_chunk_bytes:
            fault = f"it expands to more than {limits.max_chunk_bytes:,} bytes"
            yield RowGroup(number, max(0, group.num_rows), 0, 0, fault)
        elif not _is_sound(file, number):
            yield RowGroup(number, group.num_rows, 0, 0, is_sound=False)
        else:
            yield _place(file, number, size, limits)


def _is_sound(file: pq.ParquetFile, number: int) -> bool:
    """Whether a row group can be begun; asking Arrow for damaged metadata of a column ends the process."""
    first = file.iter_batches(batch_size=1, row_groups=[number], use_threads=False)
    try:
        return next(first, None) is not None
    except DAMAGE:
        return False


def _place(file: pq.ParquetFile, number: int, size: int, limits: Limits) -> RowGroup:
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
    return RowGroup(number, group.num_rows, max(0, start), min(size, start + packed), fault)


# ------------------------------------------------------------------------------------------------ rows


def _parts(reader: _Reader, group: RowGroup) -> Iterator[StreamPart]:
    """The rows of a group, in stretches; what cannot be read is counted."""
    done = 0
    why = group.fault
    if not why:
        names = list(dict.fromkeys(column.top for column in reader.columns))
        stretches = Stretches.of(reader.file, group, names, reader.limits.batch_bytes)
        for table in stretches.together():
            yield from _parts_of(reader, table)
            done += len(table)
        lost = stretches.faults() if done < group.rows else {}
        if len(lost) == len(names) or not reader.timing.isdisjoint(lost):
            why = "its time cannot be read"
        elif lost:
            for name, reason in lost.items():
                reason = f"row group {group.number}: {reason}"
                reader.tally.undecode(f"{STREAM}.{name}", group.rows - done, reason)
            for table in stretches.without(lost, done):
                yield from _parts_of(reader, table)
                done += len(table)
    if done < group.rows:
        why = f"row group {group.number}: {why or 'its columns do not go together'}"
        _skip(reader, group.start, group.end, why)
        reader.tally.undecode(STREAM, group.rows - done, why)
        reader.rows += group.rows - done


def _parts_of(reader: _Reader, table: pa.Table) -> Iterator[StreamPart]:
    """A stretch as parts, none of which spells out more text than a batch has bytes."""
    spelt = sum(spelt_bytes(_values(column, table)) for column in reader.columns)
    if spelt > reader.limits.batch_bytes and len(table) > 1:
        half = len(table) // 2
        yield from _parts_of(reader, table.slice(0, half))
        yield from _parts_of(reader, table.slice(half))
        return
    time_ns, known = times_in(reader.time, reader.sample, table, reader.rows)
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
    yield StreamPart(STREAM, pa.Table.from_arrays([*heads, *columns], schema=reader.schema))


def _kept(reader: _Reader, column: Column, table: pa.Table) -> pa.Array:
    """A column of a stretch in its plain type; null where its values do not fit it, or take too much."""
    values = _values(column, table)
    spelt = spelt_bytes(values)
    reader.spelt += spelt
    if spelt and reader.spelt > max(FREE_BYTES, reader.limits.max_ratio * reader.size):
        why = f"its text expands to more than {reader.limits.max_ratio:g} times the file"
        reader.tally.undecode(f"{STREAM}.{column.field.name}", len(values), why)
        return pa.nulls(len(values), column.field.type)
    if column.style is not None:
        return _numbers_in(reader, column, values)
    try:
        return plain(values, column.field.type)
    except DAMAGE as error:
        reader.tally.undecode(f"{STREAM}.{column.field.name}", len(values), first_line(error))
        return pa.nulls(len(values), column.field.type)


def _values(column: Column, table: pa.Table) -> pa.Array:
    """The cells of a column as the file has them."""
    first, *steps = column.place
    values = cells(table, column.top, first)
    for step in steps:
        values = pc.struct_field(values, [step])
    return values


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
