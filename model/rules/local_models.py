"""Local linear views of a TS model: linearisation, the polytope of its rules, and stability certificates.

A TS model is a polytopic (LPV) system: its one-step map is a convex combination of the rules' affine maps,
weighted by the firing strengths. A common quadratic Lyapunov function of all rules (Tanaka and Sugeno 1992)
proves that outputs stay bounded under bounded inputs whatever fires, and that a run forgets its start under
any one sequence of firing strengths. Where conditions speak of outputs, two runs on the same inputs fire
differently: that these come together too is asked of runs (`flysid.model.rules.contraction`). Its absence
proves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.rules.fitted_lags import FittedTS, refuse_other_models
from flysid.model.rules.lyapunov import common_lyapunov


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x(k+1) = A x(k) + B u(k) + f,  y(k) = C x(k) + D u(k) + g, physical units.

    x holds past outputs y(k-1), ..., y(k-n) and then past inputs u(k-1), ..., u(k-m); A, B and f are exact
    companion matrices of the lags, shared by every rule but for the first block of rows.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    f: FloatArray
    g: FloatArray
    dt_s: float


def polytope(model: FittedTS) -> tuple[StateSpace, ...]:
    """The rules as local state spaces over one common state, ready for parallel distributed compensation.

    Raises
    ------
    UsageError : not a model of rules over lags.
    """
    refuse_other_models(model)
    return tuple(_companion(model, A, B, c) for A, B, c in model.local_polynomials())


def _companion(model: FittedTS, A: FloatArray, B: FloatArray, c: FloatArray) -> StateSpace:
    na, n_y, _ = A.shape
    past_inputs = len(B) - 1
    n_u = B.shape[2]
    n = na * n_y
    m = past_inputs * n_u
    C = np.zeros((n_y, n + m))
    C[:, :n] = np.concatenate(list(A), axis=1) if na else np.zeros((n_y, 0))
    C[:, n:] = np.concatenate(list(B[1:]), axis=1) if past_inputs else np.zeros((n_y, 0))
    step = np.zeros((n + m, n + m))
    drive = np.zeros((n + m, n_u))
    offset = np.zeros(n + m)
    if na:
        step[:n_y], drive[:n_y], offset[:n_y] = C, B[0], c
        step[n_y:n, : n - n_y] = np.eye(n - n_y)
    if past_inputs:
        drive[n : n + n_u] = np.eye(n_u)
        step[n + n_u :, n : n + m - n_u] = np.eye(m - n_u)
    return StateSpace(step, drive, C, B[0].copy(), offset, c.copy(), model.dt_s)


def linearise(model: FittedTS, u: FloatArray, y: FloatArray) -> StateSpace:
    """The model's derivative at constant inputs u (n_u,) and outputs y (n_y,), memberships included.

    Central differences of the one-step prediction, on a step of 1e-5 of each signal's spread.

    Raises
    ------
    UsageError : u or y has another length than the model's signals; the model's output is at its limit there.
    """
    refuse_other_models(model)
    u = np.atleast_1d(np.asarray(u, dtype=float))
    y = np.atleast_1d(np.asarray(y, dtype=float))
    if u.shape != (len(model.inputs),) or y.shape != (len(model.outputs),):
        raise UsageError(
            f"u has shape {u.shape} and y {y.shape}",
            hint=f"give {len(model.inputs)} inputs and {len(model.outputs)} outputs",
        )
    d = model.n_init
    n_y = len(y)
    U = np.tile(u, (d + 1, 1))
    Y = np.tile(y, (d + 1, 1))
    model = model.unlimited()
    refuse_limit(model.one_step(U, Y)[d], model.output_limits)

    def next_output(k: int, column: int, size: float) -> FloatArray:
        moved_u = U.copy()
        moved_y = Y.copy()
        if column < n_y:
            moved_y[d - k, column] += size
        else:
            moved_u[d - k, column - n_y] += size
        return np.asarray(model.one_step(moved_u, moved_y)[d])

    deepest = max([0, *(lag for c, lag in model.layout.regressors if c >= n_y)])
    deepest = max([deepest, *(max(a.lag, a.minus) for a in model.layout.antecedents if a.column >= n_y)])
    na = max(
        [model.layout.orders.na, *(max(a.lag, a.minus) for a in model.layout.antecedents if a.column < n_y)]
    )
    A = np.zeros((na, n_y, n_y))
    B = np.zeros((deepest + 1, n_y, len(u)))
    for column, scale in enumerate(model.layout.scale):
        size = 1e-5 * float(scale)
        lags = range(1, na + 1) if column < n_y else range(deepest + 1)
        for k in lags:
            slope = (next_output(k, column, size) - next_output(k, column, -size)) / (2 * size)
            if column < n_y:
                A[k - 1, :, column] = slope
            else:
                B[k, :, column - n_y] = slope
    offset = model.one_step(U, Y)[d] - A.sum(axis=0) @ y - B.sum(axis=0) @ u
    return _companion(model, A, B, offset)


def refuse_limit(y: FloatArray, limits: FloatArray) -> None:
    """Raise UsageError where an output or state (n,) stands at its limits (2, n): nothing moves it there."""
    for value, low, high in zip(y, *limits, strict=True):
        rounding = 1e-9 * (high - low)
        if not low + rounding < value < high - rounding:
            raise UsageError(
                f"the model is at its limit there, {value:.4g}: nothing moves it, and it has no linear model",
                hint="choose a place inside the training range",
            )


@dataclass(frozen=True, eq=False)
class Certificate:
    """What could be proved about stability.

    Attributes
    ----------
    proved : a common quadratic Lyapunov function was found, and checked.
    P : (n, n) its matrix, symmetric positive definite; zeros where none was found.
    decay : the worst factor by which sqrt(x'Px) shrinks per step; at least 1 where nothing is proved.
    reason : in words.
    """

    proved: bool
    P: FloatArray
    decay: float
    reason: str


def certificate(model: FittedTS) -> Certificate:
    """A P > 0 with A_r' P A_r - P < 0 for the output dynamics of every rule, where one is found.

    Raises
    ------
    UsageError : not a model of rules over lags.
    """
    refuse_other_models(model)
    n = model.layout.orders.na * len(model.outputs)
    return certificate_of([s.A[:n, :n] for s in polytope(model)])


def certificate_of(rules: list[FloatArray]) -> Certificate:
    """A P > 0 with A_r' P A_r - P < 0 for the (n, n) matrices of all rules; see `lyapunov`."""
    n = len(rules[0])
    if n == 0:
        return Certificate(True, np.zeros((0, 0)), 0.0, "The model has no memory of its outputs.")
    radii = [float(np.abs(np.linalg.eigvals(A)).max()) for A in rules]
    if max(radii) >= 1.0:
        worst = int(np.argmax(radii))
        return Certificate(
            False,
            np.zeros((n, n)),
            max(radii),
            f"R{worst + 1} by itself is not stable (pole radius {radii[worst]:.4f}), so no common quadratic "
            "Lyapunov function of all rules exists; the blend may still be stable.",
        )
    found = common_lyapunov(rules)
    if found is None:
        reason = "Every rule is stable, but no common quadratic Lyapunov function was found."
        return Certificate(False, np.zeros((n, n)), 1.0, reason)
    P, decay = found
    shown = np.ceil(decay * 1e5) / 1e5
    reason = (
        f"A common quadratic Lyapunov function proves it: the state's length falls to {shown:.5f} of itself "
        "or less per step, whatever fires; bounded inputs leave the outputs bounded."
    )
    return Certificate(True, P, decay, reason)
