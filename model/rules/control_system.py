"""TS models as python-control systems; python-control is imported only when this is asked for."""

from __future__ import annotations

from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.fitted_lags import FittedTS, refuse_other_models
from flysid.model.rules.local_models import StateSpace, linearise


def to_nonlinear_system(model: FittedTS) -> Any:
    """The model as a discrete `control.NonlinearIOSystem` whose state is its past outputs and inputs.

    State: y(k-1), ..., y(k-n), then u(k-1), ..., u(k-n) in physical units, n = `n_init`. Driven by the same
    inputs from the same past it follows `simulate` sample by sample.
    """
    import control

    refuse_other_models(model)
    n = model.n_init
    n_y = len(model.outputs)
    n_u = len(model.inputs)
    free = model.unlimited()  # a linear model runs on beyond the limits at which its output is cut off

    def newest(x: FloatArray, u: FloatArray) -> FloatArray:
        past_y = np.asarray(x[: n * n_y]).reshape(n, n_y)[::-1]
        past_u = np.asarray(x[n * n_y :]).reshape(n, n_u)[::-1]
        U = np.vstack([past_u, np.atleast_1d(u)])
        Y = np.vstack([past_y, np.zeros((1, n_y))])
        return np.asarray(free.one_step(U, Y)[n])

    def output(_t: float, x: FloatArray, u: FloatArray, _params: Any) -> FloatArray:
        return np.asarray(np.clip(newest(x, u), *model.output_limits))

    def step(_t: float, x: FloatArray, u: FloatArray, _params: Any) -> FloatArray:
        past_y = np.concatenate([newest(x, u), x[: (n - 1) * n_y]])
        return np.concatenate([past_y, np.atleast_1d(u), x[n * n_y : n * n_y + (n - 1) * n_u]])

    return control.NonlinearIOSystem(
        step,
        output,
        inputs=[s.name for s in model.inputs],
        outputs=[s.name for s in model.outputs],
        states=n * (n_y + n_u),
        dt=model.dt_s,
        name="takagi_sugeno",
    )


def to_state_space(model: FittedTS, u: FloatArray, y: FloatArray) -> Any:
    """The linearisation at constant inputs u and outputs y as a `control.StateSpace` (small deviations)."""
    import control

    local: StateSpace = linearise(model, u, y)
    return control.ss(local.A, local.B, local.C, local.D, model.dt_s)
