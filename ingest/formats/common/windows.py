"""Where records could begin in a stretch that is out of step: every place at once, compared as arrays.

Readers look at each place that is left as closely as at any record. Asked at every byte, Python takes half a
second a megabyte; arrays take a hundredth of that.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

FIRST = 1 << 12  # most damage is short
MOST = 1 << 18  # stays in the processor's cache
Words = npt.NDArray[np.uint32]
Places = npt.NDArray[np.int64]


def windows(start: int, stop: int) -> Iterator[tuple[int, int]]:
    """The places [start, stop) in stretches that grow."""
    size = FIRST
    while start < stop:
        end = min(start + size, stop)
        yield start, end
        start = end
        size = min(2 * size, MOST)


def words_at(view: memoryview, start: int, stop: int, order: str) -> Words:
    """(stop - start,) the four bytes from each place on, as a number of this byte order ("<" or ">").

    `stop` + 3 bytes must be there.
    """
    out = np.empty(stop - start, dtype=np.uint32)
    for first in range(min(4, stop - start)):
        part = out[first::4]
        part[:] = np.frombuffer(view, order + "u4", len(part), start + first)
    return out


def words_from(view: memoryview, places: Places, order: str) -> Words:
    """(n,) as `words_at`, at places in any order; 0 where less than four bytes are left."""
    raw = np.frombuffer(view, dtype=np.uint8)
    is_there = places <= len(raw) - 4
    at = np.where(is_there, places, 0) if len(raw) >= 4 else np.zeros(0, dtype=np.int64)
    found = sum(raw[at + k].astype(np.uint32) << (8 * (k if order == "<" else 3 - k)) for k in range(4))
    return np.where(is_there, found, 0).astype(np.uint32)
