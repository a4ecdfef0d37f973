"""A fitted model at another rate than the one that it was fitted at."""

from __future__ import annotations

import numpy as np

from flysid.errors import UsageError
from flysid.model.base import Fitted
from flysid.model.capabilities import HasOtherRates


def resample(model: Fitted, rate_hz: float) -> Fitted:
    """The model at `rate_hz` steps a second, its inputs constant between samples.

    Raises UsageError: a model that has one rate only, one that drifts by itself, or no possible rate.
    """
    if not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise UsageError(f"a rate of {rate_hz!r} Hz", hint="steps a second, above 0")
    if abs(rate_hz * model.dt_s - 1.0) < 1e-9:
        return model
    if not isinstance(model, HasOtherRates):
        raise UsageError(
            f"a model of structure {model.structure!r} runs at {1.0 / model.dt_s:g} Hz only",
            hint="fit a transfer function in s ('flysid fit -m tf'), or leave out --rate",
        )
    return model.at_rate(rate_hz)
