"""Local linear views of a TS state-space model, and the model as a python-control system.

Both use one state s(k) = [x(k-1), u(k-1), ..., u(k-L)] in physical units, L the deepest input lag, so that
delays and inputs that feed through need no special case.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.fuzzy.kernel import free_run
from flysid.model.fuzzy.local import StateSpace
from flysid.model.hidden.model import FittedTSStateSpace


def polytope(model: FittedTSStateSpace) -> tuple[StateSpace, ...]:
    """The rules as local state spaces over one common state, ready for parallel distributed compensation."""
    return tuple(_companion(model, theta) for theta in model.consequents)


def _companion(model: FittedTSStateSpace, theta: FloatArray) -> StateSpace:
    layout, n, n_u = model.layout, model.layout.n, len(model.inputs)
    size = n + layout.depth * n_u
    A, B, offset = np.zeros((size, size)), np.zeros((size, n_u)), np.zeros(size)
    for m, (column, lag) in enumerate(layout.regressors):
        if column < 0:
            offset[:n] = theta[:, m]
        elif column < n:
            A[:n, column] = theta[:, m]
        elif lag == 0:
            B[:n, column - n] = theta[:, m]
        else:
            A[:n, n + (lag - 1) * n_u + column - n] = theta[:, m]
    B[n : n + n_u] = np.eye(n_u)
    A[n + n_u :, n : size - n_u] = np.eye(size - n - n_u)
    n_y = layout.n_y
    return StateSpace(A, B, A[:n_y].copy(), B[:n_y].copy(), offset, offset[:n_y].copy(), model.dt_s)


def next_states(model: FittedTSStateSpace, s: FloatArray, u: FloatArray) -> FloatArray:
    """(n,) x(k) from s(k) and u(k), physical units."""
    layout, n, n_u = model.layout, model.layout.n, len(model.inputs)
    d = layout.depth
    inputs = np.vstack([np.asarray(s[n:]).reshape(d, n_u)[::-1], np.atleast_1d(u)])
    W = layout.stack(inputs, np.zeros((0, layout.n_y)))
    W[d - 1, :n] = (np.asarray(s[:n]) - layout.shift[:n]) / layout.scale[:n]
    free_run(W, d, layout.lags, model.parameters)
    return np.asarray(W[d, :n] * layout.scale[:n] + layout.shift[:n])


def to_nonlinear_system(model: FittedTSStateSpace) -> Any:
    """The model as a discrete `control.NonlinearIOSystem` with the state s(k) of this module.

    Driven by the same inputs from the same state it follows `simulate` sample by sample.
    """
    import control

    n, n_y, n_u = model.layout.n, model.layout.n_y, len(model.inputs)

    def output(_t: float, s: FloatArray, u: FloatArray, _params: Any) -> FloatArray:
        return next_states(model, s, u)[:n_y]

    def step(_t: float, s: FloatArray, u: FloatArray, _params: Any) -> FloatArray:
        return np.concatenate([next_states(model, s, u), np.atleast_1d(u), s[n : len(s) - n_u]])

    return control.NonlinearIOSystem(
        step,
        output,
        inputs=[s.name for s in model.inputs],
        outputs=[s.name for s in model.outputs],
        states=n + model.layout.depth * n_u,
        dt=model.dt_s,
        name="takagi_sugeno_state_space",
    )
