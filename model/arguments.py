"""What models are given: signals in columns, finite, as many as the model has; counts; what data lack."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError, UsageError
from flysid.showing import counted


def as_columns(values: FloatArray, count: int, name: str) -> FloatArray:
    """(N, count) float array. Raises UsageError: no numbers, another number of columns, or not finite."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} is not an array of numbers") from error
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[1] != count:
        raise UsageError(f"{name} must have {counted(count, 'column')}, not shape {np.shape(values)}")
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

    Raises UsageError: shapes do not fit, not finite, or k < 1.
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


def check_band(band: tuple[float, float] | None) -> None:
    """Raise UsageError where no frequency lies between both ends, in rad/s, or one is not above 0."""
    if band is not None and not 0.0 < band[0] < band[1]:
        low, high = band
        raise UsageError(f"no band: {low:g} to {high:g} rad/s", hint="the lowest frequency first, above 0")


def check_inputs(n_u: int) -> None:
    """Raise UsageError where there is no input."""
    if n_u == 0:
        raise UsageError("the dataset has no input", hint="name an input in the recipe")


def check_start(given: int, wanted: int) -> None:
    """Raise UsageError where fewer measured outputs are given than a simulation starts from."""
    if given < wanted:
        raise UsageError(f"a simulation starts from {counted(wanted, 'measured output')}, not {given}")


def check_rows(data: Dataset, depth: int, numbers: int) -> None:
    """Raise DataError where segments hold no more rows behind their first `depth` than there are unknowns."""
    lengths = [len(segment) for segment in data.segments]
    rows = sum(max(length - depth, 0) for length in lengths)
    if rows == 0 and depth > numbers:  # delays, not coefficients, ask for that many samples
        raise none_longer(depth, max(lengths, default=0))
    if rows <= numbers:
        raise DataError(
            f"{sum(lengths):,} samples are too few for {counted(numbers, 'coefficient')} per output",
            hint="record longer, or ask for lower orders",
        )


def no_samples() -> DataError:
    """There is nothing to learn from."""
    return DataError("there are no samples to learn from", hint="check the recipe and the splits")


def never_changes(kind: str, name: str) -> DataError:
    """An input or output is constant."""
    return DataError(
        f"{kind} {name!r} never changes: nothing can be learnt from it",
        hint="choose segments in which it moves, or leave it out of the recipe",
    )


def none_longer(depth: int, longest: int | None = None) -> DataError:
    """No segment is longer than the samples that a model looks back on; `longest` where it is known."""
    known = "" if longest is None else f"; the longest has {longest:,}"
    return DataError(
        f"no segment is longer than the {counted(depth, 'sample')} that the model looks back on{known}",
        hint="choose smaller orders, delays or a shorter past, or bring longer segments",
    )
