"""Frequency response, step, poles and steady state of any fitted model; where measured data rest."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from flysid.dataset import Dataset, FloatArray
from flysid.model.base import Fitted, OperatingPoint
from flysid.model.capabilities import HasDifferenceEquation, HasRealisation, LinearModel, LocallyLinear
from flysid.model.polynomials import ComplexArray
from flysid.model.rules.recursion import Recursion, crossing

LASTING = 6.0
"""Time constants that a step is followed for: it settles to a quarter of a per cent."""


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
    return [_transform(impulse, model.dt_s * hz)]


def _transform(impulse: FloatArray, turns: FloatArray, *, piece: int = 64) -> ComplexArray:
    """(F,) sum_k impulse[k] exp(-2j pi k turns), in pieces that share their exponentials."""
    pieces = np.pad(impulse, (0, -len(impulse) % piece)).reshape(-1, piece)
    within = np.exp(-2j * np.pi * np.outer(turns, np.arange(piece))) @ pieces.T
    between = np.exp(-2j * np.pi * piece * np.outer(turns, np.arange(len(pieces))))
    return np.asarray((within * between).sum(axis=1), dtype=np.complex128)


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


def impulse_response(model: Fitted, output: int, signal: int, n: int = 4000) -> FloatArray:
    """(n,) what one input sample of height 1 does to the output, from rest."""
    at = model.n_init + 1
    u = np.zeros((at + n, len(model.inputs)))
    rest = model.simulate(u)[at:, output]
    u[at, signal] = 1.0
    response: FloatArray = model.simulate(u)[at:, output] - rest
    return response


def steady_outputs(
    model: Fitted,
    levels: FloatArray,
    fixed: FloatArray,
    output: int,
    signal: int,
    *,
    most_samples: int = 20_000,
) -> FloatArray:
    """(L,) output that the model settles at for each constant level of one input; NaN where it does not.

    The other inputs stay at `fixed` (n_u,).
    """
    finite = [r.time_constant_s for r in model.rules() if np.isfinite(r.time_constant_s)]
    n = int(np.clip(8.0 * max(finite, default=0.0) / model.dt_s, 200, most_samples)) + model.n_init
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


def step_from(
    model: Fitted, rest: FloatArray, height: float, place: tuple[int, int], samples: int
) -> FloatArray:
    """(samples,) what a step of one input adds to an output; every input stands at `rest` (n_u,) before it.

    `place` is (output, input). The model first runs for `samples` at `rest`, so that it has settled where it
    settles at all.
    """
    output, signal = place
    u = np.tile(rest, (model.n_init + 2 * samples, 1))
    still = model.simulate(u)[-samples:, output]
    u[-samples:, signal] += height
    with np.errstate(invalid="ignore"):  # a run that has left for infinity has no step
        moved: FloatArray = model.simulate(u)[-samples:, output] - still
    return moved


def answers(model: Fitted) -> tuple[OperatingPoint, ...]:
    """What a model of one rule does everywhere, of every output that answers every input."""
    if len(model.rules()) > 1:
        return ()
    inputs = range(len(model.inputs))
    found = []
    for output in range(len(model.outputs)):
        told = [_answer(model, output, j) for j in inputs]
        if not all(told):
            continue
        gain, reached, overshoot, wrong_way, dead = np.array(told, dtype=np.float64).T
        found.append(
            OperatingPoint(
                output=output,
                outputs=np.zeros(len(model.outputs)),
                inputs=np.zeros(len(inputs)),
                gain=gain,
                gain_interval=np.full((2, len(inputs)), np.nan),
                reached_s=reached,
                reached_interval_s=np.full((2, len(inputs)), np.nan),
                dead_s=dead,
                overshoot=overshoot,
                wrong_way=wrong_way,
                shares=np.ones(1),
                sample_s=model.dt_s,
            )
        )
    return tuple(found)


def _answer(
    model: Fitted, output: int, signal: int, *, height: float = 1e-3, most_samples: int = 20_000
) -> tuple[float, ...] | None:
    """Gain, seconds to 63 % of it, overshoot, share of the wrong way, dead time; None: no final change.

    `height`: of the step, so small that it leaves a nonlinear model where it is.
    """
    rule = model.rules()[0]
    gain = float(np.asarray(rule.dc_gain)[output, signal])
    if not np.isfinite([gain, rule.time_constant_s]).all() or gain == 0.0:
        return None
    dead = 0.0
    samples = 1 + int(np.ceil(np.clip(LASTING * rule.time_constant_s / model.dt_s, 1.0, most_samples)))
    if isinstance(model, HasDifferenceEquation):
        system = Recursion(-model.system.a[1:], model.system.b, np.zeros(len(model.outputs)))
        moved = system.step(signal, samples)[:, output]
        dead = model.dt_s * max(system.delay(output, signal) - 1, 0)
    else:
        still = np.zeros(len(model.inputs))
        moved = step_from(model, still, height, (output, signal), samples) / height
    share = moved / gain
    reached = crossing(share)
    if not np.isfinite(reached):
        return None
    return gain, reached * model.dt_s, max(share.max() - 1.0, 0.0), max(-share.min(), 0.0), dead


def poles_and_zeros(model: Fitted, output: int, signal: int) -> list[tuple[ComplexArray, ComplexArray]]:
    """Poles and zeros in z from an input to an output, of every rule; those of pure delay are left out.

    Zeros are known of models of one output and of state-space models.
    """
    if isinstance(model, LocallyLinear):
        return [_roots(A, B, signal) for A, B, _ in model.local_polynomials()]
    if isinstance(model, HasDifferenceEquation):
        return [_roots(-model.system.a[1:], model.system.b, signal)]
    if isinstance(model, HasRealisation):
        s = model.realisation
        return [(_poles_of(s.a), _transmission_zeros(s.a, s.b[:, signal], s.c[output], s.d[output, signal]))]
    if isinstance(model, LinearModel):
        return [(np.asarray(model.poles, dtype=np.complex128), np.zeros(0, dtype=np.complex128))]
    return []


def _roots(A: FloatArray, B: FloatArray, signal: int) -> tuple[ComplexArray, ComplexArray]:
    """Of A (na, n_y, n_y) and B (nb, n_y, n_u)."""
    n_y = B.shape[1]
    matrix = np.eye(len(A) * n_y, k=-n_y)
    if len(A):
        matrix[:n_y] = np.hstack(list(A))
    known = n_y == 1
    return _poles_of(matrix), np.roots(B[:, 0, signal] if known else []).astype(np.complex128)


def _poles_of(matrix: FloatArray) -> ComplexArray:
    """Eigenvalues, but those at zero: they are samples of delay."""
    found = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    return found[np.abs(found) > 1e-6]


def _transmission_zeros(a: FloatArray, b: FloatArray, c: FloatArray, d: float) -> ComplexArray:
    """Finite eigenvalues of the system's pencil [a - z I, b; c, d]."""
    n = len(a)
    left = np.block([[a, b[:, None]], [c[None, :], np.array([[d]])]])
    right = np.diag(np.r_[np.ones(n), 0.0])
    found = scipy.linalg.eigvals(left, right)
    return np.asarray(found[np.isfinite(found) & (np.abs(found) < 1e6)], dtype=np.complex128)


