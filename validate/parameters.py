"""How sure a model is of its numbers: 95 % intervals of gains, time constants and coefficients.

The models know; this asks each structure in its own words. They come from the training data and speak of
noise alone: what a structure cannot express is not in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.base import Fitted, HasIntervals
from flysid.model.linear.model import FittedLinear
from flysid.model.regressors import lagged_name

if TYPE_CHECKING:
    from flysid.model.rules.rule_uncertainty import Uncertainty
    from flysid.model.subspace.model import FittedStateSpace

Z95 = 1.959963984540054


@dataclass(frozen=True)
class Coefficient:
    """One number of one equation: rule, output, what it multiplies, value and half width of its interval."""

    rule: str
    output: str
    regressor: str
    value: float
    half_width: float


@dataclass(frozen=True, eq=False)
class Intervals:
    """Intervals of one model.

    Attributes
    ----------
    gain : (2, R, n_y, n_u) of every rule's steady gain; NaN where there is none.
    time_constant_s : (2, R), or None where it is not known.
    coefficients : every estimated coefficient.
    fuzzy : what all of this was drawn from, for a TS model.
    """

    gain: FloatArray
    time_constant_s: FloatArray | None
    coefficients: tuple[Coefficient, ...]
    fuzzy: Uncertainty[Any] | None = None


def intervals(model: Fitted, train: Dataset | None) -> Intervals | None:
    """What the model offers: linear ones by themselves, rules beside their training data."""
    from flysid.model.subspace.model import FittedStateSpace

    if isinstance(model, FittedLinear):
        return _linear(model)
    if isinstance(model, FittedStateSpace):
        return _state_space(model)
    if isinstance(model, HasIntervals) and train is not None:
        return _of_rules(model, train)
    return None


def _of_rules(model: Any, train: Dataset) -> Intervals | None:
    """Of a model of rules; None where the data cannot tell."""
    try:
        sure: Uncertainty[Any] = model.uncertainty(train)
        with np.errstate(all="ignore"):
            gain, slow = sure.gain_interval, sure.time_constant_interval_s
    except (FlysidError, np.linalg.LinAlgError):
        return None
    errors = sure.consequent_errors
    found = [
        Coefficient(f"R{r + 1}", output.name, name, float(value), float(Z95 * errors[r, i, m]))
        for r, rule in enumerate(model.consequents)
        for i, output in enumerate(model.outputs)
        for m, (name, value) in enumerate(zip(model.regressor_names, rule[i], strict=True))
    ]
    return Intervals(gain, slow, tuple(found), sure)


def _state_space(model: FittedStateSpace) -> Intervals | None:
    """Of a refined one; its matrices hang on the coordinates of the state, so no coefficient is listed."""
    from flysid.model.subspace.bands import frequency_response

    if not len(model.covariance):
        return None
    with np.errstate(all="ignore"):
        try:
            r = frequency_response(model, np.zeros(1))
        except np.linalg.LinAlgError:  # it integrates
            return None
    gain, error = r.response[0].real, Z95 * r.magnitude_error[0]
    return Intervals(np.stack([gain - error, gain + error])[:, None], None, ())


def _linear(model: FittedLinear) -> Intervals | None:
    if not model.free or not np.isfinite(model.covariance).all():
        return None
    return Intervals(_linear_gain(model), None, tuple(_linear_coefficients(model)))


def _linear_gain(model: FittedLinear) -> FloatArray:
    """(2, 1, n_y, n_u): the gain at frequency zero and its first-order error."""
    from flysid.model.linear.uncertainty import frequency_response

    if not np.isfinite(model.dc_gain).all():
        return np.full((2, 1, *model.dc_gain.shape), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):  # a gain of zero has no phase
        error = Z95 * frequency_response(model, np.zeros(1)).magnitude_error[0]
    return np.stack([model.dc_gain - error, model.dc_gain + error])[:, None]


def _linear_coefficients(model: FittedLinear) -> Sequence[Coefficient]:
    """Estimated entries of A and B, signed as in the equation y(k) = ...; offsets are around the means."""
    n_y, n_u = len(model.outputs), len(model.inputs)
    a_size, b_size = model.system.a[1:].size, model.system.b.size
    found = []
    for index in model.free:
        value, error = float(model.flat[index]), float(model.standard_errors[index])
        if index < a_size:
            lag, i, j = _place(index, (len(model.system.a) - 1, n_y, n_y))
            name, value = lagged_name(model.outputs[j].name, lag + 1), -value
        elif index < a_size + b_size:
            lag, i, j = _place(index - a_size, (len(model.system.b), n_y, n_u))
            name = lagged_name(model.inputs[j].name, lag)
        else:
            i, name = index - a_size - b_size, "1, around the means"
        found.append(Coefficient("", model.outputs[i].name, name, value, Z95 * error))
    return found


def _place(index: int, shape: tuple[int, int, int]) -> tuple[int, int, int]:
    lag, i, j = (int(v) for v in np.unravel_index(index, shape))
    return lag, i, j
