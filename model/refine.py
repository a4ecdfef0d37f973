"""Levenberg-Marquardt: nonlinear least squares with exact sensitivities, for every model structure.

The caller gives residuals and their Jacobian, or, for data too long for a Jacobian, the normal equations
(cost, JᵀJ, Jᵀr) that it accumulated over chunks. Simulation errors explode when a trial point is
unstable: such a point (non-finite or higher cost) is rejected and the damping grows; it is no error.

Method: Marquardt (1963) with the scaling of Moré (1978) (the largest diagonal of JᵀJ seen so far) and
the damping rule of Nielsen (1999), Damping Parameter in Marquardt's Method, IMM-REP-1999-05.
Cost per iteration: one call of `evaluate` (one more per rejected trial; none at the end of a search with a
cheaper `cost`) and O(n³) for n parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.model.bordered import Bordered
from flysid.model.compiled_filters import squares

Residuals: TypeAlias = tuple[FloatArray, FloatArray]
"""(N,) residuals r and their (N, n) Jacobian dr/dtheta."""
NormalEquations: TypeAlias = tuple[float, FloatArray | Bordered, FloatArray]
"""cost rᵀr, (n, n) JᵀJ and (n,) Jᵀr."""
FIRST_DAMPING = 1e-3
"""Of the diagonal of JᵀJ: directions that hardly move the error are held by it."""
Reason = Literal["converged", "stalled", "max_iterations"]


@dataclass(frozen=True)
class Refinement:
    """Where the search ended.

    `theta`: (n,) the parameters of lowest cost.
    `cost`: sum of squared residuals at `theta`.
    `reason`: "converged" (step or improvement below the tolerance, or the gradient vanished), "stalled" (no
        step lowers the cost), "max_iterations".
    """

    theta: FloatArray
    cost: float
    reason: Reason


@dataclass(frozen=True)
class _Point:
    """A point of the search: cost, gradient, and either the triangle R of J = QR with Qᵀr, or JᵀJ."""

    theta: FloatArray
    cost: float
    gradient: FloatArray
    diagonal: FloatArray
    jtj: FloatArray | Bordered | None
    triangle: FloatArray | None
    rotated: FloatArray | None


def levenberg_marquardt(
    evaluate: Callable[[FloatArray], Residuals | NormalEquations],
    theta0: FloatArray,
    *,
    cost: Callable[[FloatArray], float] | None = None,
    max_iterations: int = 50,
    tolerance: float = 1e-8,
    first_damping: float = FIRST_DAMPING,
    largest_damping: float = 1e16,
) -> Refinement:
    """Minimise the sum of squared residuals from a start.

    `evaluate`: theta -> (r, J) or (cost, JᵀJ, Jᵀr). May return non-finite values for divergent models.
    `theta0`: (n,) start; its cost must be finite.
    `cost`: theta -> rᵀr without derivatives, when that is cheaper: trial points are then tried with it first.
    `tolerance`: relative decrease of the cost, and relative length of the step, that count as converged.
    Raises FitError: the cost of the start is not finite.
    """
    point = _start(evaluate, theta0)
    scale = _floor(point.diagonal)
    damping = first_damping
    growth = 2.0
    tries = 0
    while tries < max_iterations:
        if point.cost == 0.0 or _is_stationary(point, scale):
            return Refinement(point.theta, point.cost, "converged")
        tries += 1
        step = _step(point, scale, damping)
        value, new = (np.inf, None) if step is None else _try(evaluate, cost, point.theta + step)
        if step is not None and value < point.cost:  # NaN compares false
            settled = point.cost - value <= tolerance * point.cost or _is_short(step, point, scale, tolerance)
            if settled or tries == max_iterations:  # nobody asks for derivatives here
                return Refinement(point.theta + step, value, "converged" if settled else "max_iterations")
            new = new or _evaluate(evaluate, point.theta + step)
        if step is None or new is None or not new.cost < point.cost:
            damping = damping * growth
            growth = growth * 2.0
            if damping > largest_damping or (step is not None and _is_short(step, point, scale, 1e-15)):
                return Refinement(point.theta, point.cost, "stalled")
            tries -= growth <= 2.0**8  # the first rejections in a row cost no iteration
            continue
        damping, growth = _relax(damping, point, new, step, scale)
        point = new
        scale = np.maximum(scale, np.sqrt(point.diagonal))
    return Refinement(point.theta, point.cost, "max_iterations")


def _start(evaluate: Callable[[FloatArray], Residuals | NormalEquations], theta0: FloatArray) -> _Point:
    point = _evaluate(evaluate, np.asarray(theta0, dtype=np.float64))
    if point is None:
        raise FitError("the start of the refinement diverges", hint="give a stable start")
    return point


def _evaluate(
    evaluate: Callable[[FloatArray], Residuals | NormalEquations], theta: FloatArray
) -> _Point | None:
    """The point at theta, or None where residuals, derivatives or their squares are not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        answer = evaluate(theta)
        if len(answer) == 3:
            total, jtj, jtr = answer
            finite = jtj.is_finite() if isinstance(jtj, Bordered) else np.isfinite(jtj).all()
            if not (finite and np.isfinite(total) and np.isfinite(jtr).all()):
                return None
            return _Point(theta, float(total), jtr, jtj.diagonal().copy(), jtj, None, None)
        residual, jacobian = answer
        total = float(residual @ residual)
        diagonal = squares(jacobian)
    if not (np.isfinite(total) and np.isfinite(diagonal).all()):
        return None
    triangle, rotated = _triangle(residual, jacobian)
    return _Point(theta, total, triangle.T @ rotated, diagonal, None, triangle, rotated)


