"""Fields over time at any zoom: the extremes of every pixel, from blocks of blocks.

A field of a stream is read once, row group by row group, into files that are mapped, not held: the times, the
values, and above them the lowest and the highest value of every 64 samples, of every 64 of those, and so on.
A view then touches a few thousand numbers whatever the flight's length. The files are a cache of this
process and vanish with it.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from flysid.dataset import FloatArray
from flysid.files import unread_table
from flysid.flight import BOOT, TIME, field_scale
from flysid.flightwriter import int_values
from flysid.ingest.align.resample import GAP_PERIODS
from flysid.ingest.lake.timeline import numbers_of
from flysid.manifest import StreamEntry
from flysid.store import entry_path, read_entry

BLOCK = (
    64  # samples under one pair of extremes: a view looks at fewer than this many at either end of a pixel
)
PERIODS_LOOKED_AT = 100_000
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """The times of a stream.

    `time_s`: (N,) seconds since the flight's start, boots one after the other.
    `cuts`: (C,) rows that begin a boot or follow a pause.
    """

    time_s: FloatArray
    cuts: IntArray


@dataclass(frozen=True, eq=False)
class Pyramid:
    """The values of a field: `levels[0]` is (N,), `levels[k]` (M, 2) the extremes of 64^k samples each."""

    levels: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class View:
    """What a window shows of a field: the samples themselves, or the extremes of every pixel.

    `time_s`, `values`: (P,) points of a line in order of time; a NaN breaks it.
    `whole`: these are the samples as recorded.
    """

    time_s: FloatArray
    values: FloatArray
    whole: bool


def read_axis(folder: Path, entry: StreamEntry, offsets_s: Mapping[int, float], place: Path) -> TimeAxis:
    """Map the times of a stream.

    `folder`: the flight's.
    `offsets_s`: boot -> seconds to add to the vehicle's time.
    `place`: folder for the mapped file, which goes when the array does.
    Raises StoreError: the table is damaged or missing.
    """
    path = _new_file(place)
    boots_begin: list[int] = []
    row = 0
    before: int | None = None
    with path.open("wb") as file:
        for table in _parts(folder, entry, [TIME, BOOT]):
            boots = int_values(table[BOOT])
            time_s = int_values(table[TIME]) * 1e-9
            changes = np.flatnonzero(np.diff(boots, prepend=boots[0] if before is None else before))
            for start, stop in pairwise([0, *changes, len(boots)]):
                if start < stop:
                    time_s[start:stop] += offsets_s.get(int(boots[start]), 0.0)
            time_s.tofile(file)
            boots_begin += (changes + row).tolist()
            before = int(boots[-1])
            row += len(boots)
    time_s = _map(path)
    return TimeAxis(time_s, np.union1d(_pauses(path, time_s), np.asarray(boots_begin, dtype=np.int64)))


def hold(boots: Sequence[tuple[FloatArray, FloatArray]], place: Path) -> tuple[TimeAxis, Pyramid]:
    """Map samples that are in memory: (times in seconds, values) of each boot, in order."""
    paths = [_new_file(place), _new_file(place)]
    for path, column in zip(paths, (0, 1), strict=True):
        with path.open("wb") as file:
            for boot in boots:
                np.ascontiguousarray(boot[column], dtype=np.float64).tofile(file)
    begins = np.cumsum([len(boot[0]) for boot in boots])[:-1]
    time_s = _map(paths[0])
    axis = TimeAxis(time_s, np.union1d(_pauses(paths[0], time_s), begins.astype(np.int64)))
    return axis, _pyramid_of(paths[1])


def read_pyramid(folder: Path, entry: StreamEntry, field: str, place: Path) -> Pyramid:
    """Map the values of a field, scaled to its unit; `field` may name an element of an array, as `q[2]`.

    Raises StoreError: the table is damaged or missing.
    """
    column = field.partition("[")[0]
    path = _new_file(place)
    with path.open("wb") as file:
        for table in _parts(folder, entry, [column]):
            scale = field_scale(table.schema.field(column))
            for chunk in table[column].chunks:
                numbers = numbers_of(chunk, field)
                (numbers if scale == 1.0 else numbers * scale).tofile(file)
    return _pyramid_of(path)


def _pyramid_of(path: Path) -> Pyramid:
    levels: list[FloatArray] = [_map(path)]
    if len(levels[0]) > BLOCK:
        levels.append(np.concatenate([extremes_of_blocks(part) for part in _read_in_parts(path)]))
    while len(levels[-1]) > BLOCK:
        levels.append(extremes_of_blocks(levels[-1]))
    return Pyramid(tuple(levels))


def look(axis: TimeAxis, pyramid: Pyramid, start_s: float, end_s: float, pixels: int) -> View:
    """What a window of some pixels shows of a field.

    The samples themselves, and one on either side, where there are at most two a pixel; else the lowest and
    the highest of every pixel, of those samples whose time lies in it.
    """
    try:
        return _looked_at(axis, pyramid, (start_s, end_s), pixels)
    finally:
        _release(axis.time_s)
        _release(pyramid.levels[0])


def _looked_at(axis: TimeAxis, pyramid: Pyramid, window_s: tuple[float, float], pixels: int) -> View:
    start_s, end_s = window_s
    first = int(np.searchsorted(axis.time_s, start_s, "left"))
    last = int(np.searchsorted(axis.time_s, end_s, "right"))
    if last - first <= 2 * pixels:
        return _samples(axis, pyramid, max(0, first - 1), min(len(axis.time_s), last + 1))
    edges_s = np.linspace(start_s, end_s, pixels + 1)
    edges = np.searchsorted(axis.time_s, edges_s[1:-1], "left")
    edges = np.concatenate([[first], edges, [last]]).astype(np.int64)
    lows, highs = extremes_between(pyramid, edges[:-1], edges[1:])
    is_empty = edges[1:] == edges[:-1]
    shown = ~is_empty | np.isin(edges[:-1], axis.cuts)  # an empty pixel breaks the line in a pause only
    inside_s = (edges_s[1] - edges_s[0]) * np.array([0.25, 0.75])
    time_s = edges_s[:-1][shown, None] + inside_s
    return View(np.ravel(time_s), np.ravel(np.column_stack([lows, highs])[shown]), whole=False)


def extremes_between(pyramid: Pyramid, starts: IntArray, stops: IntArray) -> tuple[FloatArray, FloatArray]:
    """The lowest and the highest value of each half-open range of samples; NaN where it holds no number."""
    lows = np.full(len(starts), np.nan)
    highs = np.full(len(starts), np.nan)
    left = starts.copy()
    right = stops.copy()
    for level, values in enumerate(pyramid.levels):
        is_top = level == len(pyramid.levels) - 1
        inner_left = right if is_top else np.minimum(-(-left // BLOCK) * BLOCK, right)
        inner_right = right if is_top else np.maximum(right // BLOCK * BLOCK, inner_left)
        for begin, end in ((left, inner_left), (inner_right, right)):
            low, high = _gather(values, begin, end)
            lows = np.fmin(lows, low)
            highs = np.fmax(highs, high)
        left = inner_left // BLOCK
        right = inner_right // BLOCK
    return lows, highs


def _gather(values: FloatArray, starts: IntArray, stops: IntArray) -> tuple[FloatArray, FloatArray]:
    """Extremes of short ranges of one level, side by side."""
    width = int((stops - starts).max(initial=0))
    if width <= 0:
        nothing = np.full(len(starts), np.nan)
        return nothing, nothing
    rows = starts[:, None] + np.arange(width)
    inside = rows < stops[:, None]
    found = values[np.where(inside, rows, 0)]
    found = np.where(inside if found.ndim == 2 else inside[..., None], found, np.nan)
    if found.ndim == 2:
        return np.fmin.reduce(found, axis=1), np.fmax.reduce(found, axis=1)
    return np.fmin.reduce(found[..., 0], axis=1), np.fmax.reduce(found[..., 1], axis=1)


def _samples(axis: TimeAxis, pyramid: Pyramid, first: int, last: int) -> View:
    """Samples as they are, with a NaN inside every pause."""
    time_s = np.asarray(axis.time_s[first:last])
    values = np.asarray(pyramid.levels[0][first:last])
    cuts = axis.cuts[(axis.cuts > first) & (axis.cuts < last)] - first
    middles = (time_s[cuts - 1] + time_s[cuts]) / 2.0
    return View(np.insert(time_s, cuts, middles), np.insert(values, cuts, np.nan), whole=True)


def _pauses(path: Path, time_s: FloatArray) -> IntArray:
    """Rows that follow a pause: a step of more than some periods, the period being the usual step."""
    if len(time_s) < 3:
        return np.zeros(0, dtype=np.int64)
    some = np.arange(0, len(time_s) - 1, max(1, len(time_s) // PERIODS_LOOKED_AT))
    longest_s = 2.0 * GAP_PERIODS * float(np.median(time_s[some + 1] - time_s[some]))
    found = [np.zeros(0, dtype=np.int64)]
    row = 0
    before = float(time_s[0])
    for part in _read_in_parts(path):
        found.append(np.flatnonzero(np.diff(part, prepend=before) > longest_s) + row)
        before = float(part[-1])
        row += len(part)
    return np.concatenate(found)


def extremes_of_blocks(values: FloatArray) -> FloatArray:
    """(M, 2) the extremes of every 64 values (N,), or of every 64 pairs of extremes (N, 2)."""
    pairs = values if values.ndim == 2 else np.broadcast_to(values[:, None], (len(values), 2))
    begins = np.arange(0, len(values), BLOCK)
    lows = np.fmin.reduceat(pairs[:, 0], begins)
    return np.column_stack([lows, np.fmax.reduceat(pairs[:, 1], begins)])


def _parts(folder: Path, entry: StreamEntry, columns: list[str]) -> Iterator[pa.Table]:
    """A stream's table in order of time, in parts where it is stored so."""
    if not entry.is_sorted:
        yield read_entry(folder, entry, list(dict.fromkeys([TIME, BOOT, *columns])))
        return
    path = entry_path(folder, entry)
    try:
        file = pq.ParquetFile(path)
        for group in range(file.num_row_groups):
            table = file.read_row_group(group, columns=columns)
            if table.num_rows:
                yield table
    except (OSError, pa.ArrowException) as error:
        raise unread_table(error, path, "ingest the log again") from error


def _new_file(place: Path) -> Path:
    handle, name = tempfile.mkstemp(dir=place)
    os.close(handle)
    return Path(name)


def _map(path: Path) -> FloatArray:
    """The numbers of a file as an array that the system reads when it is touched; the file goes with it."""
    if not path.stat().st_size:  # cannot be mapped
        path.unlink()
        return np.zeros(0)
    mapped = np.memmap(path, dtype=np.float64, mode="r")
    weakref.finalize(mapped, path.unlink, missing_ok=True)
    return mapped


def _release(mapped: FloatArray) -> None:
    """Take the touched pages of a mapped file off this process: the system keeps them where it has room."""
    pages = mapped.base
    if isinstance(pages, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        pages.madvise(mmap.MADV_DONTNEED)


def _read_in_parts(path: Path) -> Iterator[FloatArray]:
    """The numbers of a file, some whole blocks at a time: read, not mapped, so that they do not stay."""
    with path.open("rb") as file:
        while len(part := np.fromfile(file, dtype=np.float64, count=BLOCK << 14)):
            yield part
