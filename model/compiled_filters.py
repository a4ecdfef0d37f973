"""Compiled: differences and responses, which a linear search asks for thousands of times.

Polynomials stand in rising powers of q⁻¹.
"""

from __future__ import annotations

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.filters import own

GONE = 4e-18
"""Of the largest of several: below the rounding of any sum that it is part of."""

compiled = njit(cache=True, error_model="numpy")


def differences(signal: FloatArray, count: int, lag: int, rows: slice, *, monic: bool) -> FloatArray:
    """Columns (1 - q⁻¹)^p q⁻ⁱ of a signal that was zero before its start.

    With `monic`, i = 1..count and p = count - i (the coordinates alpha); else i = lag..lag + count - 1 and
    p = count - 1 - (i - lag) (the coordinates beta).
    """
    first = 1 if monic else lag
    columns: FloatArray = _differences(own(signal), count, first, rows.start, rows.stop).T
    return columns


def free_responses(a: FloatArray, rows: int) -> FloatArray:
    """(M, na) responses of 1/A to states at the start, each of length one; M <= rows: then decayed."""
    n = len(a) - 1
    h = _impulse_response(own(a), rows + n)
    columns: FloatArray = _differences(h, n, 0, n - 1, len(h) - 1).T
    size = np.sqrt((columns * columns).sum(axis=0))
    return columns / np.where(size > 0.0, size, 1.0)


def lengths(columns: FloatArray) -> FloatArray:
    """(k,) of columns (N, k); 1 where there is nothing."""
    found = np.sqrt(squares(columns))
    return np.where(found > 0, found, 1.0)


def is_stable(a: FloatArray, radius: float = 1.0) -> bool:
    """Whether every root of A lies inside a circle, by reflection coefficients (Schur and Cohn)."""
    return bool(_is_stable(a / radius ** np.arange(len(a))))


@compiled
def squares(columns: FloatArray) -> FloatArray:
    """(k,) sums of squares of columns (N, k), row by row, however they lie in memory."""
    total = np.zeros(columns.shape[1])
    for k in range(columns.shape[0]):
        for i in range(columns.shape[1]):
            total[i] += columns[k, i] * columns[k, i]
    return total


@compiled
def _differences(signal: FloatArray, count: int, lag: int, first: int, stop: int) -> FloatArray:
    columns = np.empty((count, stop - first))
    work = signal.copy()
    for power in range(count):
        column = count - 1 - power
        shift = lag + column
        for k in range(first, stop):
            columns[column, k - first] = work[k - shift] if k >= shift else 0.0
        for k in range(work.size - 1, 0, -1):
            work[k] -= work[k - 1]
    return columns


@compiled
def _impulse_response(a: FloatArray, rows: int) -> FloatArray:
    """(M,) of 1/A; M <= rows: then decayed."""
    n = a.size - 1
    h = np.zeros(rows)
    peak = 0.0
    quiet = 0
    length = 0
    while length < rows and quiet < 8 * n + 8:
        value = 1.0 if length == 0 else 0.0
        for i in range(1, min(n, length) + 1):
            value -= a[i] * h[length - i]
        h[length] = value
        peak = max(peak, abs(value))
        quiet = quiet + 1 if abs(value) < GONE * peak else 0
        length += 1
    return h[:length]


@compiled
def _is_stable(a: FloatArray) -> bool:
    work = a.copy()
    lower = np.empty(a.size)
    for size in range(a.size - 1, 0, -1):
        k = work[size]
        if not abs(k) < 1.0:  # nor a number
            return False
        for i in range(size):
            lower[i] = (work[i] - k * work[size - i]) / (1.0 - k * k)
        for i in range(size):
            work[i] = lower[i]
    return True
