"""Why a TS state-space model said what it said: `flysid.model.fuzzy.explain` over hidden states."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.fuzzy.explain import Explanation, Voice
from flysid.model.fuzzy.kernel import firing
from flysid.model.hidden.model import FittedTSStateSpace


def explain(model: FittedTSStateSpace, u: FloatArray, y: FloatArray, row: int) -> Explanation:
    """Take the step to sample `row` of measured data apart: outputs before it as measured, hidden states as
    the free run has them.

    Raises
    ------
    UsageError : the row has no full history, or is not there.
    """
    u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    if not model.n_init <= row < len(y):
        raise UsageError(
            f"sample {row} cannot be explained", hint=f"choose one from {model.n_init} to {len(y) - 1}"
        )
    layout, par = model.layout, model.parameters
    W = model.seen(u[: row + 1], y[: row + 1])
    shares = firing(W, row, layout.lags, par)[row]
    x = np.array([1.0 if column < 0 else W[row - lag, column] for column, lag in layout.regressors])
    n_y = layout.n_y
    alone = (par.theta[:, :n_y] @ x) * layout.scale[:n_y] + layout.shift[:n_y]
    shift, scale = layout.antecedent_scaling()
    z = layout.antecedent_values(W)[-1] * scale + shift
    low, high = model.partition.low, model.partition.high
    rules = model.rules()
    return Explanation(
        row,
        {name: float(v) for name, v in zip(model.antecedents, z, strict=True)},
        tuple(n for n, v, a, b in zip(model.antecedents, z, low, high, strict=True) if not a <= v <= b),
        tuple(
            Voice(rules[r].label, rules[r].condition, float(shares[r]), tuple(float(v) for v in alone[r]))
            for r in np.argsort(-shares, kind="stable")
        ),
        tuple(float(v) for v in np.clip(shares @ alone, *model.output_limits)),
    )
