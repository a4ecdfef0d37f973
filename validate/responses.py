"""Frequency response and steady state of any fitted model, by its polynomials or by simulating it."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.base import Fitted
from flysid.model.capabilities import HasDifferenceEquation, LocallyLinear
from flysid.model.polynomials import ComplexArray

LONGEST = 4000
SLOWEST = 20_000


def responses(model: Fitted, hz: FloatArray, output: int, signal: int) -> list[ComplexArray]:
    """Response (F,) of every rule from input `signal` to `output`; or of a one-rule model simulated."""
    if isinstance(model, LocallyLinear):
        return [_rational(A, B, hz, model.dt_s)[:, output, signal] for A, B, _ in model.local_polynomials()]
    if isinstance(model, HasDifferenceEquation):
        return [_rational(-model.system.a[1:], model.system.b, hz, model.dt_s)[:, output, signal]]
    if len(model.rules()) > 1:
        return []
    with np.errstate(invalid="ignore"):  # inf - inf, of a model that breaks the laws
        impulse = impulse_response(model, output, signal)
    if not np.isfinite(impulse).all():
        return []
    return [np.exp(-2j * np.pi * np.outer(hz, np.arange(len(impulse))) * model.dt_s) @ impulse]


def _rational(A: FloatArray, B: FloatArray, hz: FloatArray, dt_s: float) -> ComplexArray:
    """(F, n_y, n_u) (I - sum_j A[j-1] z^-j)^-1 sum_j B[j] z^-j on the unit circle; NaN where singular."""
    back = np.exp(-2j * np.pi * hz * dt_s)[:, None]
    left = np.eye(B.shape[1]) - np.einsum("kij,fk->fij", A, back ** np.arange(1, len(A) + 1))
    right = np.einsum("kij,fk->fij", B, back ** np.arange(len(B)))
    singular = np.abs(np.linalg.det(left)) < 1e-14
    left[singular] = np.eye(B.shape[1])
    result: ComplexArray = np.linalg.solve(left, right)
    result[singular] = np.nan
    return result


def impulse_response(model: Fitted, output: int, signal: int, n: int = LONGEST) -> FloatArray:
    """(n,) what one input sample of height 1 does to the output, from rest."""
    at = model.n_init + 1
    u = np.zeros((at + n, len(model.inputs)))
    rest = model.simulate(u)[at:, output]
    u[at, signal] = 1.0
    response: FloatArray = model.simulate(u)[at:, output] - rest
    return response


def steady_outputs(
    model: Fitted, levels: FloatArray, fixed: FloatArray, output: int, signal: int
) -> FloatArray:
    """(L,) output that the model settles at for each constant level of one input; NaN where it does not.

    The other inputs stay at `fixed` (n_u,).
    """
    finite = [r.time_constant_s for r in model.rules() if np.isfinite(r.time_constant_s)]
    n = int(np.clip(8.0 * max(finite, default=0.0) / model.dt_s, 200, SLOWEST)) + model.n_init
    settled = np.full(len(levels), np.nan)
    for i, level in enumerate(levels):
        u = np.tile(fixed, (n, 1))
        u[:, signal] = level
        y = model.simulate(u)[:, output]
        if not np.isfinite(y).all():
            continue
        tail = y[-max(2, n // 10) :]
        if np.ptp(tail) <= 1e-2 * max(float(np.ptp(y)), 1e-12):
            settled[i] = tail[-1]
    return settled