def measured_rests(
    data: Dataset, seconds: float, output: int, signal: int, *, at_rest: float = 0.1
) -> FloatArray:
    """(M, 2) mean input and output of stretches of `seconds` in which nothing drifts: measured equilibria.

    Nothing drifts where the mean of every signal over the last third of the stretch lies within a tenth of
    the signal's range (5th to 95th percentile) of that over the first third, and no input moves by more than
    two tenths.

    `at_rest`: share of a signal's range that it may drift by and still be called at rest.
    """
    rows = max(6, round(seconds / data.dt_s))
    third = rows // 3
    every = [np.hstack([s.u, s.y[:, output : output + 1]]) for s in data.segments]
    reach = at_rest * np.ptp(np.percentile(np.concatenate(every), (5.0, 95.0), axis=0), axis=0)
    found = []
    for values in every:
        for start in range(0, len(values) - rows + 1, max(1, rows // 2)):
            piece = values[start : start + rows]
            drift = np.abs(piece[-third:].mean(axis=0) - piece[:third].mean(axis=0))
            swing = np.ptp(piece[:, :-1], axis=0)
            if (drift <= reach).all() and (swing <= 2.0 * reach[:-1]).all():
                found.append((piece[:, signal].mean(), piece[:, -1].mean()))
    return np.array(found).reshape(-1, 2)
