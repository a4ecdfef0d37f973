"""The time of the rows of a parquet file: which columns tell it, and what they say.

Stamps and numbers count as the file types them; text, maybe in several columns, as in a table of text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import time_columns
from flysid.ingest.formats.common.clock import SECOND_NS, BoolArray, IntArray
from flysid.ingest.formats.common.table_numbers import numbers_in
from flysid.ingest.formats.common.table_times import rises, to_ns
from flysid.ingest.formats.common.time_units import TIME_UNITS_NS, time_unit
from flysid.ingest.formats.parquet.columns import (
    DATES,
    Sample,
    TimeColumn,
    as_floats,
    as_text,
    is_cell,
    sample_of,
    time_candidates,
)
from flysid.ingest.formats.parquet.stretches import (
    CELL_BYTES,
    DAMAGE,
    RowGroup,
    Stretches,
    cells,
    spelt_bytes,
)
from flysid.stretch import FloatArray

SAMPLE_ROWS = 500
SAMPLE_BYTES = 8 << 20  # of the rows by which a time is known, whatever the caller reads at once


# ---------------------------------------------------------------------------------------- first rows


def sample_rows(file: pq.ParquetFile, groups: Sequence[RowGroup], schema: pa.Schema) -> Sample:
    """The first rows of the first group that can be read, as text, without its damaged columns.

    Fewer rows where these take more than SAMPLE_BYTES.
    """
    names = list(dict.fromkeys(field.name for field in schema if is_cell(field.type)))
    size = min(SAMPLE_ROWS, max(1, SAMPLE_BYTES // (CELL_BYTES * max(1, len(names)))))
    for group in _sound(groups) if names else ():
        table = _first(file, group, names, size)
        if table is None:
            alone = [found for name in names if (found := _first(file, group, [name], size)) is not None]
            table = _beside(alone)
        if table is not None:
            return sample_of(_within(table, SAMPLE_BYTES))
    return Sample()


def _sound(groups: Sequence[RowGroup]) -> list[RowGroup]:
    return [group for group in groups if not group.fault and group.rows]


def _first(file: pq.ParquetFile, group: RowGroup, names: Sequence[str], size: int) -> pa.Table | None:
    """The first rows of a group; None where they cannot be read."""
    return next(Stretches(file, group.number, group.rows, names, size).together(), None)


def _beside(tables: Sequence[pa.Table]) -> pa.Table | None:
    """Columns of several tables in one, as far as the shortest goes; None without any."""
    if not tables:
        return None
    rows = min(len(table) for table in tables)
    columns = [column for table in tables for column in table.slice(0, rows).columns]
    fields = [field for table in tables for field in table.schema]
    return pa.Table.from_arrays(columns, schema=pa.schema(fields))


def _within(table: pa.Table, most_bytes: int) -> pa.Table:
    """The first rows whose text takes no more than this many bytes once it is spelt out; at least one."""
    while len(table) > 1:
        columns = (cells(table.select([k]), field.name) for k, field in enumerate(table.schema))
        if sum(map(spelt_bytes, columns)) <= most_bytes:
            break
        table = table.slice(0, len(table) // 2)
    return table


# ------------------------------------------------------------------------------------------- finding


def find_time(
    file: pq.ParquetFile,
    groups: Sequence[RowGroup],
    schema: pa.Schema,
    sample: Sample,
    limits: Limits,
    name: str,
) -> TimeColumn | None:
    """The column that tells the time, with its unit; None where rows are only numbered.

    Dates beside times of day come first, then what the file itself types as times or numbers, then text.
    """
    text = time_columns.find_time(sample.columns, sample.rows)
    if text is None or (len(text.parts) == 1 and not text.is_packed):
        typed = _typed_time(file, groups, schema, limits.time_unit, name)
        if typed is not None or text is None:
            return typed
    top, nth = sample.places[text.parts[0]]
    numbers = [] if text.forms else numbers_in([_last_cell(file, groups, top, nth)], text.style)
    last = numbers[0] if numbers else float(text.first[-1])
    return TimeColumn(top, DATES, text=text.resolved(last, limits.time_unit, limits.date_order, name))


def columns_of_time(time: TimeColumn, sample: Sample) -> set[str]:
    """Names of the file's columns that tell of the time together."""
    return {time.name} if time.text is None else {sample.places[part][0] for part in time.text.columns}


def _last_cell(file: pq.ParquetFile, groups: Sequence[RowGroup], top: str, nth: int) -> str:
    """The last cell of a column as text; "" where it cannot be read."""
    for group in _sound(groups)[-1:]:
        for table in _ends(file, group, top)[-1:]:
            return str(as_text(cells(table.slice(len(table) - 1), top, nth))[0].as_py())
    return ""


def _typed_time(
    file: pq.ParquetFile, groups: Sequence[RowGroup], schema: pa.Schema, told: str, name: str
) -> TimeColumn | None:
    """The column of stamps or numbers that tells the time, with its unit."""
    sound = _sound(groups)
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


def _numbers(file: pq.ParquetFile, group: RowGroup, time: TimeColumn) -> FloatArray:
    """(n,) the first times of a group and its last ones, as numbers; empty where it cannot be read."""
    columns = [cells(table, time.name) for table in _ends(file, group, time.name)]
    try:
        numbers = [as_floats(c.cast(pa.int64()) if time.unit == DATES else c) for c in columns]
    except DAMAGE:
        return np.empty(0)
    return np.concatenate(numbers) if numbers else np.empty(0)


def _ends(file: pq.ParquetFile, group: RowGroup, top: str) -> list[pa.Table]:
    """The first stretch of a group's column and the last, which may be one; none where it cannot be read."""
    first = last = None
    rows = 0
    for table in Stretches.of(file, group, [top], SAMPLE_BYTES).together():
        last = table
        first = table if first is None else first
        rows += len(table)
    if first is None or last is None or rows != group.rows:
        return []
    return [first] if last is first else [first, last]


# ------------------------------------------------------------------------------------------- reading


def times_in(
    time: TimeColumn | None, sample: Sample, table: pa.Table, before: int
) -> tuple[IntArray, BoolArray]:
    """(n,) ns of every row of a stretch, and which rows have a time; `before`: rows ahead of it."""
    if time is None:
        rows = before + np.arange(len(table), dtype=np.int64)
        return rows * SECOND_NS, np.ones(len(table), dtype=bool)
    if time.text is not None:
        return time.text.read(lambda part: as_text(cells(table, *sample.places[part])))
    if time.ticks is not None:
        ticks = _ticks(time.ticks, len(table), before)
        return to_ns(ticks.astype(np.float64), TIME_UNITS_NS[time.unit])
    column = cells(table, time.name)
    origin = time.counted.origin if time.counted is not None else 0.0
    unit_ns = TIME_UNITS_NS[column.type.unit if time.counted is None else time.counted.unit]
    if not pa.types.is_integer(column.type) and time.unit != DATES:
        values = column.cast(pa.float64()).to_numpy(zero_copy_only=False)
        return to_ns(values, unit_ns, origin)
    whole = column.cast(pa.int64(), safe=False)
    known = np.asarray(whole.is_valid().to_numpy(zero_copy_only=False), dtype=bool)
    ticks = np.asarray(whole.fill_null(0).to_numpy(zero_copy_only=False), dtype=np.int64) - int(origin)
    known &= np.abs(ticks) < (1 << 62) // unit_ns
    return np.where(known, ticks, 0) * unit_ns, known
