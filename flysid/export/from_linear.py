"""Linear models as programs: in balanced states, whose rounding errors neither grow nor cancel.

A difference equation of high order at a fast rate has lags that all but cancel: in float32 one of order four
can leave the stable ones (its coefficients, rounded, have other poles). In balanced coordinates (Moore, 1981)
every state is as easy to reach as to see; Laub et al. (1987) compute them from square roots of the Gramians,
so that nothing is inverted and states that nothing reaches or shows fall away. On the way there the equation
is written in z - 1 instead of z, with exact rational numbers: what the lags cancel to stands there by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.export.from_rules import hidden_names
from flysid.export.program import BOUND, AffinePast, Program
from flysid.model.freerun import Difference
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.rules.kernel import Lags
from flysid.model.structures import row_of
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.subspace.kalman import filtered_states, resting_state


@dataclass(frozen=True, eq=False)
class _States:
    """x(k+1) = A x(k) + B u(k) + f, y(k) = C x(k) + D u(k) + g in deviations, and x(0) at rest.

    `late`: samples by which every input is late before it enters.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    f: FloatArray
    g: FloatArray
    rest: FloatArray
    late: tuple[int, ...]


def linear_program(model: FittedLinear) -> Program:
    """A difference equation: balanced, or as it is where outputs do not depend on past ones."""
    if not model.system.a[1:].any() or not model.system.b.any():
        return _in_lags(model)
    states, coordinates = _of_difference(model)
    balanced, into = _balance(states)

    def find_past() -> AffinePast:
        effect = _late_effect(model.system, balanced.late, model.n_init)

        def state_after(du: FloatArray, dy: FloatArray) -> FloatArray:
            entered = _difference_state(model, du, dy) - np.einsum("iorj,rj->io", effect, du)
            return np.asarray(into @ coordinates(entered))

        return _affine_past(model, balanced.late, state_after)

    return _program(model, balanced, find_past)


def state_space_program(model: FittedStateSpace) -> Program:
    """A state space, balanced."""
    s = model.realisation
    rest = resting_state(s, -model.u_origin, -model.y_origin)
    late = model.delays or (0,) * len(model.inputs)
    balanced, into = _balance(_States(s.a, s.b, s.c, s.d, s.drift, s.level, rest, late))

    def state_after(du: FloatArray, dy: FloatArray) -> FloatArray:
        return np.asarray(into @ filtered_states(s, model.late(du), dy, model.gains)[-1])

    return _program(model, balanced, lambda: _affine_past(model, late, state_after))


def _affine_past(
    model: FittedLinear | FittedStateSpace,
    late: tuple[int, ...],
    state_after: Callable[[FloatArray, FloatArray], FloatArray],
) -> AffinePast:
    """Memory after the samples that start a simulation.

    `state_after`: the state after deviations (n_init, n_u), (n_init, n_y), an affine function of them.
    """
    rows = model.n_init
    n_u = len(model.inputs)
    n_y = len(model.outputs)

    def memory_after(window: FloatArray) -> FloatArray:
        du = window[: rows * n_u].reshape(rows, n_u)
        dy = window[rows * n_u :].reshape(rows, n_y)
        before = [
            du[rows - lag, j] if lag <= rows else 0.0 for j in range(n_u) for lag in range(1, late[j] + 1)
        ]
        return np.concatenate([before, state_after(du, dy)])

    unit = np.eye(rows * (n_u + n_y))
    level = memory_after(np.zeros(len(unit)))
    return AffinePast(rows, np.column_stack([*(memory_after(window) - level for window in unit), level]))


def _difference_state(model: FittedLinear, du: FloatArray, dy: FloatArray) -> FloatArray:
    """(depth, n_y) state after the samples that start a simulation."""
    first, start = model.begin(du, dy)
    if first == len(du):
        return start
    state = model.system.state(du, model.system.run(du, start))
    state[: max(len(state) - len(du), 0)] += start[len(du) :]
    return state


def _late_effect(system: Difference, late: tuple[int, ...], rows: int) -> FloatArray:
    """(depth, n_y, rows, n_u) what the last inputs, not yet entered, add to the state.

    In the program they stand in cells of their own.
    """
    effect = np.zeros((system.depth, system.b.shape[1], rows, len(late)))
    for j, samples in enumerate(late):
        for i in range(system.depth):
            for ahead in range(
                max(samples - rows, 0), min(samples, i + 1)
            ):  # it enters so many samples later
                lag = i - ahead + samples
                if lag < len(system.b):
                    effect[i, :, rows + ahead - samples, j] = system.b[lag, :, j]
    return effect


