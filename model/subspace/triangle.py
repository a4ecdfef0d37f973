"""Subspace identification from the triangle of lagged signals: state space without a search.

    x(k+1) = A x(k) + B u(k) + K e(k) + drift,    y(k) = C x(k) + D u(k) + level + e(k)

Every method estimates M, which maps the past z = (y, u) to what the past contributes to future outputs; the
state is a projection of the past, x = T z, found by a singular value decomposition of M (weighted):

- "pbsid": M from a long ARX model (Chiuso, 2007, Automatica 43, the optimised predictor-based method); right
  also where u is fed back from y;
- "n4sid", "moesp", "cva": M by oblique projection along the future inputs (Van Overschee & De Moor, 1996,
  Subspace Identification for Linear Systems, ch. 4; Verhaegen, 1994; Larimore, 1990); biased in closed loop.

All of it is small linear algebra on the triangle R of all lags (`gram.lagged_triangle`): one pass over the
data, whatever their length, and several methods, horizons and orders from the same pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.gram import Triangle, lagged_triangle
from flysid.model.linear.data import EXACT, Scaling
from flysid.model.polynomials import RCOND
from flysid.model.stream import Source, blocks_of

Method: TypeAlias = Literal["pbsid", "n4sid", "moesp", "cva"]
METHODS: tuple[Method, ...] = ("pbsid", "n4sid", "moesp", "cva")


@dataclass(frozen=True, eq=False)
class Realisation:
    """A linear system in innovation form, of order n.

    `a`, `b`, `c`, `d`, `k`: (n, n), (n, n_u), (n_y, n), (n_y, n_u), (n, n_y).
    `drift`, `level`: (n,), (n_y,) constants of the state and of the output.
    `innovation`: (n_y, n_y) covariance of e.
    `state`: (n, n) covariance of the states seen.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    k: FloatArray
    drift: FloatArray
    level: FloatArray
    innovation: FloatArray
    state: FloatArray

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.a)

    def in_units(self, scaling: Scaling) -> Realisation:
        """The same system for inputs and outputs in physical units, still around the origins."""
        y = scaling.y_scale
        u = scaling.u_scale
        return Realisation(
            a=self.a,
            b=self.b / u,
            c=self.c * y[:, None],
            d=self.d * y[:, None] / u,
            k=self.k / y,
            drift=self.drift,
            level=self.level * y,
            innovation=self.innovation * np.outer(y, y),
            state=self.state,
        )


def subspace(
    u: Sequence[FloatArray],
    y: Sequence[FloatArray],
    order: int,
    *,
    method: Method = "pbsid",
    past: int | None = None,
    feedthrough: bool = True,
) -> Realisation:
    """Identify a state-space model of given order from segments; means are taken out first.

    Parameters
    ----------
    u, y : one (N, n_u) and (N, n_y) array per segment.
    past : samples that the state is estimated from; None chooses (`default_past`).
    feedthrough : estimate D; zero otherwise.

    Returns
    -------
    The system in physical units for deviations from the means of all samples (`level`, `drift` around them).

    Raises
    ------
    DataError : segments too short, a signal that never changes. FitError : the order exceeds what the data
        show. UsageError : the order or the method cannot be.
    """
    data = Dataset.from_arrays(list(u), list(y), 1.0)
    scaling = Scaling.of(data)
    n_y = len(data.outputs)
    n_u = len(data.inputs)
    past = past or default_past(order, n_y, n_u, [len(s) for s in data.segments])
    triangle = triangle_for(data, scaling, window(past, method))
    projection = project(Columns.of(triangle, (n_y, n_u), past, method, feedthrough=feedthrough), method)
    return projection.realise(order).in_units(scaling)


