"""Bytes at many places of one buffer, copied together without a loop over the places.

The one trick: a view of the buffer whose elements are `size` bytes long and start at every byte (stride 1)
turns "copy n records that lie anywhere" into a single fancy index, one memcpy a record.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Index = NDArray[np.int64]
Values = NDArray[Any]


def as_bytes(buffer: Any) -> Bytes:
    """A buffer as an array of bytes; nothing is copied."""
    return np.frombuffer(buffer, dtype=np.uint8)


def rows(data: Bytes, at: Index, size: int) -> Values:
    """Copies of data[p : p + size] for every p in `at`, as an (n,) array of `size`-byte voids.

    Every p must satisfy 0 <= p <= len(data) - size; `size` > 0.
    """
    if len(at) == 0:
        return np.empty(0, dtype=f"V{size}")
    places = np.ndarray((len(data) - size + 1,), dtype=f"V{size}", buffer=data, strides=(1,))
    return places[at]


def numbers(data: Bytes, at: Index, dtype: str) -> Values:
    """The number of type `dtype` at every place in `at`."""
    kind = np.dtype(dtype)
    return rows(data, at, kind.itemsize).view(kind)


def runs(data: Bytes, at: Index, size: Index, *, long_run_bytes: int = 48) -> Bytes:
    """data[p : p + s] for every (p, s), one after the other, as a 1-D array of bytes.

    `long_run_bytes`: above this mean length a Python slice per run beats an index per byte.
    """
    total = int(size.sum())
    if total == 0:
        return np.empty(0, dtype=np.uint8)
    longest = int(size.max())
    if longest == int(size.min()):
        return rows(data, at, longest).view(np.uint8)
    if total >= long_run_bytes * len(at):
        window = data.data
        parts = [window[p : p + s] for p, s in zip(at.tolist(), size.tolist(), strict=True)]
        return as_bytes(b"".join(parts))
    return data[spread(at, size)]


def spread(at: Index, size: Index) -> Index:
    """The indices p, p + 1, ... p + s - 1 for every (p, s), one after the other."""
    ends = np.cumsum(size)
    steps: Index = np.arange(int(ends[-1]) if len(ends) else 0, dtype=np.int64)
    steps += np.repeat(at - (ends - size), size)
    return steps
