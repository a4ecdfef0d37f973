"""Local linear views of a TS state-space model, and the model as a python-control system.

Both use one state s(k) = [x(k-1), u(k-1), ..., u(k-L)] in physical units, L the deepest input lag, so that
delays and inputs that feed through need no special case.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.rules.fitted_states import FittedTSStateSpace
from flysid.model.rules.kernel import free_run
from flysid.model.rules.local_models import Certificate, StateSpace, certificate_of, refuse_limit

_NEWTON = 40  # steps


def polytope(model: FittedTSStateSpace) -> tuple[StateSpace, ...]:
    """The rules as local state spaces over one common state, ready for parallel distributed compensation."""
    return tuple(_companion(model, theta) for theta in model.consequents)


def _companion(model: FittedTSStateSpace, theta: FloatArray) -> StateSpace:
    layout = model.layout
    n = model.layout.n
    n_u = len(model.inputs)
    size = n + layout.depth * n_u
    A = np.zeros((size, size))
    B = np.zeros((size, n_u))
    offset = np.zeros(size)
    for m, (column, lag) in enumerate(layout.regressors):
        if column < 0:
            offset[:n] = theta[:, m]
        elif column < n:
            A[:n, column] = theta[:, m]
        elif lag == 0:
            B[:n, column - n] = theta[:, m]
        else:
            A[:n, n + (lag - 1) * n_u + column - n] = theta[:, m]
    _shift_register(A, B, n)
    n_y = layout.n_y
    return StateSpace(A, B, A[:n_y].copy(), B[:n_y].copy(), offset, offset[:n_y].copy(), model.dt_s)


def _shift_register(A: FloatArray, B: FloatArray, n: int) -> None:
    """Inputs of the past move on by one sample, below the first n rows."""
    size, n_u = B.shape
    B[n : n + n_u] = np.eye(n_u)
    A[n + n_u :, n : size - n_u] = np.eye(size - n - n_u)


def linearise(model: FittedTSStateSpace, u: FloatArray, y: FloatArray | None = None) -> StateSpace:
    """The model's derivative at constant inputs u (n_u,), memberships included.

    Where outputs y (n_y,) are given, hidden states stand where they rest beside them; otherwise all states
    stand where the inputs hold them. Central differences on a step of 1e-5 of each signal's spread.

    Raises
    ------
    UsageError : u or y has another length than the model's signals, the states come to no rest there, or an
        output is at its limit.
    """
    u = np.atleast_1d(np.asarray(u, dtype=float))
    held = None if y is None else np.atleast_1d(np.asarray(y, dtype=float))
    layout = model.layout
    n = model.layout.n
    n_y = model.layout.n_y
    if u.shape != (len(model.inputs),) or (held is not None and held.shape != (n_y,)):
        raise UsageError(
            f"u has shape {u.shape}" + ("" if held is None else f" and y {held.shape}"),
            hint=f"give {len(model.inputs)} inputs and {n_y} outputs",
        )
    s = np.concatenate([resting_states(model, u, held), np.tile(u, layout.depth)])
    limits = model.parameters.limits * layout.scale[:n] + layout.shift[:n]
    refuse_limit(next_states(model, s, u)[:n], limits)
    scale = layout.scale
    sizes = 1e-5 * np.concatenate([scale[:n], np.tile(scale[n:], layout.depth)])
    A = np.zeros((len(s), len(s)))
    B = np.zeros((len(s), len(u)))
    A[:n] = _jacobian(lambda at: next_states(model, at, u), s, sizes)
    B[:n] = _jacobian(lambda at: next_states(model, s, at), u, 1e-5 * scale[n:])
    _shift_register(A, B, n)
    offset = np.zeros(len(s))
    offset[:n] = next_states(model, s, u) - A[:n] @ s - B[:n] @ u
    return StateSpace(A, B, A[:n_y].copy(), B[:n_y].copy(), offset, offset[:n_y].copy(), model.dt_s)


def resting_states(model: FittedTSStateSpace, u: FloatArray, y: FloatArray | None = None) -> FloatArray:
    """(n,) states that constant inputs hold; hidden ones only, beside outputs that are given.

    Raises
    ------
    UsageError : Newton's method finds none.
    """
    layout = model.layout
    n = model.layout.n
    free = np.arange(0 if y is None else layout.n_y, n)
    scale = layout.scale[:n]
    past = np.tile(u, layout.depth)
    x = model.prior.mean * scale + layout.shift[:n]
    if y is not None:
        x[: layout.n_y] = y

    def gap(at: FloatArray) -> FloatArray:
        moved = next_states(model, np.concatenate([at, past]), u) - at
        return np.asarray(moved[free] / scale[free])

    for _ in range(_NEWTON):
        miss = gap(x)
        if np.abs(miss).max(initial=0.0) < 1e-10:
            return x
        J = _jacobian(gap, x, 1e-6 * scale)[:, free] * scale[free]
        step = np.linalg.lstsq(J, miss, rcond=1e-12)[0]
        sizes = [2.0**-k for k in range(8)]
        tried = [x.copy() for _ in sizes]
        for at, size in zip(tried, sizes, strict=True):
            at[free] -= size * step * scale[free]
        x = min(tried, key=lambda at: float(np.abs(gap(at)).max()))
    raise UsageError(
        "the states come to no rest at this operating point",
        hint="choose one inside the training range; a process that integrates rests at no input but one",
    )


def _jacobian(f: Callable[[FloatArray], FloatArray], at: FloatArray, sizes: FloatArray) -> FloatArray:
    """(m, n) derivative of f by central differences on steps of these sizes."""
    steps = np.diag(sizes)
    columns = [(f(at + e) - f(at - e)) / (2.0 * h) for e, h in zip(steps, sizes, strict=True)]
    return np.stack(columns, axis=1)


def certificate(model: FittedTSStateSpace) -> Certificate:
    """A common quadratic Lyapunov function of all rules' states, where one is found."""
    n = model.layout.n
    return certificate_of([theta[:, :n] for theta in model.consequents])


def next_states(model: FittedTSStateSpace, s: FloatArray, u: FloatArray) -> FloatArray:
    """(n,) x(k) from s(k) and u(k), physical units."""
    layout = model.layout
    n = model.layout.n
    n_u = len(model.inputs)
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

    n = model.layout.n
    n_y = model.layout.n_y
    n_u = len(model.inputs)

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
