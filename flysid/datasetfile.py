"""A dataset as one parquet file, written and read segment by segment, in bounded memory.

The columns are those of `flysid.tabular`; any parquet reader understands them. Row groups end at segments'
ends where segments are short, so that a reader holds one row group and one segment at a time.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from flysid import tabular
from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import DataError, StoreError, UsageError
from flysid.files import new_file, remedy_unread, why_unread, writing_to
from flysid.version import check_version

ROWS_PER_GROUP = 1 << 19
HOW = "write one in Python: flysid.open(DATA).write(RECIPE, CHANNEL, PATH)"


def write_dataset(path: str | Path, head: tabular.Head, segments: Iterable[Segment] | None = None) -> int:
    """Write a dataset; returns the number of samples. The file appears whole or not at all.

    `path`: the file; must not exist.
    `head`: a Dataset, or anything with its sample time and signals.
    `segments`: the segments, one at a time; those of `head` when None.
    Raises UsageError: the file exists. Raises WriteError: it cannot be written.
    """
    path = Path(path)
    if path.exists():
        raise UsageError("the target exists", path=path, hint="choose another name")
    with new_file(path) as temporary, writing_to(path):
        return _write(temporary, head, head.segments if segments is None else segments)  # type: ignore[attr-defined]


def _write(path: Path, head: tabular.Head, segments: Iterable[Segment]) -> int:
    rows = 0
    waiting = []
    held = 0
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
class Entry:
    """Where one segment stands in a file: its number, first row and number of rows; flight, marks, and the
    time of its first sample."""

    number: int
    start: int
    rows: int
    flight: str
    marks: Mapping[str, str | float] = field(default_factory=dict)
    t0_ns: int = 0


@dataclass(frozen=True)
class DatasetFile:
    """A dataset on disk; iterating gives its segments, one at a time.

    Memory is bounded by one row group (half a million rows, where segments are short) and one segment.

    `rows`: samples.
    `only`: numbers of the segments that belong to it; None: all of the file's.
    """

    path: Path
    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    name: str
    rows: int
    only: frozenset[int] | None = None

    def __len__(self) -> int:
        """Number of samples."""
        return self.rows

    def __iter__(self) -> Iterator[Segment]:
        """The segments in the order they were written."""
        return self._first(self.rows)

    @cached_property
    def entries(self) -> tuple[Entry, ...]:
        """The segments, without their samples; one pass over four narrow columns.

        Raises StoreError: the file is damaged.
        """
        found: list[Entry] = []
        start = 0
        columns = ["segment", "flight", "marks", "time_ns"]
        for batch in self._batches(columns, everything=True):
            for piece in _by_segment(batch):
                number = _number(piece)
                if found and found[-1].number == number:
                    found[-1] = replace(found[-1], rows=found[-1].rows + len(piece))
                else:
                    flight, marks, t0_ns = (piece.column(name)[0].as_py() for name in columns[1:])
                    found.append(Entry(number, start, len(piece), flight, json.loads(marks), t0_ns))
                start += len(piece)
        return tuple(e for e in found if self.only is None or e.number in self.only)

    def segment(self, number: int) -> Segment:
        """One segment by its number; only the row groups that hold it are read.

        Raises UsageError: there is no such segment. Raises StoreError: the file is damaged.
        """
        entry = next((e for e in self.entries if e.number == number), None)
        if entry is None:
            raise UsageError(f"no segment {number}", path=self.path, hint=f"{len(self.entries)} segments")
        return next(iter(self.subset([entry])))

    def group_by(self, mark: str) -> dict[str, DatasetFile]:
        """One view of the file per value of a mark, e.g. "vehicle", "mode", or "flight"; nothing is copied.

        Segments without the mark are under "".
        """
        groups: dict[str, list[Entry]] = {}
        for entry in self.entries:
            value = entry.flight if mark == "flight" else str(entry.marks.get(mark, ""))
            groups.setdefault(value, []).append(entry)
        return {value: self.subset(members) for value, members in groups.items()}

    def subset(self, entries: Sequence[Entry]) -> DatasetFile:
        """A view of the file with these segments only; nothing is copied."""
        view = replace(self, rows=sum(e.rows for e in entries), only=frozenset(e.number for e in entries))
        vars(view)["entries"] = tuple(entries)  # known already: the file need not be read for them again
        return view

    def read(self) -> Dataset:
        """The whole dataset in memory."""
        return self._in_memory(self)

    def head(self, rows: int) -> Dataset:
        """The first `rows` samples in memory, or all where there are fewer."""
        return self._in_memory(self._first(rows))

    def blocks(self) -> Iterator[tuple[int, FloatArray, FloatArray]]:
        """(segment number, (n, n_u), (n, n_y)): all samples in order, however long a segment is.

        Raises StoreError: the file is damaged. Raises DataError: a sample is not finite.
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

    def _batches(
        self, columns: list[str] | None = None, everything: bool = False
    ) -> Iterator[pa.RecordBatch]:
        """Batches in order: of the whole file, or without the segments that do not belong to this view."""
        try:
            with pq.ParquetFile(self.path, memory_map=False, pre_buffer=False) as file:
                start = 0
                for group in range(file.num_row_groups):
                    rows = file.metadata.row_group(group).num_rows
                    if everything or self._reaches(start, start + rows):
                        for batch in file.read_row_group(group, columns=columns).to_batches():
                            yield from [batch] if everything else self._kept(batch)
                    start += rows
        except (OSError, pa.ArrowException) as error:
            raise StoreError(f"damaged dataset: {error}", path=self.path) from error

    def _reaches(self, start: int, stop: int) -> bool:
        """Whether some segment of this view lies in these rows of the file."""
        return self.only is None or any(e.start < stop and start < e.start + e.rows for e in self.entries)

    def _kept(self, batch: pa.RecordBatch) -> Iterator[pa.RecordBatch]:
        if self.only is None:
            yield batch
            return
        yield from (piece for piece in _by_segment(batch) if _number(piece) in self.only)

    def _segment(self, parts: list[pa.RecordBatch]) -> Segment:
        table = pa.Table.from_batches(parts)
        n_u = len(self.inputs)
        first = len(tabular.FIXED)
        columns = [table.column(first + i).to_numpy() for i in range(n_u + len(self.outputs))]
        return Segment(
            u=np.stack(columns[:n_u], axis=1),
            y=np.stack(columns[n_u:], axis=1),
            t0_ns=table["time_ns"][0].as_py(),
            flight=table["flight"][0].as_py(),
            marks=json.loads(table["marks"][0].as_py()),
        )


def is_dataset(path: Path) -> bool:
    """Whether a file is a dataset, or may be one and is damaged; False for parquet files of other origin."""
    try:
        with path.open("rb") as file:
            if file.read(4) != b"PAR1":
                return False
        return tabular.META in (pq.read_schema(path).metadata or {})
    except (OSError, pa.ArrowException):
        return True


def open_dataset(path: str | Path) -> DatasetFile:
    """Open a dataset file; only its head is read.

    Raises StoreError: missing, not a dataset, damaged, or of a newer version.
    """
    path = Path(path)
    try:
        with pq.ParquetFile(path) as file:
            rows = file.metadata.num_rows
            document = json.loads((file.schema_arrow.metadata or {})[tabular.META])
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise StoreError(
                f"cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
            ) from error
        raise StoreError("not a dataset file of flysid", path=path, hint=HOW) from error
    if not isinstance(document, dict) or document.get("format") != tabular.FORMAT:
        raise StoreError("not a dataset file of flysid", path=path, hint=HOW)
    check_version(document.get("version"), tabular.VERSION, "dataset", path)
    try:
        inputs = _signals(document["inputs"])
        outputs = _signals(document["outputs"])
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
