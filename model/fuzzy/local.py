"""Local linear views of a TS model: linearisation, the polytope of its rules, and stability certificates.

A TS model is a polytopic (LPV) system: its one-step map is a convex combination of the rules' affine maps,
weighted by the firing strengths. A common quadratic Lyapunov function of all rules proves that the free run
forgets its start under any sequence of firing strengths (Tanaka and Sugeno 1992); its absence proves
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.fuzzy.model import FittedTS

_ROUNDS = 4000


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
    """The rules as local state spaces over one common state, ready for parallel distributed compensation."""
    return tuple(_companion(model, A, B, c) for A, B, c in model.local_polynomials())


def _companion(model: FittedTS, A: FloatArray, B: FloatArray, c: FloatArray) -> StateSpace:
    na, n_y, _ = A.shape
    past_inputs, n_u = len(B) - 1, B.shape[2]
    n, m = na * n_y, past_inputs * n_u
    C = np.zeros((n_y, n + m))
    C[:, :n] = np.concatenate(list(A), axis=1) if na else np.zeros((n_y, 0))
    C[:, n:] = np.concatenate(list(B[1:]), axis=1) if past_inputs else np.zeros((n_y, 0))
    step, drive, offset = np.zeros((n + m, n + m)), np.zeros((n + m, n_u)), np.zeros(n + m)
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
    UsageError : u or y has another length than the model's signals.
    """
    u, y = np.atleast_1d(np.asarray(u, dtype=float)), np.atleast_1d(np.asarray(y, dtype=float))
    if u.shape != (len(model.inputs),) or y.shape != (len(model.outputs),):
        raise UsageError(
            f"u has shape {u.shape} and y {y.shape}",
            hint=f"give {len(model.inputs)} inputs and {len(model.outputs)} outputs",
        )
    d, n_y = model.n_init, len(y)
    U, Y = np.tile(u, (d + 1, 1)), np.tile(y, (d + 1, 1))

    def next_output(k: int, column: int, size: float) -> FloatArray:
        moved_u, moved_y = U.copy(), Y.copy()
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
    A, B = np.zeros((na, n_y, n_y)), np.zeros((deepest + 1, n_y, len(u)))
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


@dataclass(frozen=True, eq=False)
class Certificate:
    """What could be proved about stability.

    Attributes
    ----------
    proved : a common quadratic Lyapunov function was found, and checked.
    P : (n, n) its matrix, symmetric positive definite; zeros where none was found.
    decay : the worst factor by which x'Px shrinks per step; at least 1 where nothing is proved.
    reason : in words.
    """

    proved: bool
    P: FloatArray
    decay: float
    reason: str


def certificate(model: FittedTS) -> Certificate:
    """A P > 0 with A_r' P A_r - P < 0 for the output dynamics of every rule, where one is found."""
    n = model.layout.orders.na * len(model.outputs)
    return certificate_of([s.A[:n, :n] for s in polytope(model)])


def certificate_of(rules: list[FloatArray]) -> Certificate:
    """Search a P > 0 with A_r' P A_r - P < 0 for the (n, n) matrices of all rules.

    The gradient method of Liberzon and Tempo (2004): the worst rule's most violated direction is pushed
    down, the result projected on the positive definite matrices. The answer is verified by Cholesky
    factors, so that "proved" does not rest on the search.
    """
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
    T = _balancing(rules)
    balanced = [np.asarray(np.linalg.solve(T, A @ T), dtype=np.float64) for A in rules]
    P, decay = _search(balanced)
    if decay >= 1.0:
        reason = "Every rule is stable, but no common quadratic Lyapunov function was found."
        return Certificate(False, np.zeros((n, n)), decay, reason)
    back = np.linalg.inv(T)
    reason = (
        f"A common quadratic Lyapunov function shrinks by {decay:.5f} or faster per step, whatever fires."
    )
    return Certificate(True, back.T @ P @ back, decay, reason)


def _balancing(rules: list[FloatArray]) -> FloatArray:
    """(n, n) coordinates in which the mean rule is close to normal: x = T z."""
    from scipy.linalg import solve_discrete_lyapunov

    mean = np.mean(rules, axis=0)
    radius = float(np.abs(np.linalg.eigvals(mean)).max())
    shrunk = mean if radius < 0.9999 else mean * (0.9999 / radius)
    P = solve_discrete_lyapunov(shrunk.T, np.eye(len(mean)))
    values, vectors = np.linalg.eigh(0.5 * (P + P.T))
    return np.asarray(vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1])))


def _search(rules: list[FloatArray]) -> tuple[FloatArray, float]:
    """P > 0 that makes the largest eigenvalue of A' P A - P over the rules smallest, and the decay."""
    n = len(rules[0])
    P, best, best_decay = np.eye(n), np.eye(n), np.inf
    for k in range(_ROUNDS):
        decay = max(_decay(A, P) for A in rules)
        if decay < best_decay:
            best, best_decay = P, decay
        if best_decay < 1.0 - 1e-9 and k > 50:
            break
        gaps = [np.linalg.eigh(A.T @ P @ A - P) for A in rules]
        worst = int(np.argmax([values[-1] for values, _ in gaps]))
        x = gaps[worst][1][:, -1]
        gradient = np.outer(rules[worst] @ x, rules[worst] @ x) - np.outer(x, x)
        size = float(np.sum(gradient * gradient))
        step = (max(float(gaps[worst][0][-1]), 0.0) + 1e-3 / np.sqrt(k + 1.0)) / max(size, 1e-300)
        values, vectors = np.linalg.eigh(P - step * gradient)
        P = (vectors * np.maximum(values, 1e-3)) @ vectors.T
    return best, float(np.sqrt(best_decay)) if best_decay > 0 else 0.0


def _decay(A: FloatArray, P: FloatArray) -> float:
    """Largest x'A'PAx / x'Px: below 1, P is a Lyapunov function of A."""
    L = np.linalg.cholesky(P)
    M = np.linalg.solve(L, np.linalg.solve(L, A.T @ P @ A).T)
    return float(np.linalg.eigvalsh(0.5 * (M + M.T))[-1])