def _of_difference(model: FittedLinear) -> tuple[_States, Callable[[FloatArray], FloatArray]]:
    """The observer form in z - 1, without the samples by which inputs are late.

    And what makes its state of that of the equation without them.

    The constant is one more input, and the state at rest one more column: its polynomial moves as theirs do.
    """
    system = model.system
    n_y = len(model.outputs)
    n_u = len(model.inputs)
    taps = np.concatenate([system.b, np.zeros((len(system.b), n_y, 1))], axis=2)
    taps[0, :, -1] = system.c
    late = tuple(_first(taps[:, :, j]) for j in range(taps.shape[2]))
    early = np.zeros_like(taps)
    for j, k in enumerate(late):
        early[: len(taps) - k, :, j] = taps[k:, :, j]
    last = max([0, *np.flatnonzero(early.any(axis=(1, 2)))])
    moved = Difference(system.a, early[: last + 1], np.zeros(n_y))
    depth = moved.depth
    before = np.tile(np.append(-model.u_origin, 0.0), (depth, 1))
    rest = moved.state(before, np.tile(-model.y_origin, (depth, 1)))
    a = _rational(system.a, depth + 1)
    b = _rational(moved.b, depth + 1)
    direct = moved.b[0]
    proper = b[1:] - np.einsum("lij,jk->lik", a[1:], b[0])
    polynomials = np.concatenate([proper, _rational(rest[:, :, None], depth)], axis=2)
    inner = _about_one(polynomials).reshape(depth * n_y, n_u + 2)
    step = np.eye(depth * n_y, k=n_y)
    step[:, :n_y] -= _about_one(a)[1:].reshape(depth * n_y, n_y)
    step, scaling = _scale(step)
    inner /= scaling[:, None]
    show = np.eye(n_y, depth * n_y) * scaling

    def coordinates(state: FloatArray) -> FloatArray:
        return np.asarray(_about_one(_rational(state[:depth], depth)).ravel() / scaling)

    states = _States(
        np.eye(len(step)) + step,
        inner[:, :n_u],
        show,
        direct[:, :n_u],
        inner[:, n_u],
        direct[:, n_u],
        inner[:, n_u + 1],
        late[:n_u],
    )
    return states, coordinates


def _rational(values: FloatArray, count: int) -> Any:
    """(count, ...) the same numbers as fractions, zeros behind."""
    padded = np.zeros((count, *values.shape[1:]))
    padded[: len(values)] = values
    return np.vectorize(Fraction, otypes=[object])(padded)


def _about_one(coefficients: Any) -> FloatArray:
    """Coefficients in falling powers of z - 1 of a polynomial in falling powers of z, both monic."""
    shifted = coefficients.copy()
    for last in range(len(shifted), 1, -1):  # Horner's scheme, once for every power
        for i in range(1, last):
            shifted[i] = shifted[i] + shifted[i - 1]
    return np.asarray(shifted, dtype=np.float64)


