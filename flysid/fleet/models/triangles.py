"""A flight's contribution to a channel: the triangle of its lagged samples, and its spectra.

The triangle R is that of [1 Phi Y], RᵀR = [1 Phi Y]ᵀ[1 Phi Y], with the constant first: R[1:, 1:] is then the
triangle of the same columns less their means, so that wind and trim, which are constant in a flight and
differ between flights, are removed by leaving out one row and one column. Triangles of many flights stack
into that of all of them (TSQR; Demmel et al., 2012), which a sum of Gram matrices does too, but at the
square of the condition.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray, Segment
from flysid.fleet.models.band import ComplexArray, spectra_of
from flysid.fleet.models.common_grid import Sampling
from flysid.model.gram import tsqr


@dataclass(frozen=True, eq=False)
class Triangle:
    """A flight's part of a channel.

    `r`: (c, c) upper triangular, of the constant, the inputs at lags 0..L, the outputs at lags 1..L, and the
        outputs; zero where no segment is longer than L.
    `rows`: samples behind it.
    `spectra`: (F, s, s) cross-spectra of inputs and outputs, summed over windows.
    `windows`: how many.
    """

    r: FloatArray
    rows: int
    spectra: ComplexArray
    windows: int


def triangle_of(segments: Sequence[Segment], sampling: Sampling, *, chunk_rows: int = 8192) -> Triangle:
    """The triangle and the spectra of a flight's segments, which lie on the sampling's grid."""
    long = [s for s in segments if len(s) > sampling.lags]
    blocks = [
        block[start : start + chunk_rows]
        for block in (_rows(s.u, s.y, sampling.lags) for s in long)
        for start in range(0, len(block), chunk_rows)
    ]
    width = sampling.columns
    spectra, windows = spectra_of(segments, sampling.window)
    return Triangle(tsqr(blocks, width), sum(map(len, blocks)), spectra, windows)


def _rows(u: FloatArray, y: FloatArray, lags: int) -> FloatArray:
    """(N - lags, c) rows: 1, inputs at lags 0..L, outputs at lags 1..L, outputs."""
    n = len(u)
    back = [x[lags - lag : n - lag] for x in u.T for lag in range(lags + 1)]
    back += [x[lags - lag : n - lag] for x in y.T for lag in range(1, lags + 1)]
    return np.column_stack([np.ones(n - lags), *back, y[lags:]])
