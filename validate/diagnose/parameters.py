"""How sure a model is of its numbers: 95 % intervals of gains, time constants and coefficients.

The models know; this asks for what they offer. They come from the training data and speak of
noise alone: what a structure cannot express is not in them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.base import Fitted
from flysid.model.capabilities import (
    Coefficient,
    HasCoefficients,
    HasIntervals,
    HasOperatingPoints,
    LinearModel,
)
from flysid.model.polynomials import Z95

if TYPE_CHECKING:
    from flysid.model.rules.rule_uncertainty import Uncertainty


@dataclass(frozen=True, eq=False)
class Intervals:
    """Intervals of one model.

    Attributes
    ----------
    gain : (2, R, n_y, n_u) of the steady gain; of a model of several rules, of what it does where each rule
        is the strongest at rest. NaN where there is none.
    reached_s : (2, R, n_y, n_u) of the time to 63 % of a change there, or None where it is not known.
    coefficients : every estimated coefficient.
    fuzzy : what all of this was drawn from, for a TS model.
    """

    gain: FloatArray
    reached_s: FloatArray | None
    coefficients: tuple[Coefficient, ...]
    fuzzy: Uncertainty | None = None


def intervals(model: Fitted, train: Dataset | None) -> Intervals | None:
    """What the model offers: linear ones by themselves, rules beside their training data."""
    if isinstance(model, LinearModel):
        return _linear(model)
    if isinstance(model, HasIntervals) and train is not None:
        return _of_rules(model, train)
    return None


def _of_rules(model: Any, train: Dataset) -> Intervals | None:
    """Of a model of rules; None where the data cannot tell."""
    try:
        sure: Uncertainty = model.uncertainty(train)
        with np.errstate(all="ignore"):
            known = isinstance(model, HasOperatingPoints) and model.operating_points
            gain, reached = _at_rest(model) if known else (sure.gain_interval, None)
    except (DataError, UsageError):
        return None
    errors = sure.consequent_errors
    found = [
        Coefficient(f"R{r + 1}", output.name, name, float(value), float(errors[r, i, m]))
        for r, rule in enumerate(model.consequents)
        for i, output in enumerate(model.outputs)
        for m, (name, value) in enumerate(zip(model.regressor_names, rule[i], strict=True))
    ]
    return Intervals(gain, reached, tuple(found), sure)


def _at_rest(model: Any) -> tuple[FloatArray, FloatArray]:
    """Intervals where each rule is the strongest at rest."""
    rules = model.rules()
    gain = np.full((2, len(rules), len(model.outputs), len(model.inputs)), np.nan)
    reached = gain.copy()
    for r, rule in enumerate(rules):
        for point in rule.here:
            gain[:, r, point.output] = point.gain_interval
            reached[:, r, point.output] = point.reached_interval_s
    return gain, reached


def _linear(model: LinearModel) -> Intervals | None:
    """The gain at frequency zero with its first-order error; coefficients where they mean something."""
    estimated = model.coefficients() if isinstance(model, HasCoefficients) else ()
    try:
        with np.errstate(all="ignore"):  # a gain of zero has no phase
            error = Z95 * model.frequency_response(np.zeros(1)).magnitude_error[0]
    except np.linalg.LinAlgError:  # it integrates
        error = np.full(model.dc_gain.shape, np.nan)
    if not estimated and not np.isfinite(error).any():
        return None
    gain = np.stack([model.dc_gain - error, model.dc_gain + error])[:, None]
    return Intervals(gain, None, tuple(estimated))