def default_past(order: int, n_y: int, n_u: int, lengths: Sequence[int]) -> int:
    """Samples to look back on: twice the order and at least 10, where the segments allow."""
    columns = n_y + n_u
    affordable = sum(lengths) // (10 * columns)
    return max(order // n_y + 1, min(max(2 * order, 10), affordable, max(lengths) // 4), 1)


def window(past: int, method: Method) -> int:
    """The deepest lag that a method needs."""
    return past if method == "pbsid" else 2 * past - 1


def triangle_for(data: Source, scaling: Scaling, depth: int) -> Triangle:
    """The triangle of all lags of a dataset in scaled deviations."""
    origin = np.concatenate([scaling.y_origin, scaling.u_origin])
    scale = np.concatenate([scaling.y_scale, scaling.u_scale])
    return lagged_triangle(blocks_of(data, origin), depth, scale)


@dataclass(frozen=True, eq=False)
class Columns:
    """Which columns of the triangle hold what; outputs first, each signal's lags 0..depth."""

    r: FloatArray
    rows: int
    n_y: int
    n_u: int
    past: int
    now: int
    feedthrough: bool = True

    @classmethod
    def of(
        cls, triangle: Triangle, signals: tuple[int, int], past: int, method: Method, *, feedthrough: bool
    ) -> Columns:
        """For a triangle of all lags 0..depth, depth at least `window(past, method)`; signals (n_y, n_u).

        Raises UsageError: an unknown method.
        """
        if method not in METHODS:
            raise UsageError(f"there is no subspace method {method!r}", hint=f"one of {', '.join(METHODS)}")
        now = 0 if method == "pbsid" else past - 1
        return cls(triangle.r, triangle.rows, *signals, past, now, feedthrough)

    @property
    def _step(self) -> int:
        return (len(self.r.T) - 1) // (self.n_y + self.n_u)

    def _at(self, signals: range, lags: Sequence[int]) -> FloatArray:
        """Lag by lag, the signals side by side."""
        return self.r[:, [j * self._step + lag for lag in lags for j in signals]]

    @property
    def before(self) -> FloatArray:
        """The past of now: (y, u) one sample back, two back, ..."""
        both = range(self.n_y + self.n_u)
        return self._at(both, range(self.now + 1, self.now + self.past + 1))

    @property
    def before_next(self) -> FloatArray:
        """The `past` samples of outputs and inputs before the next one."""
        return self._at(range(self.n_y + self.n_u), range(self.now, self.now + self.past))

    @property
    def outputs(self) -> FloatArray:
        """Outputs of the present sample."""
        return self._at(range(self.n_y), [self.now])

    @property
    def inputs(self) -> FloatArray:
        """Inputs of the present sample."""
        return self._at(range(self.n_y, self.n_y + self.n_u), [self.now])

    @property
    def direct(self) -> FloatArray:
        """The inputs that reach the output in the same sample: all, or none."""
        return self.inputs if self.feedthrough else self.inputs[:, :0]

    @property
    def future_outputs(self) -> FloatArray:
        """Outputs from the present sample on."""
        return self._at(range(self.n_y), range(self.now, -1, -1))

    @property
    def future_inputs(self) -> FloatArray:
        """Inputs from the present sample on."""
        return self._at(range(self.n_y, self.n_y + self.n_u), range(self.now, -1, -1))

    @property
    def one(self) -> FloatArray:
        """The constant."""
        return self.r[:, -1:]


@dataclass(frozen=True, eq=False)
class Projection:
    """The singular value decomposition behind a method: every order is read off it.

    `singular_values`: of the weighted map from the past to the future, largest first.
    """

    columns: Columns
    method: Method
    mapping: FloatArray
    left: FloatArray
    unweight: FloatArray
    singular_values: FloatArray

    @property
    def most(self) -> int:
        """The highest order that the data show at all."""
        values = self.singular_values
        rank = int(np.count_nonzero(values > 1e-10 * values[0])) if len(values) and values[0] > 0 else 0
        return min(rank, len(self.left) - self.columns.n_y)

    def realise(self, order: int) -> Realisation:
        """The system of that order, for scaled deviations.

        Raises UsageError: the order is not positive. Raises FitError: it exceeds `most`.
        """
        if order < 1:
            raise UsageError(f"a state-space model has an order of at least 1, not {order}")
        if order > self.most:
            raise FitError(
                f"order {order} was asked for; the data and {self.columns.past} samples of past show"
                f" {self.most} at most",
                hint="choose a smaller order, or look back on more samples",
            )
        left = self.left[:, :order]
        states = left.T @ np.linalg.solve(self.unweight, self.mapping)
        now = self.columns.before @ states.T
        following = self.columns.before_next @ states.T
        size = np.linalg.norm(now, axis=0) / np.sqrt(self.columns.rows)
        now = now / size
        following = following / size
        if self.method == "moesp":
            gamma = (self.unweight @ left) * size
            return _by_shifts(self.columns, gamma, now, following)
        return _by_states(self.columns, now, following)


def project(columns: Columns, method: Method) -> Projection:
    """The map from the past to the future, weighted as the method says, and its singular values.

    Raises DataError: fewer samples than unknowns.
    """
    n_y = columns.n_y
    n_u = columns.n_u
    past = columns.past
    now = columns.now
    unknowns = past * (n_y + n_u) + (now + 1) * n_u + 1
    if columns.rows <= unknowns + n_y:
        raise DataError(
            f"{columns.rows} windows of {past + now + 1} samples are too few for {unknowns} unknowns",
            hint="look back on fewer samples, or bring longer segments",
        )
    if method == "pbsid":
        mapping, unweight = _from_long_regression(columns)
        spread = _without(columns.one, columns.before)
    else:
        mapping, unweight, spread = _oblique(columns, method)
    left, values, _ = np.linalg.svd(np.linalg.solve(unweight, mapping @ spread.T), full_matrices=False)
    return Projection(columns, method, mapping, left, unweight, values)


def _regress(regressors: Sequence[FloatArray], target: FloatArray) -> FloatArray:
    """(sum of columns, m) least squares; directions that are rounding get nothing."""
    return np.asarray(np.linalg.lstsq(np.hstack(list(regressors)), target, rcond=RCOND)[0], dtype=np.float64)


def _without(known: FloatArray, rest: FloatArray) -> FloatArray:
    """The triangle of `rest` after projecting `known` out."""
    r = np.asarray(np.linalg.qr(np.hstack([known, rest]), mode="r"))
    return r[known.shape[1] :, known.shape[1] :]


def _from_long_regression(columns: Columns) -> tuple[FloatArray, FloatArray]:
    """What the past of a long ARX model adds to each future output, and the root of its noise covariance."""
    n_y = columns.n_y
    past = columns.past
    n_z = columns.n_y + columns.n_u
    regressors = [columns.before, columns.direct, columns.one]
    theta = _regress(regressors, columns.outputs)
    residual = columns.outputs - np.hstack(regressors) @ theta
    taps = theta[: past * n_z].T.reshape(n_y, past, n_z)
    mapping = np.zeros((past, n_y, past, n_z))
    for ahead in range(past):
        mapping[ahead, :, : past - ahead] = taps[:, ahead:]
    root = _root(residual.T @ residual / columns.rows)
    unweight: FloatArray = np.asarray(np.kron(np.eye(past), root), dtype=np.float64)
    return mapping.reshape(past * n_y, past * n_z), unweight


def _root(covariance: FloatArray) -> FloatArray:
    """A symmetric root, floored where there is no noise."""
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = (vectors * np.sqrt(np.maximum(values, EXACT**2))) @ vectors.T
    return root


def _oblique(columns: Columns, method: Method) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The oblique projection of the future outputs along the future inputs on the past, and its weights."""
    known = np.hstack([columns.one, columns.future_inputs])
    theta = _regress([known, columns.before], columns.future_outputs)
    mapping = theta[known.shape[1] :].T
    unweight = np.eye(len(mapping))
    if method == "n4sid":
        return mapping, unweight, _without(columns.one, columns.before)
    if method == "cva":
        free = _without(known, columns.future_outputs)
        unweight = _root(free.T @ free / columns.rows)
    return mapping, unweight, _without(known, columns.before)


def _by_states(columns: Columns, now: FloatArray, following: FloatArray) -> Realisation:
    """Regression on the estimated states: outputs on states and inputs, next states on these and on e."""
    n = now.shape[1]
    n_u = columns.n_u
    seen = [now, columns.direct, columns.one]
    theta = _regress(seen, columns.outputs)
    e = columns.outputs - np.hstack(seen) @ theta
    regressors = [now, columns.inputs, columns.one]
    rho = _regress(regressors, following)
    error = following - np.hstack(regressors) @ rho
    a = rho[:n].T
    c = theta[:n].T
    k, innovation = _gain(a, c, error, e, columns.rows)
    return Realisation(
        a=a,
        b=rho[n : n + n_u].T,
        c=c,
        d=theta[n:-1].T if columns.feedthrough else np.zeros((columns.n_y, n_u)),
        k=k,
        drift=rho[-1],
        level=theta[-1],
        innovation=innovation,
        state=now.T @ now / columns.rows,
    )


def _by_shifts(columns: Columns, gamma: FloatArray, now: FloatArray, following: FloatArray) -> Realisation:
    """A and C from the shifts of the observability matrix, B and D from what it cannot explain."""
    n_y = columns.n_y
    c = gamma[:n_y]
    a = _regress([gamma[:-n_y]], gamma[n_y:])
    b, d = _input_matrices(columns, gamma)
    e = columns.outputs - now @ c.T - columns.inputs @ d.T
    error = following - now @ a.T - columns.inputs @ b.T
    one = columns.one
    level, drift = (_regress([one], rest)[0] for rest in (e, error))
    k, innovation = _gain(a, c, error - one * drift, e - one * level, columns.rows)
    return Realisation(a, b, c, d, k, drift, level, innovation, now.T @ now / columns.rows)


def _input_matrices(columns: Columns, gamma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """B and D from the outputs outside the range of Gamma, which only the inputs explain (linear in both)."""
    n_y = columns.n_y
    n_u = columns.n_u
    n = len(gamma.T)
    known = np.hstack([columns.one, columns.future_inputs])
    response = _regress([known, columns.before], columns.future_outputs)[1 : known.shape[1]]
    outside: FloatArray = np.asarray(np.linalg.svd(gamma)[0][:, n:].T)
    steps = len(gamma) // n_y
    left: list[FloatArray] = []
    right: list[FloatArray] = []
    for step in range(steps):  # block column `step` of the response: D, then C A^i B below it
        rest = outside[:, step * n_y :]
        below = rest[:, n_y:] @ gamma[: (steps - step - 1) * n_y]
        left.append(np.hstack([rest[:, :n_y], below]))
        right.append(outside @ response[step * n_u : (step + 1) * n_u].T)
    matrix = np.vstack(left)
    target = np.vstack(right)
    if not columns.feedthrough:
        none: FloatArray = np.zeros((n_y, n_u))
        return _regress([matrix[:, n_y:]], target), none
    both: FloatArray = _regress([matrix], target)
    return both[n_y:], both[:n_y]


def _gain(
    a: FloatArray, c: FloatArray, error: FloatArray, e: FloatArray, rows: int
) -> tuple[FloatArray, FloatArray]:
    """Innovation gain K and covariance of e from the residuals of the state and of the output.

    The regression of one on the other; where that predictor would not be stable, the stationary Kalman gain.
    """
    innovation = e.T @ e / rows
    if innovation.diagonal().max() < EXACT**2:
        return np.zeros((len(a), len(c))), innovation
    k = _regress([e], error).T
    if np.abs(np.linalg.eigvals(a - k @ c)).max() < 1.0:
        return k, innovation
    return kalman_gain(a, c, error.T @ error / rows, error.T @ e / rows, innovation), innovation


def kalman_gain(a: FloatArray, c: FloatArray, q: FloatArray, s: FloatArray, r: FloatArray) -> FloatArray:
    """(n, n_y) stationary gain of the predictor for process noise q, output noise r and cross covariance s.

    Zero where the Riccati equation has no stabilising solution (no noise reaches an unstable state).
    """
    from scipy.linalg import solve_discrete_are

    n = len(a)
    floor = EXACT**2
    try:
        p = solve_discrete_are(a.T, c.T, q + floor * np.eye(n), r + floor * np.eye(len(c)), s=s)
    except (np.linalg.LinAlgError, ValueError):
        return np.zeros((n, len(c)))
    gain: FloatArray = np.linalg.solve((c @ p @ c.T + r + floor * np.eye(len(c))).T, (a @ p @ c.T + s).T).T
    return gain
