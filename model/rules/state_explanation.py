"""Why a TS state-space model said what it said: `flysid.model.rules.explanation` over hidden states."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.arguments import as_record
from flysid.model.rules.explanation import Explanation, is_outside, refuse_row, taken_apart
from flysid.model.rules.fitted_states import FittedTSStateSpace
from flysid.model.rules.kernel import firing


def explain(model: FittedTSStateSpace, u: FloatArray, y: FloatArray, row: int) -> Explanation:
    """Take the step to sample `row` of measured data apart: outputs before it as measured, hidden states as
    the free run has them.

    Raises
    ------
    UsageError : the row has no full history, or is not there.
    """
    u = np.asarray(u, dtype=float)
    y = np.asarray(y, dtype=float)
    refuse_row(model, row, len(y))
    layout = model.layout
    par = model.parameters
    W = model.seen(u[: row + 1], y[: row + 1])
    shares = firing(W, row, layout.lags, par)[row]
    x = np.array([1.0 if column < 0 else W[row - lag, column] for column, lag in layout.regressors])
    n_y = layout.n_y
    alone = (par.theta[:, :n_y] @ x) * layout.scale[:n_y] + layout.shift[:n_y]
    shift, scale = layout.antecedent_scaling()
    z = layout.antecedent_values(W)[-1] * scale + shift
    return taken_apart(model, row, z, (shares, alone), np.clip(shares @ alone, *model.output_limits))


def outside_share(model: FittedTSStateSpace, u: FloatArray, y: FloatArray) -> float:
    """Share of samples, 0 to 1, in which an antecedent lies outside the range seen in training.

    Outputs are as measured, hidden states as the free run has them.
    """
    shift, scale = model.layout.antecedent_scaling()
    z = model.layout.antecedent_values(model.seen(*as_record(model, u, y))) * scale + shift
    return float(is_outside(model, z).any(axis=1).mean()) if z.size else 0.0
