"""Parts of streams to parquet files, in bounded memory.

Rows arrive in parts, in any interleaving. They wait in memory until `BUFFER_BYTES` are reached in all;
then the stream that holds most is written as a row group. A stream whose row groups turn out to overlap
in time is merged at the end, row group by row group; where more than `SORT_BYTES` would have to wait for
earlier rows behind them, its manifest entry marks it as not sorted, and readers sort it. So memory stays
bounded whatever the log's size.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import accumulate, pairwise
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.fs
import pyarrow.parquet as pq

from flysid.errors import StoreError
from flysid.files import slug, writing_to
from flysid.flight import BOOT, RECEIVED, TIME, field_scale, field_unit
from flysid.manifest import Column, StreamEntry

BUFFER_BYTES = 32 << 20
SORT_BYTES = 32 << 20
ROWS_PER_GROUP = 1 << 20
MAX_OPEN_FILES = 200
BLOCK_BYTES = 4096  # what a file takes on the disk at least: smaller ones gain nothing from being compressed
IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]
_END = (1 << 31, 0)  # behind every (boot, time)
_FILES = pyarrow.fs.LocalFileSystem()


@dataclass
class _Stream:
    """One stream while it is being written."""

    key: str
    path: Path
    schema: pa.Schema
    row_bytes: int  # 0 where rows differ in size
    waiting: list[pa.Table] = field(default_factory=list)
    waiting_bytes: int = 0
    rows: int = 0
    starts: list[tuple[int, int]] = field(default_factory=list)  # (boot, time) that row groups begin with
    writer: pq.ParquetWriter | None = None
    last: tuple[int, int] = (-(1 << 31), -(1 << 63))
    is_sorted: bool = True
    spans: dict[int, tuple[int, int, int]] = field(default_factory=dict)  # boot -> rows, first, last


class FlightWriter:
    """Buffers the streams of one flight and writes row groups; see the module's docstring."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._streams: dict[str, _Stream] = {}
        self._taken: set[str] = set()
        self._waiting = 0
        self._open = 0

    def add(self, key: str, table: pa.Table) -> None:
        stream = self._streams.get(key)
        if stream is None:
            name = slug(key, self._taken)
            self._taken.add(name.casefold())
            stream = self._streams[key] = _Stream(
                key, self._folder / f"{name}.parquet", table.schema, _row_bytes(table.schema)
            )
        elif not table.schema.equals(stream.schema):
            raise StoreError(f"the reader changed the columns of stream {key!r} midway", path=stream.path)
        if table.num_rows == 0:
            return
        size = table.num_rows * stream.row_bytes if stream.row_bytes else table.nbytes
        stream.waiting.append(table)
        stream.waiting_bytes += size
        self._waiting += size
        while self._waiting > BUFFER_BYTES:
            self._flush(self._fullest())

    def finish(self, renamed: Mapping[str, str] = MappingProxyType({})) -> tuple[StreamEntry, ...]:
        """Write all that waits, sort what needs it; entries by stream key, of those `renamed` the new one."""
        for stream in self._streams.values():
            stream.key = renamed.get(stream.key, stream.key)
            self._flush(stream)
            self._close(stream)
            if not stream.is_sorted:
                _merge(stream)
        return tuple(_entry(stream) for stream in sorted(self._streams.values(), key=lambda s: s.key))

    def close(self) -> None:
        for stream in self._streams.values():
            stream.waiting.clear()
            self._close(stream)

    def _fullest(self) -> _Stream:
        streams = list(self._streams.values())
        if self._open >= MAX_OPEN_FILES:
            streams = [s for s in streams if s.writer is not None and s.waiting] or streams
        return max(streams, key=lambda s: s.waiting_bytes)

    def _flush(self, stream: _Stream) -> None:
        if stream.writer is None:
            with writing_to(stream.path):
                stream.writer = _parquet_writer(stream.path, stream.schema, stream.waiting_bytes)
            self._open += 1
        if not stream.waiting:
            return
        table, boots, times = _order(pa.concat_tables(stream.waiting))
        self._waiting -= stream.waiting_bytes
        stream.waiting = []
        stream.waiting_bytes = 0
        stream.rows += table.num_rows
        _note_times(stream, boots, times)
        with writing_to(stream.path):
            stream.writer.write_table(table, row_group_size=ROWS_PER_GROUP)

    def _close(self, stream: _Stream) -> None:
        if stream.writer is not None:
            writer = stream.writer
            stream.writer = None
            self._open -= 1
            with writing_to(stream.path):
                writer.close()


