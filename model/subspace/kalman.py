"""States of a linear system in innovation form: estimated from a start, run free, looked ahead.

    x(k+1) = A x(k) + B u(k) + drift + G(k) (y(k) - C x(k) - D u(k) - level)

G(k) is the gain of the time-varying Kalman predictor from the states that training data lead one to expect,
computed by the square-root array algorithm (Kailath, Sayed & Hassibi, 2000, Linear Estimation, 12.3), which
keeps its digits where there is next to no noise; after the start it is the stationary K.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.covariance import root_of
from flysid.model.subspace.triangle import Realisation

QUIET = 1e-8
"""Standard deviation of the innovation, relative to the largest output a state makes, that counts as none."""
STILL = 1e-12
NOTHING = 1e-280
"""Squares below count as none: their reciprocals would overflow."""
LOOK = 200
"""Samples over which a wrong start is felt."""


def start_gains(system: Realisation, most: int) -> tuple[FloatArray, FloatArray]:
    """Gains of the first samples, and how wrong the free run still is after each of them.

    Returns
    -------
    gains : (most, n, n_y).
    spread : (most + 1,) root mean square error of the free run over the next `LOOK` samples for want of the
        right state, in standard deviations of the innovation; the largest over the outputs.
    """
    noise = _noise_root(system)
    gains, roots = _recursion(system, noise, most)
    seen = _observe(system)
    size = np.sqrt(np.sum(noise**2, axis=1))
    spread = [np.max(np.sqrt(np.mean((seen @ r) ** 2, axis=0).sum(axis=-1)) / size) for r in roots]
    return gains, np.array(spread + [spread[-1]] * (most + 1 - len(spread)), dtype=np.float64)


def gains_of(system: Realisation, most: int) -> FloatArray:
    """(most, n, n_y) gains of the first samples alone."""
    return _recursion(system, _noise_root(system), most)[0]


def _recursion(system: Realisation, noise: FloatArray, most: int) -> tuple[FloatArray, list[FloatArray]]:
    """Gains, and the roots of the state's covariance before every sample until the filter is stationary.

    `noise`: (n_y, n_y) root of the innovation's covariance.
    """
    parts = (system.a, system.c, root_of(system.state), noise.T, (system.k @ noise).T)
    gains, roots, count = _gains_kernel()(*(np.ascontiguousarray(p) for p in parts), most)
    return gains, list(roots[:count])


def _observe(system: Realisation) -> FloatArray:
    """(LOOK, n_y, n) what each state adds to the outputs of the next samples; unstable parts are held."""
    rows = np.empty((LOOK, *system.c.shape))
    at = system.c
    radius = max(float(np.abs(np.linalg.eigvals(system.a)).max(initial=0.0)), 1.0)
    for step in range(LOOK):
        rows[step] = at
        at = at @ system.a / radius
    return rows


def _noise_root(system: Realisation) -> FloatArray:
    """(n_y, n_y) root of the innovation's covariance, never singular: see `QUIET`."""
    size = np.sqrt(np.diag(system.c @ system.state @ system.c.T))
    floor = np.diag(np.maximum(QUIET * size, np.finfo(float).tiny) ** 2)
    return root_of(system.innovation + floor)


def free_states(system: Realisation, u: FloatArray, x: FloatArray) -> FloatArray:
    """(N, n) states from x on; not finite where they overflow."""
    n = len(x)
    return _states(system.a, np.zeros((0, n)), u @ system.b.T + system.drift, x, np.zeros((1, n, 0)))[:-1]


def filtered_states(system: Realisation, u: FloatArray, y: FloatArray, gains: FloatArray) -> FloatArray:
    """(N + 1, n) predicted state before every sample and after the last, from zero on.

    `gains`: (m, n, n_y) of the first m samples; K after them.
    """
    miss = y - u @ system.d.T - system.level
    every = np.concatenate([gains, system.k[None]])
    drive = u @ system.b.T + system.drift
    return _states(system.a, system.c, drive, np.zeros(len(system.a)), every, miss)


def _states(
    a: FloatArray,
    c: FloatArray,
    drive: FloatArray,
    x: FloatArray,
    gains: FloatArray,
    miss: FloatArray | None = None,
) -> FloatArray:
    """(N + 1, n) states from x on; without `miss`, and outputs in c and the gains, nothing is measured."""
    nothing = np.zeros((len(drive), 0)) if miss is None else miss
    states: FloatArray = _filter_kernel()(
        *(np.ascontiguousarray(p) for p in (a, c, drive, nothing, x, gains))
    )
    return states


def output_of(system: Realisation, states: FloatArray, u: FloatArray) -> FloatArray:
    """(N, n_y) of states and inputs."""
    y: FloatArray = states @ system.c.T + u @ system.d.T + system.level
    return y