def _triangle(residual: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R and Qᵀr of J = QR, from one QR of [J r]."""
    n = jacobian.shape[1]
    full = upper_triangle(jacobian, residual)
    return full[:n, :n], full[:n, n]


def upper_triangle(matrix: FloatArray, column: FloatArray) -> FloatArray:
    """(n + 1, n + 1) R of [matrix (N, n) | column (N,)] = QR; `np.linalg.qr` copies both twice."""
    from scipy.linalg.lapack import dgeqrf

    rows, n = matrix.shape
    both = np.empty((rows, n + 1), order="F")
    both[:, :n] = matrix
    both[:, n] = column
    full = np.zeros((n + 1, n + 1))
    full[:rows] = np.triu(dgeqrf(both, overwrite_a=True)[0][: n + 1])
    return full


def _try(
    evaluate: Callable[[FloatArray], Residuals | NormalEquations],
    cost: Callable[[FloatArray], float] | None,
    theta: FloatArray,
) -> tuple[float, _Point | None]:
    """The cost of a trial point, infinite where it diverges; the point too, where that is no dearer."""
    if cost is None:
        new = _evaluate(evaluate, theta)
        return (np.inf if new is None else new.cost), new
    with np.errstate(over="ignore", invalid="ignore"):
        return cost(theta), None


def _step(point: _Point, scale: FloatArray, damping: float) -> FloatArray | None:
    """Solve (JᵀJ + damping D²) step = -Jᵀr in scaled unknowns; None when that is singular."""
    from scipy.linalg.lapack import dgels, dposv

    n = len(scale)
    if isinstance(point.jtj, Bordered):
        found = point.jtj.damped_step(scale, damping, point.gradient)
        return found if found is not None and np.isfinite(found).all() else None
    if point.triangle is not None and point.rotated is not None:
        # least squares on [R D⁻¹; sqrt(damping) I] keeps the condition of J instead of squaring it
        matrix = np.vstack([point.triangle / scale, np.sqrt(damping) * np.eye(n)])
        solution = dgels(matrix, np.concatenate([-point.rotated, np.zeros(n)]))[1][:n]
    else:
        assert point.jtj is not None
        matrix = point.jtj / np.outer(scale, scale) + damping * np.eye(n)
        _, solution, failed = dposv(matrix, -point.gradient / scale)
        if failed:
            return None
    step = solution / scale
    return step if np.isfinite(step).all() else None


def _relax(
    damping: float,
    old: _Point,
    new: _Point,
    step: FloatArray,
    scale: FloatArray,
    *,
    smallest: float = 1e-24,
    smallest_factor: float = 0.1,
) -> tuple[float, float]:
    """Nielsen's rule (bolder: 0.1 for 1/3): less damping the better the prediction of the decrease was."""
    predicted = -float(step @ old.gradient) + damping * float(np.sum((scale * step) ** 2))
    gain = (old.cost - new.cost) / predicted if predicted > 0 else 1.0
    return max(damping * max(smallest_factor, 1.0 - (2.0 * gain - 1.0) ** 3), smallest), 2.0


def _is_stationary(point: _Point, scale: FloatArray) -> bool:
    """The residual is orthogonal to every column of J, to rounding."""
    return bool(np.max(np.abs(point.gradient) / scale, initial=0.0) <= 1e-14 * np.sqrt(point.cost))


def _is_short(step: FloatArray, point: _Point, scale: FloatArray, tolerance: float) -> bool:
    return float(np.linalg.norm(scale * step)) <= tolerance * float(np.linalg.norm(scale * point.theta))


def _floor(diagonal: FloatArray) -> FloatArray:
    """Column norms, with a floor where a parameter has no effect at the start."""
    norms = np.sqrt(diagonal)
    largest = float(norms.max(initial=0.0)) or 1.0
    floored: FloatArray = np.maximum(norms, 1e-8 * largest)
    return floored
