"""Everything about one model that no comparison shows: stability, conditioning, how sure its numbers are."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.extras import Extra, extra
from flysid.model.base import Fitted
from flysid.model.capabilities import (
    Coefficient,
    HasCertificate,
    HasCoefficients,
    HasDifferenceEquation,
    HasIntervals,
    HasOperatingPoints,
    HasSimplifications,
    LinearModel,
    LocallyLinear,
)
from flysid.model.polynomials import Z95
from flysid.showing import percent
from flysid.validate.diagnose.robustness import Robustness, robustness

if TYPE_CHECKING:
    from flysid.model.rules.rule_uncertainty import Uncertainty

NOT_GIVEN = "not given: see what is missing"
"""Of a certificate that broke."""
MOST_SAMPLES = 200_000
"""Training samples up to which simplifications are priced: each is refined on all of them."""


@dataclass(frozen=True, eq=False)
class Intervals:
    """95 % intervals of one model: of its gains, time constants and coefficients.

    They come from the training data and speak of noise alone: what a structure cannot express is not in them.

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


@dataclass(frozen=True)
class Simpler:
    """An edit of the rules in words, and by how much it raises the free run's RMSE on the training data."""

    what: str
    loss_pct: float

    def __str__(self) -> str:
        return f"{self.what}: {percent(self.loss_pct, 1)}"


@dataclass(frozen=True, eq=False)
class Checks:
    """One model.

    Attributes
    ----------
    robustness : long free run, forgetting of the start; None where it could not be tried.
    conditions : of the regressors, per rule; () where not known.
    intervals : of gains, time constants and coefficients; None where the model does not tell.
    certificate : what is proved about the stability of any blend of the rules, in words; "" where there is
        one rule, whose poles say all.
    proved : a common quadratic Lyapunov function was found.
    simpler : simpler rules and their price on the training data, cheapest first.
    """

    robustness: Robustness | None
    conditions: tuple[float, ...]
    intervals: Intervals | None
    certificate: str
    proved: bool
    simpler: tuple[Simpler, ...] = ()

    @property
    def fuzzy(self) -> Uncertainty | None:
        """What is known of a TS model's numbers."""
        return None if self.intervals is None else self.intervals.fuzzy


def check(model: Fitted, test: Dataset, train: Dataset | None = None, of: str = "") -> Checks:
    """Try `model` on the ranges of `train` (of `test` where there is none); `of`: its name, for sentences."""
    seen = test if train is None else train
    proved, words = extra(Extra.CERTIFICATE, partial(_certificate, model), (False, NOT_GIVEN), of)
    return Checks(
        extra(Extra.ROBUSTNESS, partial(robustness, model, seen), None, of),
        extra(Extra.CONDITIONING, partial(conditions, model, seen), (), of),
        extra(Extra.INTERVALS, partial(intervals, model, train), None, of),
        words,
        proved,
        () if train is None else extra(Extra.SIMPLER, partial(_simpler, model, train), (), of),
    )


def _simpler(model: Fitted, train: Dataset) -> tuple[Simpler, ...]:
    """Edits of rules over lags; none of other rules, or where the data are too many or too short."""
    if not isinstance(model, HasSimplifications) or len(model.rules()) < 2 or len(train) > MOST_SAMPLES:
        return ()
    with suppress(DataError, UsageError):
        return tuple(Simpler(s.what, s.loss_pct) for s in model.simplifications(train))
    return ()


def _certificate(model: Fitted) -> tuple[bool, str]:
    if not isinstance(model, HasCertificate) or len(model.rules()) < 2:
        return False, ""
    found = model.certificate()
    return found.proved, found.reason


def conditions(model: Fitted, data: Dataset) -> tuple[float, ...]:
    """Condition number of the regressors, one per rule; () where the model does not tell its regressors.

    Columns are centred and scaled; rows are weighted by the rule's firing strength. 1: perfectly independent;
    infinite: some coefficients cannot be distinguished.
    """
    lags = _lags(model)
    if lags is None:
        return ()
    rows, weights = _regressors(model, data, lags)
    if len(rows) <= rows.shape[1]:
        return ()
    return tuple(_condition(rows, weights[:, r]) for r in range(weights.shape[1]))


def _lags(model: Fitted) -> tuple[FloatArray, FloatArray] | None:
    """Which (lag, signal) any rule uses: outputs (na + 1, n_y) and inputs (nb + 1, n_u), as 0 and 1."""
    if isinstance(model, LocallyLinear):
        polynomials = [(A, B) for A, B, _ in model.local_polynomials()]
    elif isinstance(model, HasDifferenceEquation):
        polynomials = [(-model.system.a[1:], model.system.b)]
    else:
        return None
    A = np.max([np.abs(A).max(axis=1) for A, _ in polynomials], axis=0) if len(polynomials[0][0]) else None
    n_y = len(model.outputs)
    outputs = np.vstack([np.zeros((1, n_y)), np.zeros((0, n_y)) if A is None else A > 0.0])
    inputs = np.max([np.abs(B).max(axis=1) for _, B in polynomials], axis=0) > 0.0
    return outputs, np.asarray(inputs, dtype=np.float64)


def _regressors(
    model: Fitted, data: Dataset, lags: tuple[FloatArray, FloatArray], *, most_rows: int = 20_000
) -> tuple[FloatArray, FloatArray]:
    """(N, columns) lagged signals and (N, R) firing strengths, without the first rows of every segment."""
    depth = max(len(lags[0]), len(lags[1])) - 1
    parts = []
    strengths = []
    left = most_rows
    for segment in data.segments:
        if len(segment) <= depth or left <= 0:
            continue
        n = min(len(segment), left + depth)
        u = segment.u[:n]
        y = segment.y[:n]
        columns = [
            signal[depth - lag : n - lag, j]
            for used, signal in ((lags[0], y), (lags[1], u))
            for lag, j in np.argwhere(used > 0.0)
        ]
        parts.append(np.stack(columns, axis=1) if columns else np.zeros((n - depth, 0)))
        strengths.append(np.asarray(model.firing(u, y))[depth:])
        left -= n - depth
    if not parts:
        return np.zeros((0, 0)), np.zeros((0, len(model.rules())))
    return np.vstack(parts), np.vstack(strengths)


def _condition(rows: FloatArray, weight: FloatArray) -> float:
    if rows.shape[1] == 0 or weight.sum() <= 0.0:
        return float("inf") if rows.shape[1] else 1.0
    centred = rows - np.average(rows, axis=0, weights=weight)
    centred = centred * np.sqrt(weight)[:, None]
    size = np.linalg.norm(centred, axis=0)
    if not (size > 0.0).all():
        return float("inf")
    values = np.linalg.svd(centred / size, compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0.0 else float("inf")
