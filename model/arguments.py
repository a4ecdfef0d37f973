"""What the methods of models take: signals in columns, finite, as many as the model has."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError


def as_columns(values: FloatArray, count: int, name: str) -> FloatArray:
    """(N, count) float array.

    Raises
    ------
    UsageError : another number of columns, or not finite.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[1] != count:
        raise UsageError(f"{name} must have {count} column(s), not shape {np.shape(values)}")
    if not np.isfinite(array).all():
        raise UsageError(f"{name} holds values that are not finite", hint="cut the gap out first")
    return array
