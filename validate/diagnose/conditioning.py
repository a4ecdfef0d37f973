"""How well the data pin every rule down: the condition of its regressors."""

from __future__ import annotations

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.base import Fitted
from flysid.model.capabilities import HasDifferenceEquation, LocallyLinear


def conditions(model: Fitted, data: Dataset) -> tuple[float, ...]:
    """Condition number of the regressors, one per rule; () where the model does not tell its regressors.

    Columns are centred and scaled; rows are weighted by the rule's firing strength. 1: perfectly independent;
    infinite: some coefficients cannot be told apart.
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
