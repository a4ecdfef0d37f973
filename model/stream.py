"""Data as a stream of blocks: what a fit in bounded memory reads, from memory or from disk.

A block is (segment number, (s, n) samples): outputs, then inputs, signals in rows, as deviations from an
origin. Blocks of one segment follow each other without a gap; a new number is a new segment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError
from flysid.model.regressors import CHUNK_ROWS

Block: TypeAlias = tuple[int, FloatArray]
Blocks: TypeAlias = Callable[[], Iterable[Block]]
"""Called for every pass over the data."""


@runtime_checkable
class OnDisk(Protocol):
    """A dataset that is read block by block: `flysid.datasetfile.DatasetFile`."""

    @property
    def dt_s(self) -> float: ...
    @property
    def inputs(self) -> tuple[Signal, ...]: ...
    @property
    def outputs(self) -> tuple[Signal, ...]: ...
    def __len__(self) -> int: ...
    def blocks(self) -> Iterator[tuple[int, FloatArray, FloatArray]]: ...
    def head(self, rows: int) -> Dataset: ...


Source: TypeAlias = Dataset | OnDisk


def blocks_of(data: Source, origin: FloatArray | None = None) -> Blocks:
    """All samples of a dataset, in pieces that fit a cache.

    `origin`: (n_y + n_u,) what the samples are deviations from; zero when None.
    """

    def read() -> Iterator[Block]:
        for number, u, y in _parts_of(data):
            for start in range(0, len(y), CHUNK_ROWS):
                stop = start + CHUNK_ROWS
                yield number, signals_in_rows(u[start:stop], y[start:stop], origin)

    return read


def _parts_of(data: Source) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    if isinstance(data, Dataset):
        return ((number, s.u, s.y) for number, s in enumerate(data.segments))
    return data.blocks()


@dataclass(frozen=True)
class Late:
    """A dataset on disk whose inputs enter late, in samples; rows before they enter are left out."""

    source: OnDisk
    late: tuple[int, ...]

    @property
    def dt_s(self) -> float:
        """Sample time."""
        return self.source.dt_s

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Of the source."""
        return self.source.inputs

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Of the source."""
        return self.source.outputs

    def __len__(self) -> int:
        """Samples of the source."""
        return len(self.source)

    def blocks(self) -> Iterator[tuple[int, FloatArray, FloatArray]]:
        """(segment, u, y) with every input as it enters; what the first rows of a segment lack is cut off."""
        most = max(self.late)
        current = -1
        held = np.zeros((0, len(self.late)))
        for number, u, y in self.source.blocks():
            if number != current:
                current = number
                held = u[:0]
            both = np.concatenate([held, u])
            if len(both) > most:
                yield number, entering(both, self.late), y[most - len(held) :]
            held = both[max(len(both) - most, 0) :]

    def head(self, rows: int) -> Dataset:
        """About the first rows, inputs as they enter."""
        return delayed_inputs(self.source.head(rows + max(self.late)), self.late)


def entering(u: FloatArray, late: Sequence[int]) -> FloatArray:
    """(N - max(late), n_u) the inputs as they enter."""
    most = max(late)
    return np.stack([u[most - k : len(u) - k, j] for j, k in enumerate(late)], axis=1)


def delayed_inputs(data: Dataset, late: Sequence[int]) -> Dataset:
    """The dataset with its inputs as they enter, the rows before the first of them left out.

    Raises DataError: no segment is longer than the delay.
    """
    most = max(late)
    if most == 0:
        return data
    kept = [s for s in data.segments if len(s) > most]
    if not kept:
        raise DataError(
            f"no segment is longer than the delay of {most} samples", hint="bring longer segments"
        )
    return data.with_segments(
        [replace(s.slice(most, len(s), data.dt_s), u=entering(s.u, late)) for s in kept]
    )


def signals_in_rows(u: FloatArray, y: FloatArray, origin: FloatArray | None = None) -> FloatArray:
    """(n_y + n_u, n) outputs, then inputs, as deviations."""
    n_y = y.shape[1]
    block = np.empty((n_y + u.shape[1], len(y)))
    block[:n_y] = y.T
    block[n_y:] = u.T
    if origin is not None:
        block -= origin[:, None]
    return block


def windows(blocks: Iterable[Block], depth: int) -> Iterator[Block]:
    """(segment number, (s, depth + n)): every block behind the `depth` samples before it, n >= 1.

    Nothing crosses a segment's edge; segments of at most `depth` samples give nothing.
    """
    number = -1
    held = np.zeros((0, 0))
    for current, block in blocks:
        if current != number:
            number = current
            held = block[:, :0]
        held = np.concatenate([held, block], axis=1) if held.shape[1] else block
        if held.shape[1] > depth:
            yield number, held
            held = held[:, held.shape[1] - depth :]