def _row_bytes(schema: pa.Schema) -> int:
    """How many bytes each row takes; 0 where that differs. `Table.nbytes` is slow: small logs notice it."""
    bits = [kind.bit_width for kind in schema.types if pa.types.is_primitive(kind)]
    return sum(bits) // 8 if len(bits) == len(schema.types) else 0


def _parquet_writer(path: Path, schema: pa.Schema, size: int) -> pq.ParquetWriter:
    """A writer of a stream of which `size` bytes wait to be written.

    Without dictionaries, which cost time and, beside zstd, space. Extremes are noted of the times only, as
    rows are in their order and in no other.
    """
    packed = (
        {"compression": "zstd", "compression_level": 1} if size > BLOCK_BYTES else {"compression": "none"}
    )
    return pq.ParquetWriter(
        str(path),
        schema,
        filesystem=_FILES,
        version="2.6",
        use_dictionary=False,
        write_statistics=[BOOT, TIME],
        **packed,
    )


def _merge(stream: _Stream) -> None:
    """Write a stream's file anew in order, unless too many rows would have to wait at once."""
    file = pq.ParquetFile(stream.path, memory_map=False)
    later = list(accumulate(reversed([*stream.starts[1:], _END]), min))[::-1]
    temporary = stream.path.with_suffix(".sorting")
    waiting = pa.Table.from_batches([], stream.schema)  # Schema.empty_table() imports pandas
    with writing_to(stream.path), _parquet_writer(temporary, stream.schema, SORT_BYTES) as writer:
        for group, earliest in enumerate(later):
            waiting = in_order(pa.concat_tables([waiting, file.read_row_group(group)]))
            ready = _rows_before(waiting, earliest)
            if ready:
                writer.write_table(waiting.slice(0, ready), row_group_size=ROWS_PER_GROUP)
            waiting = waiting.slice(ready)
            if waiting.nbytes > SORT_BYTES:
                break
    with writing_to(stream.path):
        if waiting.num_rows:
            temporary.unlink()
        else:
            temporary.replace(stream.path)
            stream.is_sorted = True


def _rows_before(table: pa.Table, key: tuple[int, int]) -> int:
    """How many rows of a table in order come before (boot, time)."""
    boots = int_values(table[BOOT])
    first = np.searchsorted(boots, key[0], "left")
    last = np.searchsorted(boots, key[0], "right")
    return int(first + np.searchsorted(int_values(table[TIME])[first:last], key[1], "left"))


def int_values(column: pa.ChunkedArray) -> IntArray:
    """(n,) the values of an integer column without nulls, as int64, without importing pandas."""
    pieces = [
        np.frombuffer(chunk.buffers()[1], dtype=f"i{chunk.type.bit_width // 8}")[
            chunk.offset : chunk.offset + len(chunk)
        ]
        for chunk in column.chunks
        if len(chunk)
    ]
    joined = pieces[0] if len(pieces) == 1 else np.concatenate([np.empty(0, np.int64), *pieces])
    return joined.astype(np.int64, copy=False)


