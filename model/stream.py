"""Data as a stream of blocks: what a fit in bounded memory reads, from memory or from disk.

A block is (segment number, (s, n) samples): outputs, then inputs, signals in rows, as deviations from an
origin. Blocks of one segment follow each other without a gap; a new number is a new segment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
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

    Parameters
    ----------
    origin : (n_y + n_u,) what the samples are deviations from; zero when None.
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
    number, held = -1, np.zeros((0, 0))
    for current, block in blocks:
        if current != number:
            number, held = current, block[:, :0]
        held = np.concatenate([held, block], axis=1) if held.shape[1] else block
        if held.shape[1] > depth:
            yield number, held
            held = held[:, held.shape[1] - depth :]
