"""Compiled loops of filters over samples, with coefficients that may change on the way."""

from __future__ import annotations

from typing import Any

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray


def run_section(rows: FloatArray, x: FloatArray) -> FloatArray:
    """(N,) x through a section, see `flysid.spectra.stages`; `rows` is (1, 5) or (N, 5)."""
    y: FloatArray = _run(rows, x)
    return y


@njit(cache=True, error_model="numpy")
def _run(rows: FloatArray, x: FloatArray) -> FloatArray:
    y = np.empty(x.size)
    if x.size == 0:
        return y
    b0, b1, b2, a1, a2 = rows[0]
    x1 = x2 = x[0]
    y1 = y2 = x[0] * (b0 + b1 + b2) / (1.0 + a1 + a2)
    fixed = rows.shape[0] == 1
    for n in range(x.size):
        k = 0 if fixed else n
        now = rows[k, 0] * x[n] + rows[k, 1] * x1 + rows[k, 2] * x2 - rows[k, 3] * y1 - rows[k, 4] * y2
        x2 = x1
        x1 = x[n]
        y2 = y1
        y1 = now
        y[n] = now
    return y


@njit(cache=True)
def filter_sample(x: Any, rows: Any, states: Any) -> Any:
    """One value through sections (S, 5) one behind the other, whose `states` (S, 2) go on."""
    for j in range(rows.shape[0]):
        b0, b1, b2, a1, a2 = rows[j]
        out = b0 * x + states[j, 0]
        states[j, 0] = b1 * x - a1 * out + states[j, 1]
        states[j, 1] = b2 * x - a2 * out
        x = out
    return x
