"""Compiled linear filters: `scipy.signal.lfilter` without its checks.

SciPy's is not taken: importing `scipy.signal` costs every command more than a second.

Polynomials stand in rising powers of q⁻¹; the denominator is monic.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from flysid.dataset import FloatArray

NOTHING = np.zeros(0)


def filtered(b: FloatArray, a: FloatArray, x: FloatArray, state: FloatArray = NOTHING) -> FloatArray:
    """(N,) x, or each of (N, columns), through B / A.

    Parameters
    ----------
    state : (L,) of the transposed direct form before the first sample, as `lfilter` takes it, the same for
        every column; zero when empty.
    """
    if x.ndim > 1:
        return np.stack([filtered(b, a, column, state) for column in x.T], axis=1) if x.shape[1] else x
    y: FloatArray = _filtered(own(b), own(a), own(x), own(state))
    return y


def own(x: FloatArray) -> FloatArray:
    """One row that may be written to, as nearly all are: compiled code is made for one kind of array only."""
    return x if x.flags.c_contiguous and x.flags.writeable else x.copy()


@njit(cache=True, error_model="numpy")
def _filtered(b: FloatArray, a: FloatArray, x: FloatArray, start: FloatArray) -> FloatArray:
    order = max(a.size, b.size) - 1
    state = np.zeros(order + 1)
    for i in range(min(order, start.size)):
        state[i] = start[i]
    y = np.empty(x.size)
    for k in range(x.size):
        value = b[0] * x[k] + state[0]
        for i in range(order):
            kept = state[i + 1]
            if i + 1 < b.size:
                kept += b[i + 1] * x[k]
            if i + 1 < a.size:
                kept -= a[i + 1] * value
            state[i] = kept
        y[k] = value
    return y
