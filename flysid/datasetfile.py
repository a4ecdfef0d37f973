"""A dataset as one parquet file, written and read segment by segment, in bounded memory.

The columns are those of `flysid.tabular`; any parquet reader understands them. Row groups end at segments'
ends where segments are short, so that a reader holds one row group and one segment at a time.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from flysid import tabular
from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import DataError, StoreError, UsageError
from flysid.flightwriter import sync, writing_to
from flysid.version import check_version

ROWS_PER_GROUP = 1 << 19


def write_dataset(path: str | Path, head: tabular.Head, segments: Iterable[Segment] | None = None) -> int:
    """Write a dataset; returns the number of samples. The file appears whole or not at all.

    Parameters
    ----------
    path : the file; must not exist.
    head : a Dataset, or anything with its sample time and signals.
    segments : the segments, one at a time; those of `head` when None.

    Raises
    ------
    UsageError : the file exists. WriteError : it cannot be written.
    """
    path = Path(path)
    if path.exists():
        raise UsageError("the target exists", path=path, hint="choose another name")
    temporary = path.with_name(f".{path.name}.incoming")
    try:
        with writing_to(path):
            rows = _write(temporary, head, head.segments if segments is None else segments)  # type: ignore[attr-defined]
            sync(temporary)
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return rows


def _write(path: Path, head: tabular.Head, segments: Iterable[Segment]) -> int:
    rows, waiting, held = 0, [], 0
    with pq.ParquetWriter(path, tabular.schema_of(head), compression="zstd", compression_level=1) as writer:
        for number, segment in enumerate(segments):
            waiting.append(tabular.batch_of(head, segment, number))
            held += len(segment)
            rows += len(segment)
            if held >= ROWS_PER_GROUP:
                _flush(writer, waiting)
                held = 0
        _flush(writer, waiting)
    return rows


def _flush(writer: pq.ParquetWriter, waiting: list[pa.RecordBatch]) -> None:
    if waiting:
        writer.write_table(pa.Table.from_batches(waiting).unify_dictionaries(), row_group_size=ROWS_PER_GROUP)
        waiting.clear()


@dataclass(frozen=True)
class DatasetFile:
    """A dataset on disk; iterating gives its segments, one at a time."""

    path: Path
    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    name: str
    rows: int

    def __len__(self) -> int:
        """Number of samples."""
        return self.rows

    def __iter__(self) -> Iterator[Segment]:
        """The segments in the order they were written."""
        return self._first(self.rows)

    def read(self) -> Dataset:
        """The whole dataset in memory."""
        return self._in_memory(self)

    def head(self, rows: int) -> Dataset:
        """The first `rows` samples in memory, or all where there are fewer."""
        return self._in_memory(self._first(rows))

    def blocks(self) -> Iterator[tuple[int, FloatArray, FloatArray]]:
        """(segment number, (n, n_u), (n, n_y)): all samples in order, however long a segment is.

        Raises
        ------
        StoreError : the file is damaged. DataError : a sample is not finite.
        """
        n_u = len(self.inputs)
        columns = ["segment", *tabular.column_names(self)]
        for batch in self._batches(columns):
            for piece in _by_segment(batch):
                signals = np.stack([piece.column(name).to_numpy() for name in columns[1:]], axis=1)
                if not np.isfinite(signals).all():
                    raise DataError("holds values that are not finite", path=self.path)
                yield _number(piece), signals[:, :n_u], signals[:, n_u:]

    def _in_memory(self, segments: Iterable[Segment]) -> Dataset:
        return Dataset(self.dt_s, self.inputs, self.outputs, tuple(segments), self.name)

    def _first(self, rows: int) -> Iterator[Segment]:
        parts: list[pa.RecordBatch] = []
        for batch in self._batches():
            for piece in _by_segment(batch.slice(0, rows)):
                if parts and _number(parts[0]) != _number(piece):
                    yield self._segment(parts)
                    parts = []
                parts.append(piece)
            rows -= min(rows, len(batch))
            if rows == 0:
                break
        if parts:
            yield self._segment(parts)

    def _batches(self, columns: list[str] | None = None) -> Iterator[pa.RecordBatch]:
        try:
            with pq.ParquetFile(self.path, memory_map=False, pre_buffer=False) as file:
                for group in range(file.num_row_groups):
                    yield from file.read_row_group(group, columns=columns).to_batches()
        except (OSError, pa.ArrowException) as error:
            raise StoreError(f"damaged dataset: {error}", path=self.path) from error

    def _segment(self, parts: list[pa.RecordBatch]) -> Segment:
        table, n_u = pa.Table.from_batches(parts), len(self.inputs)
        first = len(tabular.FIXED)
        columns = [table.column(first + i).to_numpy() for i in range(n_u + len(self.outputs))]
        return Segment(
            u=np.stack(columns[:n_u], axis=1),
            y=np.stack(columns[n_u:], axis=1),
            t0_ns=table["time_ns"][0].as_py(),
            flight=table["flight"][0].as_py(),
            marks=json.loads(table["marks"][0].as_py()),
        )


def open_dataset(path: str | Path) -> DatasetFile:
    """Open a dataset file; only its head is read.

    Raises
    ------
    StoreError : missing, not a dataset, damaged, or of a newer version.
    """
    path = Path(path)
    try:
        with pq.ParquetFile(path) as file:
            rows = file.metadata.num_rows
            document = json.loads((file.schema_arrow.metadata or {})[tabular.META])
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise StoreError("not a dataset file of flysid", path=path) from error
    if not isinstance(document, dict) or document.get("format") != tabular.FORMAT:
        raise StoreError("not a dataset file of flysid", path=path)
    check_version(document.get("version"), tabular.VERSION, "dataset", path)
    try:
        inputs, outputs = _signals(document["inputs"]), _signals(document["outputs"])
        return DatasetFile(path, float(document["dt_s"]), inputs, outputs, str(document["name"]), rows)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise StoreError(f"damaged dataset: {error}", path=path) from error


def _signals(documents: list[dict[str, Any]]) -> tuple[Signal, ...]:
    return tuple(Signal(d["name"], d["unit"], float(d["resolution"])) for d in documents)


def _number(batch: pa.RecordBatch) -> int:
    return int(batch.column("segment")[0].as_py())


def _by_segment(batch: pa.RecordBatch) -> Iterator[pa.RecordBatch]:
    """The batch, cut where the segment's number changes."""
    numbers = batch.column("segment").to_numpy()
    edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    for start, stop in itertools.pairwise(edges):
        if stop > start:
            yield batch.slice(start, stop - start)