def _scale(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """D^-1 matrix D with rows and columns of like size, and the diagonal of D, powers of two."""
    from scipy.linalg import matrix_balance

    scaled, (diagonal, _) = matrix_balance(matrix, permute=False, separate=True)
    return np.asarray(scaled), np.asarray(diagonal)


def _first(taps: FloatArray) -> int:
    """The first lag with a coefficient that is not zero; 0 where there is none."""
    return int(np.argmax(taps.any(axis=1)))


def _balance(s: _States, *, negligible: float = 1e-11, margin: float = 0.001) -> tuple[_States, FloatArray]:
    """The same system in balanced coordinates, without states that nothing reaches or shows.

    And the matrix that takes its states into them.

    `negligible`: of the largest Hankel singular value: what rounding leaves of a state that is not there.

    `margin`: by which an unstable matrix is drawn inside the unit circle to be balanced.
    """
    radius = float(np.abs(np.linalg.eigvals(s.a)).max(initial=0.0))
    inside = s.a / max(1.0, radius / (1.0 - margin))
    drive = np.column_stack([s.b, s.f, s.rest])
    drive = drive / _size(drive, axis=0)
    show = s.c / _size(s.c, axis=1)
    reached = _gramian_root(inside, drive)
    seen = _gramian_root(inside.T, show.T)
    left, values, right = np.linalg.svd(seen.T @ reached)
    kept = values > negligible * values.max(initial=0.0)
    weight = 1.0 / np.sqrt(values[kept])
    into = weight[:, None] * (left[:, kept].T @ seen.T)
    back = reached @ right[kept].T * weight
    balanced = replace(s, a=into @ s.a @ back, b=into @ s.b, c=s.c @ back, f=into @ s.f, rest=into @ s.rest)
    return balanced, into


def _size(values: FloatArray, axis: int) -> FloatArray:
    size = np.linalg.norm(values, axis=axis, keepdims=True)
    return np.where(size > 0.0, size, 1.0)


def _gramian_root(a: FloatArray, b: FloatArray, *, gone: float = 1e-30) -> FloatArray:
    """L with L L' = sum over k of a^k b b' a'^k, a inside the unit circle.

    Every pass doubles the powers in the sum (Smith's iteration), and QR keeps their square root: to form the
    sum itself would lose half of the digits.

    `gone`: of a power of a matrix: it adds nothing more.
    """
    root = b
    while np.abs(a).max(initial=0.0) > gone:
        triangle: Any = np.linalg.qr(np.hstack([root, a @ root]).T, mode="r")
        root = triangle.T
        a = a @ a
    return np.asarray(root)


def _program(
    model: FittedLinear | FittedStateSpace, s: _States, find_past: Callable[[], AffinePast]
) -> Program:
    n = len(s.a)
    n_y = len(model.outputs)
    n_u = len(model.inputs)
    columns = [*range(n_y, n_y + n), *range(n_y + n, n_y + n + n_u), -1]
    delays = [*[1] * n, *s.late, 0]
    theta = np.block([[s.c, s.d, s.g[:, None]], [s.a, s.b, s.f[:, None]]])
    rest = np.zeros((n_y + n + n_u, max([1, *s.late])))
    rest[n_y : n_y + n, 0] = s.rest
    return _linear(model, columns, delays, theta, rest, find_past)


def _in_lags(model: FittedLinear) -> Program:
    """Outputs that depend on inputs alone, or on outputs alone: taps over lags."""
    system = model.system
    n_y = len(model.outputs)
    n_u = len(model.inputs)
    past = [(lag, i) for i in range(n_y) for lag in 1 + np.flatnonzero(system.a[1:, :, i].any(axis=1))]
    taps = [(lag, j) for j in range(n_u) for lag in np.flatnonzero(system.b[:, :, j].any(axis=1))]
    columns = [*(i for _, i in past), *(n_y + j for _, j in taps)]
    delays = [int(lag) for lag, _ in (*past, *taps)]
    weights = [*(-system.a[lag, :, i] for lag, i in past), *(system.b[lag, :, j] for lag, j in taps)]
    rest = np.zeros((n_y + n_u, max(len(system.a), len(system.b))))
    rest[:n_y] = -model.y_origin[:, None]
    return _linear(model, [*columns, -1], [*delays, 0], np.stack([*weights, system.c], axis=1), rest)


def _linear(
    model: FittedLinear | FittedStateSpace,
    columns: list[int],
    delays: list[int],
    theta: FloatArray,
    rest: FloatArray,
    find_past: Callable[[], AffinePast] | None = None,
) -> Program:
    none = np.zeros(0, dtype=np.int64)
    n = len(theta)
    n_u = len(model.inputs)
    n_y = len(model.outputs)
    inner = n - n_y
    rest[n:] = -model.u_origin[:, None]
    return Program(
        title=f"{row_of(model.structure).title}, {inner} state{'s' if inner != 1 else ''}",
        dt_s=model.dt_s,
        inputs=model.inputs,
        outputs=model.outputs,
        states=(*model.outputs, *hidden_names(inner)),
        lags=Lags(np.array(columns, dtype=np.int64), np.array(delays, dtype=np.int64), none, none, none),
        theta=theta[None],
        memberships=None,
        limits=np.stack([np.full(n, -BOUND), np.full(n, BOUND)]),
        shift=np.concatenate([model.y_origin, np.zeros(inner), model.u_origin]),
        scale=np.ones(n + n_u),
        output_limits=model.output_limits,
        rest=rest,
        find_past=find_past,
    )