def ahead(system: Realisation, states: FloatArray, u: FloatArray, k: int) -> FloatArray:
    """(N, n_y) prediction of every output from the state k - 1 samples before; NaN in the first k - 1 rows.

    `states`: (N, n) predicted state before every sample.
    """
    out = np.full((len(u), len(system.c)), np.nan)
    if len(u) < k:
        return out
    drive = u @ system.b.T + system.drift
    at = states[: len(u) - k + 1]
    for step in range(k - 1):
        at = at @ system.a.T + drive[step : step + len(at)]
    out[k - 1 :] = output_of(system, at, u[k - 1 :])
    return out


def resting_state(system: Realisation, u: FloatArray, y: FloatArray) -> FloatArray:
    """(n,) the state in which constant inputs u hold the outputs y: the nearest there is."""
    n = len(system.a)
    matrix = np.vstack([np.eye(n) - system.a, system.c])
    goal = np.concatenate([system.b @ u + system.drift, y - system.d @ u - system.level])
    state: FloatArray = np.linalg.lstsq(matrix, goal, rcond=1e-12)[0]
    return state


@cache
def _gains_kernel() -> Any:
    from flysid.compiling import njit

    @njit(cache=True, error_model="numpy")
    def run(
        a: FloatArray, c: FloatArray, first: FloatArray, noise: FloatArray, moved: FloatArray, most: int
    ) -> tuple[FloatArray, FloatArray, int]:
        n_y, n = c.shape
        gains = np.zeros((most, n, n_y))
        roots = np.zeros((most + 1, n, n))
        R = np.empty((n_y + n, n_y + n))
        for i in range(n):
            for j in range(n):
                roots[0, i, j] = first[i, j]
        count = 1
        for step in range(most):
            root = roots[count - 1]
            for o in range(n_y):
                for i in range(n_y + n):
                    R[o, i] = noise[o, i] if i < n_y else moved[o, i - n_y]
            for q in range(n):
                for i in range(n_y + n):
                    total = 0.0
                    for j in range(n):
                        total += (c[i, j] if i < n_y else a[i - n_y, j]) * root[j, q]
                    R[n_y + q, i] = total
            for j in range(
                n_y + n - 1
            ):  # the triangle of R = Q R in place, by reflections (Householder, 1958)
                square = 0.0
                for i in range(j + 1, n_y + n):
                    square += R[i, j] * R[i, j]
                if square < NOTHING:
                    continue
                length = math.copysign(math.sqrt(square + R[j, j] * R[j, j]), R[j, j])
                pivot = R[j, j] + length
                scale = 2.0 / (square + pivot * pivot)
                for q in range(j + 1, n_y + n):
                    along = pivot * R[j, q]
                    for i in range(j + 1, n_y + n):
                        along += R[i, j] * R[i, q]
                    along *= scale
                    R[j, q] -= along * pivot
                    for i in range(j + 1, n_y + n):
                        R[i, q] -= along * R[i, j]
                R[j, j] = -length
            largest = 0.0
            change = 0.0
            for i in range(n):
                for o in range(n_y - 1, -1, -1):
                    value = R[o, n_y + i]
                    for p in range(o + 1, n_y):
                        value -= R[o, p] * gains[step, i, p]
                    gains[step, i, o] = value / R[o, o]
                    largest = max(largest, abs(gains[step, i, o]))
                    if step:
                        change = max(change, abs(gains[step, i, o] - gains[step - 1, i, o]))
            if step and change <= STILL * largest:  # the filter is stationary: every step is as the last
                for later in range(step + 1, most):
                    for i in range(n):
                        for o in range(n_y):
                            gains[later, i, o] = gains[step, i, o]
                break
            for i in range(n):
                for j in range(n):
                    roots[count, i, j] = R[n_y + j, n_y + i] if j <= i else 0.0
            count += 1
        return gains, roots, count

    return run


@cache
def _filter_kernel() -> Any:
    from flysid.compiling import njit

    @njit(cache=True)
    def run(
        a: FloatArray, c: FloatArray, drive: FloatArray, miss: FloatArray, x: FloatArray, gains: FloatArray
    ) -> FloatArray:
        rows, n = drive.shape
        n_y = c.shape[0]
        last = len(gains) - 1
        states = np.empty((rows + 1, n))
        for i in range(n):
            states[0, i] = x[i]
        e = np.empty(n_y)
        for k in range(rows):
            at = min(k, last)
            for o in range(n_y):
                e[o] = miss[k, o]
                for j in range(n):
                    e[o] -= c[o, j] * states[k, j]
            for i in range(n):
                value = drive[k, i]
                for j in range(n):
                    value += a[i, j] * states[k, j]
                for o in range(n_y):
                    value += gains[at, i, o] * e[o]
                states[k + 1, i] = value
        return states

    return run
