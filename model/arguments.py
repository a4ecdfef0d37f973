"""What the methods of models take: signals in columns, finite, as many as the model has; and counts."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError


def as_columns(values: FloatArray, count: int, name: str) -> FloatArray:
    """(N, count) float array.

    Raises
    ------
    UsageError : no numbers, another number of columns, or not finite.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} is not an array of numbers") from error
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[1] != count:
        raise UsageError(f"{name} must have {count} column(s), not shape {np.shape(values)}")
    if not np.isfinite(array).all():
        raise UsageError(f"{name} holds values that are not finite", hint="cut the gap out first")
    return array


class _SignalCounts(Protocol):
    """What a model says of its signals."""

    @property
    def inputs(self) -> tuple[Signal, ...]: ...
    @property
    def outputs(self) -> tuple[Signal, ...]: ...


def as_record(
    model: _SignalCounts, u: FloatArray, y: FloatArray, k: int = 1
) -> tuple[FloatArray, FloatArray]:
    """u (N, n_u) and y (N, n_y) that a model predicts k steps ahead on.

    Raises
    ------
    UsageError : shapes do not fit, not finite, or k < 1.
    """
    if not k >= 1:
        raise UsageError(f"a prediction looks at least one step ahead, not {k}")
    u = as_columns(u, len(model.inputs), "u")
    y = as_columns(y, len(model.outputs), "y")
    if len(u) != len(y):
        raise UsageError(f"u has {len(u)} samples and y has {len(y)}")
    return u, y


def is_count(value: object, least: int) -> bool:
    """A whole number from `least` on, of Python or of NumPy."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and int(value) >= least
