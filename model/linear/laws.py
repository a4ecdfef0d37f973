"""What every linear model does alike, however it is parametrised."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.arguments import as_record
from flysid.model.base import Rule
from flysid.model.capabilities import LinearModel
from flysid.model.freerun import saturate


def predict_ahead(
    model: LinearModel,
    u: FloatArray,
    y: FloatArray,
    k: int,
    ahead: Callable[[FloatArray, FloatArray, int], FloatArray],
) -> FloatArray:
    """(N, n_y) what `ahead(u, y, k)` predicts k steps ahead; NaN in the first n_init + k - 1 rows.

    `ahead` is asked only where there is a row to predict, with u and y in columns.

    Raises
    ------
    UsageError : shapes do not fit the model, or k < 1.
    """
    u, y = as_record(model, u, y, k)
    first = model.n_init + k - 1
    out = np.full(y.shape, np.nan)
    if len(y) > first:
        found = ahead(u, y, k)[first:]
        is_finite = np.isfinite(found)
        if not is_finite.all():  # a forged model, or one far outside its data
            found = np.where(is_finite, found, saturate(found, model.output_limits))
        out[first:] = found
    return out


def always(model: LinearModel, conclusion: str) -> tuple[Rule, ...]:
    """The model as the one rule that always holds."""
    radius = float(np.abs(model.poles).max(initial=0.0))
    slow = -model.dt_s / np.log(radius) if 0 < radius < 1 else (0.0 if radius == 0 else np.inf)
    return (Rule("R1", "always", conclusion, model.dc_gain, float(slow), radius, 1.0),)


def is_stable(model: LinearModel) -> bool:
    """Every pole lies inside the unit circle."""
    return bool(np.abs(model.poles).max(initial=0.0) < 1.0)