def float_values(column: pa.Array | pa.ChunkedArray) -> FloatArray:
    """(n,) the values of a column of numbers, NaN where there is none, without importing pandas."""
    if not len(column):
        return np.empty(0)
    if isinstance(column, pa.ChunkedArray):
        return np.concatenate([float_values(chunk) for chunk in column.chunks])
    numbers = column.cast(pa.float64(), safe=False)
    valid, data = numbers.buffers()
    here = slice(numbers.offset, numbers.offset + len(numbers))
    values = np.frombuffer(data, dtype=np.float64)[here]
    if not numbers.null_count:
        return values
    is_there = np.unpackbits(np.frombuffer(valid, dtype=np.uint8), bitorder="little")[here]
    return np.where(is_there, values, np.nan)


def in_order(table: pa.Table) -> pa.Table:
    """`table` sorted by (boot, time_ns), rows of equal time in order of arrival."""
    return _order(table)[0]


def _order(table: pa.Table) -> tuple[pa.Table, IntArray, IntArray]:
    """`in_order`, and the boots and times of its rows."""
    boots = int_values(table[BOOT])
    times = int_values(table[TIME])
    if _rises(boots, times):
        return table, boots, times
    order = np.lexsort((times, boots))
    taken = table.take(pa.Array.from_buffers(pa.int64(), len(order), [None, pa.py_buffer(order)]))
    return taken, boots[order], times[order]


def _rises(boots: IntArray, times: IntArray) -> bool:
    """Whether rows are in order of (boot, time)."""
    if len(times) < 2:
        return True
    step = boots[1:] - boots[:-1]
    return not ((step < 0) | ((times[1:] < times[:-1]) & (step == 0))).any()


def _note_times(stream: _Stream, boots: IntArray, times: IntArray) -> None:
    """Note how row groups begin, the spans per boot, whether it is all sorted; rows are in order."""
    stream.starts += zip(boots[::ROWS_PER_GROUP].tolist(), times[::ROWS_PER_GROUP].tolist(), strict=True)
    first = (int(boots[0]), int(times[0]))
    last = (int(boots[-1]), int(times[-1]))
    stream.is_sorted &= first >= stream.last
    stream.last = max(stream.last, last)
    edges = [0, *(np.flatnonzero(np.diff(boots)) + 1).tolist(), len(boots)]
    for start, stop in pairwise(edges):
        boot = int(boots[start])
        lo = int(times[start])
        hi = int(times[stop - 1])
        rows, old_lo, old_hi = stream.spans.get(boot, (0, lo, hi))
        stream.spans[boot] = (rows + stop - start, min(lo, old_lo), max(hi, old_hi))


def _entry(stream: _Stream) -> StreamEntry:
    spans = stream.spans.values()
    seconds = sum(hi - lo for _, lo, hi in spans) * 1e-9
    steps = sum(rows - 1 for rows, _, _ in spans)
    return StreamEntry(
        stream=stream.key,
        file=stream.path.name,
        rows=stream.rows,
        columns=_columns(stream.schema.remove_metadata().serialize().to_pybytes()),
        first_ns=min((lo for _, lo, _ in spans), default=None),
        last_ns=max((hi for _, _, hi in spans), default=None),
        rate_hz=steps / seconds if seconds > 0 else None,
        boots=tuple(sorted(stream.spans)),
        is_sorted=stream.is_sorted,
        metadata={
            k.decode(errors="replace"): v.decode(errors="replace")
            for k, v in sorted((stream.schema.metadata or {}).items())
        },
    )


@lru_cache(maxsize=1 << 10)
def _columns(schema: bytes) -> tuple[Column, ...]:
    """A manifest's entry for the columns of a schema: logs of one kind share theirs."""
    return tuple(_describe(column) for column in pa.ipc.read_schema(pa.py_buffer(schema)))


def _describe(column: pa.Field) -> Column:
    facts = column.metadata or {}
    return Column(
        name=column.name,
        type=str(column.type),
        unit="ns" if column.name in (TIME, RECEIVED) else field_unit(column),
        scale=field_scale(column),
        enum=json.loads(facts.get(b"enum", b"{}")),
        description=facts.get(b"description", b"").decode(errors="replace"),
    )
