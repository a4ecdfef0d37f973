"""Compiled: free runs of rules, their exact sensitivities, and the descent on the simulation error.

All signals stand in one matrix W (N, n + n_u), simulated quantities first, in normalised units: the n outputs
of a model over lags, or the n states, outputs first, of one with hidden states. A regressor is a column of W
at a lag, an antecedent variable z is one too, or the difference of two lags. With the firing strengths phi_r
of the paper's eq. (2) and (7),

    x(k) = sum_r phi_r(z(k)) theta_r w(k),    phi_r = w_r / sum w,    log w_r = -1/2 sum ((z-c_r)/s_r)^2

The sensitivity S(k) = dx(k)/dp obeys the same recursion as the model, driven by the direct derivative:

    S(k) = df/dp + sum_l (df/dx(k-l)) S(k-l)

which is exact, costs one pass, needs no tape and only a ring of as many past rows as the deepest lag. z is
clamped a little beyond the range seen in training, so that far away the nearest rules speak and nothing wakes
a distant wide one; simulated quantities are clamped to their limits, so that every run is finite.

Everything here is plain loops over scalars, with one signature each: slices, broadcasting and linear algebra
would take most of the time that compiling takes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from flysid.dataset import FloatArray

IntArray = npt.NDArray[np.int64]

HOLD = 3.0  # weight on memberships, relative to the ridge on consequents
_NARROWEST, _WIDEST = 0.02, 3.0  # widths in ranges of the antecedent: sets that words can name
_MOST_LOG_WIDTH = 30.0
_FIRST_DAMPING, _LARGEST_DAMPING, _SMALLEST_DAMPING = 1e-3, 1e16, 1e-24
_SMALLEST_RELAXATION = 0.1


class Lags(NamedTuple):
    """Where regressors and antecedents stand in W; named tuples pass into compiled code as they are.

    Attributes
    ----------
    column, lag : (n_x,) column of W and lag in samples; column -1 is the constant 1.
    z_column, z_lag : (n_z,) the antecedent variables.
    z_minus : (n_z,) lag that is subtracted (a difference), or -1 for none.
    """

    column: IntArray
    lag: IntArray
    z_column: IntArray
    z_lag: IntArray
    z_minus: IntArray


class Parameters(NamedTuple):
    """The numbers of a TS model in normalised units; all arrays C-contiguous and writable.

    Attributes
    ----------
    theta : (R, n, n_x) consequents.
    centre, width : (R, n_z) Gaussian memberships.
    z_range : (2, n_z) antecedents are clamped to this range.
    limits : (2, n) simulated quantities are clamped to these limits.
    """

    theta: FloatArray
    centre: FloatArray
    width: FloatArray
    z_range: FloatArray
    limits: FloatArray


class Fixed(NamedTuple):
    """What a descent does not move.

    Attributes
    ----------
    basis, offset : (n_b, n_x), (n, n_x); consequents are offset + a @ basis.
    metric : (n n_b, n n_b) weight of a departure of one rule's coordinates from the mean of all.
    centre, width : (R, n_z) memberships that the ridge holds on to.
    z_known : (2, n_z) range within which centres stay.
    chosen : (C,) indices into [a | centre | log width], ascending, of the numbers that move.
    W : (rows, n + n_u) all runs one below the other; only the first n_y and the input columns are data.
    edges : (S + 1,) first row of every run, and the row after the last.
    stress : (M, n + n_u) inputs under which outputs must stay in their range; no rows where none.
    likely, weight : (q,) and (q, q); a run's start x adds (x - likely)' weight (x - likely) to the cost.
    """

    basis: FloatArray
    offset: FloatArray
    metric: FloatArray
    centre: FloatArray
    width: FloatArray
    z_known: FloatArray
    chosen: IntArray
    W: FloatArray
    edges: IntArray
    stress: FloatArray
    likely: FloatArray
    weight: FloatArray


class Sizes(NamedTuple):
    """Attributes
    ----------
    depth : first simulated row of a run.
    moving : rows before it that are unknowns, the start of a run.
    n_y : columns that are compared with data.
    samples : compared numbers.
    ridge : weight on departures.
    """

    depth: int
    moving: int
    n_y: int
    samples: float
    ridge: float


class Normal(NamedTuple):
    """A Gauss-Newton matrix with a border (`flysid.model.bordered`), and half the gradient.

    Attributes
    ----------
    corner : (C, C); border : (S, C, q); blocks : (S, q, q); slope : (C + S q,).
    """

    corner: FloatArray
    border: FloatArray
    blocks: FloatArray
    slope: FloatArray


compiled = njit(cache=True, error_model="numpy")


@compiled
def _regress(W, k, lags, x):  # type: ignore[no-untyped-def]
    for m in range(x.size):
        c = lags.column[m]
        x[m] = 1.0 if c < 0 else W[k - lags.lag[m], c]


@compiled
def _antecedents(W, k, lags, par, z):  # type: ignore[no-untyped-def]
    for j in range(z.size):
        value = W[k - lags.z_lag[j], lags.z_column[j]]
        if lags.z_minus[j] >= 0:
            value -= W[k - lags.z_minus[j], lags.z_column[j]]
        z[j] = min(max(value, par.z_range[0, j]), par.z_range[1, j])


@compiled
def _fire(z, par, phi):  # type: ignore[no-untyped-def]
    top = -1e300
    for r in range(phi.size):
        log_w = 0.0
        for j in range(z.size):
            d = (z[j] - par.centre[r, j]) / par.width[r, j]
            log_w -= 0.5 * d * d
        phi[r] = log_w
        top = max(top, log_w)
    total = 0.0
    for r in range(phi.size):
        gap = phi[r] - top
        phi[r] = math.exp(gap) if gap > -40.0 else 0.0  # 4e-18: below the rounding of the sum
        total += phi[r]
    for r in range(phi.size):
        phi[r] = phi[r] / total if total > 0.0 else 1.0 / phi.size  # 0 only where z is not a number


@compiled
def _clamp(value, low, high):  # type: ignore[no-untyped-def]
    if not value > low:  # also true for NaN, which becomes the low limit
        return low
    return min(value, high)


@compiled
def simulate(W, begin, end, lags, par):  # type: ignore[no-untyped-def]
    """Write rows begin..end - 1 of W's simulated columns from its own earlier rows, in place."""
    n_rules, n, n_x = par.theta.shape
    x, z, phi = np.empty(n_x), np.empty(lags.z_lag.size), np.empty(n_rules)
    for k in range(begin, end):
        _regress(W, k, lags, x)
        _antecedents(W, k, lags, par, z)
        _fire(z, par, phi)
        for i in range(n):
            value = 0.0
            for r in range(n_rules):
                if phi[r] > 0.0:
                    part = 0.0
                    for m in range(n_x):
                        part += par.theta[r, i, m] * x[m]
                    value += phi[r] * part
            W[k, i] = _clamp(value, par.limits[0, i], par.limits[1, i])


def free_run(W: FloatArray, first: int, lags: Lags, par: Parameters) -> None:
    """Write the simulated columns of rows first.. of W (N, n + n_u) from its own earlier rows, in place."""
    simulate(W, first, len(W), lags, par)


def predict(W: FloatArray, first: int, steps: int, lags: Lags, par: Parameters) -> FloatArray:
    """(N, n) `steps`-ahead predictions along measured W; rows before first + steps - 1 are NaN."""
    ahead = np.full((len(W), par.theta.shape[1]), np.nan)
    _predict(W.copy(), W, first, steps, lags, par, ahead)
    return ahead


@compiled
def _predict(X, W, first, steps, lags, par, ahead):  # type: ignore[no-untyped-def]
    n = par.theta.shape[1]
    for k in range(first + steps - 1, W.shape[0]):
        begin = k - steps + 1
        simulate(X, begin, k + 1, lags, par)
        for i in range(n):
            ahead[k, i] = X[k, i]
            for t in range(begin, k + 1):
                X[t, i] = W[t, i]


def firing(W: FloatArray, first: int, lags: Lags, par: Parameters) -> FloatArray:
    """(N, R) normalised firing strengths along W; rows before `first` repeat row `first`."""
    strength = np.full((len(W), len(par.theta)), 1.0 / len(par.theta))
    _firing(W, first, lags, par, strength)
    strength[:first] = strength[first] if first < len(W) else strength[:first]
    return strength


@compiled
def _firing(W, first, lags, par, strength):  # type: ignore[no-untyped-def]
    z, phi = np.empty(lags.z_lag.size), np.empty(strength.shape[1])
    for k in range(first, W.shape[0]):
        _antecedents(W, k, lags, par, z)
        _fire(z, par, phi)
        for r in range(phi.size):
            strength[k, r] = phi[r]


@compiled
def sweep(X, W, rows, lags, par, basis, own, ring, J, H, g):  # type: ignore[no-untyped-def]
    """Free run of rows[0] <= k < rows[1] with its sensitivities; the sum of squared errors.

    Parameters
    ----------
    X : (N, n + n_u) simulated columns are written in place.
    W : (N, n + n_u) what they are compared with, in its first J.shape[1] columns; without rows, errors are
        how far outputs leave the range of training on their way to the limits.
    rows : first row, row after the last.
    basis : (n_b, n_x); consequent coordinates a with theta = offset + a @ basis.
    own : of the columns of sensitivities so many, the last (the start), only propagate; those before are the
        first of the unknowns [a (R n n_b) | centre | log width].
    ring : (D, n, M) sensitivities of row k in ring[k % D], D at least the deepest lag. Holds those of the
        rows before rows[0]; on return of the last.
    J : (rows, n_y, M) filled with the sensitivities of compared columns; (0, n_y, 0) to keep none.
    H, g : (M, M), (M,) J'J (lower triangle) and J'e are added to them; empty to leave that out.
    """
    n_rules, n, n_x = par.theta.shape
    n_z, n_b, n_y = lags.z_lag.size, basis.shape[0], J.shape[1]
    deep, size = ring.shape[0], ring.shape[2]
    common, stressed = size - own, W.shape[0] == 0
    x, z, phi = np.empty(n_x), np.empty(n_z), np.empty(n_rules)
    e, part = np.empty(n_b), np.empty(n_rules)
    inverse, lean = np.empty((n_rules, n_z)), np.empty((n_rules, n_z))
    G, new = np.empty((deep, n)), np.empty((n, size))
    at_centre = n_rules * n * n_b
    at_width = at_centre + n_rules * n_z
    sums, keeps = H.shape[0] > 0, J.shape[0] > 0
    square = 0.0
    for r in range(n_rules):
        for j in range(n_z):
            inverse[r, j] = 1.0 / par.width[r, j]
    for k in range(rows[0], rows[1]):
        _regress(X, k, lags, x)
        _antecedents(X, k, lags, par, z)
        _fire(z, par, phi)
        for m in range(n_b):
            total = 0.0
            for c in range(n_x):
                total += basis[m, c] * x[c]
            e[m] = total
        for r in range(n_rules):
            for j in range(n_z):
                lean[r, j] = (z[j] - par.centre[r, j]) * inverse[r, j]
        for i in range(n):
            value = 0.0
            for r in range(n_rules):
                total = 0.0
                for m in range(n_x):
                    total += par.theta[r, i, m] * x[m]
                part[r] = total
                value += phi[r] * total
            X[k, i] = _clamp(value, par.limits[0, i], par.limits[1, i])
            for p in range(size):
                new[i, p] = 0.0
            if X[k, i] != value:  # clamped (or NaN): nothing moves it
                continue
            for d in range(deep):
                for c in range(n):
                    G[d, c] = 0.0
            for m in range(n_x):
                c = lags.column[m]
                if 0 <= c < n:
                    total = 0.0
                    for r in range(n_rules):
                        total += phi[r] * par.theta[r, i, m]
                    G[lags.lag[m] - 1, c] += total
            for j in range(n_z):
                c = lags.z_column[j]
                if c < n and par.z_range[0, j] < z[j] < par.z_range[1, j]:
                    slope = 0.0
                    for r in range(n_rules):
                        slope -= phi[r] * (part[r] - value) * lean[r, j] * inverse[r, j]
                    G[lags.z_lag[j] - 1, c] += slope
                    if lags.z_minus[j] >= 0:
                        G[lags.z_minus[j] - 1, c] -= slope
            for d in range(deep):
                past = (k - 1 - d) % deep
                for c in range(n):
                    f = G[d, c]
                    if f != 0.0:
                        for p in range(size):
                            new[i, p] += f * ring[past, c, p]
            if common == 0:
                continue
            for r in range(n_rules):
                if phi[r] == 0.0:
                    continue
                base = (r * n + i) * n_b
                for m in range(n_b):
                    new[i, base + m] += phi[r] * e[m]
                if common > at_centre:
                    lever = phi[r] * (part[r] - value)
                    for j in range(n_z):
                        pull = lever * lean[r, j]
                        new[i, at_centre + r * n_z + j] += pull * inverse[r, j]
                        new[i, at_width + r * n_z + j] += pull * lean[r, j]
        slot = k % deep
        for i in range(n):
            for p in range(size):
                ring[slot, i, p] = new[i, p]
        for i in range(n_y):
            error = _stray(X[k, i], par.limits, i) if stressed else X[k, i] - W[k, i]
            square += error * error
            if keeps:
                for p in range(size):
                    J[k - rows[0], i, p] = new[i, p]
            if sums and not (stressed and error == 0.0):
                for p in range(size):
                    f = new[i, p]
                    g[p] += f * error
                    for q in range(p + 1):
                        H[p, q] += f * new[i, q]
    return square


@compiled
def _stray(y, limits, i):  # type: ignore[no-untyped-def]
    """How far an output is on its way out of the training range to its limits; 0 inside.

    Half of the margin is free: a plant may well go a little further under inputs it has not seen.
    """
    margin = (limits[1, i] - limits[0, i]) / 6.0
    return max(y - (limits[1, i] - margin), 0.0) + min(y - (limits[0, i] + margin), 0.0)


@compiled
def _expand(p, fixed, par):  # type: ignore[no-untyped-def]
    """Parameters at a vector of unknowns: centres within the data, widths that words can name."""
    n_rules, n, n_x = par.theta.shape
    n_b, n_z = fixed.basis.shape[0], par.centre.shape[1]
    if fixed.chosen.size == 0:  # as they were given
        return
    for r in range(n_rules):
        for i in range(n):
            base = (r * n + i) * n_b
            for m in range(n_x):
                value = fixed.offset[i, m]
                for b in range(n_b):
                    value += p[base + b] * fixed.basis[b, m]
                par.theta[r, i, m] = value
    at = n_rules * n * n_b
    for r in range(n_rules):
        for j in range(n_z):
            low, high = fixed.z_known[0, j], fixed.z_known[1, j]
            span = max(high - low, 1e-12)
            par.centre[r, j] = min(max(p[at + r * n_z + j], low), high)
            log_width = p[at + (n_rules + r) * n_z + j]
            width = math.exp(min(max(log_width, -_MOST_LOG_WIDTH), _MOST_LOG_WIDTH))
            par.width[r, j] = min(max(width, _NARROWEST * span), _WIDEST * span)


@compiled
def _departure(p, fixed, par, slopes):  # type: ignore[no-untyped-def]
    """What the ridge is on: consequents against their mean, memberships against where they began.

    `slopes` (R n n_b + 2 R n_z,) becomes half its gradient.
    """
    n_rules, n = par.theta.shape[:2]
    m, n_z = n * fixed.basis.shape[0], par.centre.shape[1]
    total, at = 0.0, n_rules * m
    for i in range(slopes.size):
        slopes[i] = 0.0
    if n_rules == 1:
        return total
    mean = np.zeros(m)
    for r in range(n_rules):
        for i in range(m):
            mean[i] += p[r * m + i] / n_rules
    for r in range(n_rules):
        for i in range(m):
            pulled = 0.0
            for j in range(m):
                pulled += fixed.metric[i, j] * (p[r * m + j] - mean[j])
            slopes[r * m + i] = pulled
            total += pulled * (p[r * m + i] - mean[i])
        for j in range(n_z):
            width = fixed.width[r, j]
            moved = HOLD * (par.centre[r, j] - fixed.centre[r, j]) / width
            grown = HOLD * math.log(par.width[r, j] / width)
            total += moved * moved + grown * grown
            slopes[at + r * n_z + j] = moved * HOLD / width
            slopes[at + (n_rules + r) * n_z + j] = grown * HOLD
    return total


@compiled
def _begin(p, at, run, fixed, size, n, X):  # type: ignore[no-untyped-def]
    """Write the start of a run, which stands in p from `at` on, into X; its squared error."""
    square = 0.0
    for k in range(size.moving):
        row = fixed.edges[run] + size.depth - size.moving + k
        for i in range(n):
            X[row, i] = p[at + k * n + i]
            if i < size.n_y:
                gap = X[row, i] - fixed.W[row, i]
                square += gap * gap
    return square


@compiled
def _unlikely(p, at, fixed, pull):  # type: ignore[no-untyped-def]
    """What a run's start, which stands in p from `at` on, adds to the cost; half its gradient into `pull`."""
    total = 0.0
    for i in range(pull.size):
        pull[i] = 0.0
        for j in range(pull.size):
            pull[i] += fixed.weight[i, j] * (p[at + j] - fixed.likely[j])
        total += pull[i] * (p[at + i] - fixed.likely[i])
    return total


@compiled
def _cost(p, lags, par, fixed, size, X, S, slopes):  # type: ignore[no-untyped-def]
    """Mean squared simulation error, ridge, drift and stress at a vector of unknowns; X, S to run in."""
    n_rules, n, _ = par.theta.shape
    _expand(p, fixed, par)
    at = n_rules * n * fixed.basis.shape[0] + 2 * par.centre.size
    q, total, pull = size.moving * n, 0.0, np.empty(size.moving * n)
    for s in range(fixed.edges.size - 1):
        total += _begin(p, at + s * q, s, fixed, size, n, X)
        total += size.samples * _unlikely(p, at + s * q, fixed, pull)
        begin, end = fixed.edges[s] + size.depth, fixed.edges[s + 1]
        simulate(X, begin, end, lags, par)
        for k in range(begin, end):
            for i in range(size.n_y):
                gap = X[k, i] - fixed.W[k, i]
                total += gap * gap
    cost = total / size.samples
    if size.ridge > 0.0:
        cost += size.ridge * _departure(p, fixed, par, slopes)
    if S.shape[0] > 0:
        cost += _strayed(S, lags, par, size) / S.shape[0]
    return cost


@compiled
def _strayed(S, lags, par, size):  # type: ignore[no-untyped-def]
    """Squares by which the outputs leave their range under stress."""
    simulate(S, size.depth, S.shape[0], lags, par)
    total = 0.0
    for k in range(S.shape[0]):
        for i in range(size.n_y):
            total += _stray(S[k, i], par.limits, i) ** 2
    return total


@compiled
def _normal(p, lags, par, fixed, size, X, S, slopes, ring, H, g, normal):  # type: ignore[no-untyped-def]
    """The cost as `_cost`, and its Gauss-Newton matrix and half gradient into `normal`.

    H, g : (common + q, common + q), (common + q,) to work in, common the last chosen number + 1.
    """
    n_rules, n, _ = par.theta.shape
    _expand(p, fixed, par)
    m = n * fixed.basis.shape[0]
    at = n_rules * m + 2 * par.centre.size
    corner, border, blocks, slope = normal
    free, q, runs = corner.shape[0], size.moving * n, fixed.edges.size - 1
    common = ring.shape[2] - q
    none, pull = np.empty((0, size.n_y, 0)), np.empty(q)
    for i in range(free):
        slope[i] = 0.0
        for j in range(free):
            corner[i, j] = 0.0
    total = 0.0
    for s in range(runs):
        _clear(ring, H, g)
        total += _begin(p, at + s * q, s, fixed, size, n, X)
        for k in range(size.moving):
            row = fixed.edges[s] + size.depth - size.moving + k
            for i in range(n):
                own = common + k * n + i
                ring[row % ring.shape[0], i, own] = 1.0
                if i < size.n_y:
                    H[own, own] += 1.0
                    g[own] += X[row, i] - fixed.W[row, i]
        rows = (fixed.edges[s] + size.depth, fixed.edges[s + 1])
        total += sweep(X, fixed.W, rows, lags, par, fixed.basis, q, ring, none, H, g)
        for i in range(free):
            a = fixed.chosen[i]
            slope[i] += g[a] / size.samples
            for j in range(i + 1):
                corner[i, j] += H[a, fixed.chosen[j]] / size.samples
            for j in range(q):
                border[s, i, j] = H[common + j, a] / size.samples
        total += size.samples * _unlikely(p, at + s * q, fixed, pull)
        for i in range(q):
            slope[free + s * q + i] = g[common + i] / size.samples + pull[i]
            for j in range(i + 1):
                value = H[common + i, common + j] / size.samples + fixed.weight[i, j]
                blocks[s, i, j] = value
                blocks[s, j, i] = value
    cost = total / size.samples
    if size.ridge > 0.0:
        cost += size.ridge * _departure(p, fixed, par, slopes)
        _add_ridge(par, fixed, size, slopes, m, corner, slope)
    if S.shape[0] > 0:
        stray = _strayed(S, lags, par, size)
        if stray > 0.0:
            _clear(ring, H, g)
            free_of_data = np.empty((0, size.n_y))
            sweep(S, free_of_data, (size.depth, S.shape[0]), lags, par, fixed.basis, q, ring, none, H, g)
            for i in range(free):
                slope[i] += g[fixed.chosen[i]] / S.shape[0]
                for j in range(i + 1):
                    corner[i, j] += H[fixed.chosen[i], fixed.chosen[j]] / S.shape[0]
        cost += stray / S.shape[0]
    for i in range(free):
        for j in range(i):
            corner[j, i] = corner[i, j]
    return cost


@compiled
def _clear(ring, H, g):  # type: ignore[no-untyped-def]
    for d in range(ring.shape[0]):
        for i in range(ring.shape[1]):
            for p in range(ring.shape[2]):
                ring[d, i, p] = 0.0
    for p in range(g.size):
        g[p] = 0.0
        for q in range(g.size):
            H[p, q] = 0.0


@compiled
def _add_ridge(par, fixed, size, slopes, m, corner, slope):  # type: ignore[no-untyped-def]
    """Add the ridge's half gradient and its matrix (lower triangle); of one rule, the departure is zero."""
    n_rules, n_z = par.centre.shape
    if n_rules == 1:
        return
    first = n_rules * m
    for i in range(fixed.chosen.size):
        a = fixed.chosen[i]
        slope[i] += size.ridge * slopes[a]
        if a >= first:
            u = (a - first) % (n_rules * n_z)
            pull = HOLD / fixed.width[u // n_z, u % n_z] if a < first + n_rules * n_z else HOLD
            corner[i, i] += size.ridge * pull * pull
            continue
        for j in range(i + 1):
            b = fixed.chosen[j]
            share = (1.0 if a // m == b // m else 0.0) - 1.0 / n_rules
            corner[i, j] += size.ridge * share * fixed.metric[a % m, b % m]


@compiled
def _cholesky(A, n):  # type: ignore[no-untyped-def]
    """The factor L of the leading (n, n) of A = L L' in its lower triangle; False where there is none."""
    for j in range(n):
        total = A[j, j]
        for k in range(j):
            total -= A[j, k] * A[j, k]
        if not total > 0.0:
            return False
        A[j, j] = math.sqrt(total)
        for i in range(j + 1, n):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = total / A[j, j]
    return True


@compiled
def _damped_step(normal, scale, damping, step):  # type: ignore[no-untyped-def]
    """-(H + damping diag(scale²))^-1 gradient into `step`; False where that matrix is not positive definite.

    The blocks are eliminated first (the Schur complement): many short runs are as cheap as a long one.
    """
    corner, border, blocks, slope = normal
    free, runs, q = corner.shape[0], border.shape[0], border.shape[2]
    C, right = np.empty((free, free)), np.empty(free)
    lower, half = np.empty((runs, q, q)), np.empty((runs, q, free + 1))
    for i in range(free):
        right[i] = -slope[i] / scale[i]
        for j in range(i + 1):
            C[i, j] = corner[i, j] / (scale[i] * scale[j])
        C[i, i] += damping
    for s in range(runs):
        at = free + s * q
        D = lower[s]
        for i in range(q):
            for j in range(i + 1):
                D[i, j] = blocks[s, i, j] / (scale[at + i] * scale[at + j])
            D[i, i] += damping
        if not _cholesky(D, q):
            return False
        for i in range(q):
            for c in range(free + 1):
                value = slope[at + i] if c == free else border[s, c, i] / scale[c]
                half[s, i, c] = value / scale[at + i]
            for k in range(i):
                for c in range(free + 1):
                    half[s, i, c] -= D[i, k] * half[s, k, c]
            for c in range(free + 1):
                half[s, i, c] /= D[i, i]
        for k in range(q):
            for i in range(free):
                f = half[s, k, i]
                right[i] += f * half[s, k, free]
                for j in range(i + 1):
                    C[i, j] -= f * half[s, k, j]
    if not _cholesky(C, free):
        return False
    for i in range(free):
        for k in range(i):
            right[i] -= C[i, k] * right[k]
        right[i] /= C[i, i]
    for i in range(free - 1, -1, -1):
        for k in range(i + 1, free):
            right[i] -= C[k, i] * right[k]
        right[i] /= C[i, i]
        step[i] = right[i] / scale[i]
    for s in range(runs):
        at = free + s * q
        for i in range(q - 1, -1, -1):
            value = -half[s, i, free]
            for c in range(free):
                value -= half[s, i, c] * right[c]
            for k in range(i + 1, q):
                value -= lower[s, k, i] * step[at + k]
            step[at + i] = value / lower[s, i, i]
        for i in range(q):
            step[at + i] /= scale[at + i]
    total = 0.0
    for i in range(step.size):
        total += abs(step[i])
    return math.isfinite(total)


@compiled
def _diagonal(normal, diagonal):  # type: ignore[no-untyped-def]
    """The diagonal of the Gauss-Newton matrix; False where a number of `normal` is not finite."""
    corner, border, blocks, slope = normal
    free, runs, q = corner.shape[0], border.shape[0], border.shape[2]
    total = 0.0
    for i in range(free):
        diagonal[i] = corner[i, i]
        for j in range(free):
            total += abs(corner[i, j])
    for s in range(runs):
        for i in range(q):
            diagonal[free + s * q + i] = blocks[s, i, i]
            for j in range(q):
                total += abs(blocks[s, i, j])
            for j in range(free):
                total += abs(border[s, j, i])
    for i in range(slope.size):
        total += abs(slope[i])
    return math.isfinite(total)


@compiled
def _workspace(lags, par, fixed, size):  # type: ignore[no-untyped-def]
    """Parameters, runs and arrays to work in: private copies."""
    n_rules, n, n_x = par.theta.shape
    own = Parameters(par.theta.copy(), par.centre.copy(), par.width.copy(), par.z_range, par.limits)
    deepest = 1
    for m in range(n_x):
        if 0 <= lags.column[m] < n:
            deepest = max(deepest, lags.lag[m])
    for j in range(lags.z_lag.size):
        if lags.z_column[j] < n:
            deepest = max(deepest, lags.z_lag[j], lags.z_minus[j])
    common = fixed.chosen[fixed.chosen.size - 1] + 1 if fixed.chosen.size else 0
    width = common + size.moving * n
    slopes = np.empty(n_rules * n * fixed.basis.shape[0] + 2 * par.centre.size)
    work = (fixed.W.copy(), fixed.stress.copy(), slopes)
    return own, work, (np.empty((deepest, n, width)), np.empty((width, width)), np.empty(width))


@compiled
def _empty_normal(fixed, q):  # type: ignore[no-untyped-def]
    free, runs = fixed.chosen.size, fixed.edges.size - 1
    return Normal(
        np.empty((free, free)), np.empty((runs, free, q)), np.empty((runs, q, q)), np.empty(free + runs * q)
    )


@compiled
def descend(p, lags, par, fixed, size, iterations, tolerance):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt from p, which moves in place; the cost in the end, and its `Normal` there.

    The method is that of `flysid.model.refine`. A trial point is simulated first, and differentiated only
    where its cost is lower. The cost is not a number where the start of the search diverges. With 0
    iterations p stays where it is; with fewer, nothing is differentiated, either.
    """
    own, work, sums = _workspace(lags, par, fixed, size)
    X, S, slopes = work
    ring, H, g = sums
    q = size.moving * par.theta.shape[1]
    normal, other = _empty_normal(fixed, q), _empty_normal(fixed, q)
    free, count = fixed.chosen.size, normal.slope.size
    tail = slopes.size
    step, diagonal, scale = np.empty(count), np.empty(count), np.empty(count)
    trial = p.copy()
    if iterations < 0:
        return _cost(p, lags, own, fixed, size, X, S, slopes), normal
    cost = _normal(p, lags, own, fixed, size, X, S, slopes, ring, H, g, normal)
    tries = 0
    if not (_diagonal(normal, diagonal) and math.isfinite(cost)) or iterations == 0:
        return (cost if iterations == 0 else math.nan), normal
    largest = 0.0
    for i in range(count):
        largest = max(largest, math.sqrt(diagonal[i]))
    for i in range(count):
        scale[i] = max(math.sqrt(diagonal[i]), 1e-8 * (largest if largest > 0.0 else 1.0))
    damping, growth = _FIRST_DAMPING, 2.0
    while tries < iterations:
        steepest = 0.0
        for i in range(count):
            steepest = max(steepest, abs(normal.slope[i]) / scale[i])
        if cost == 0.0 or steepest <= 1e-14 * math.sqrt(cost):
            break
        tries += 1
        solved = _damped_step(normal, scale, damping, step)
        better, value, short, long = False, 0.0, 0.0, 0.0
        if solved:
            for i in range(count):
                at = fixed.chosen[i] if i < free else tail + i - free
                trial[at] = p[at] + step[i]
                short += (scale[i] * step[i]) ** 2
                long += (scale[i] * p[at]) ** 2
            value = _cost(trial, lags, own, fixed, size, X, S, slopes)
            if value < cost:
                value = _normal(trial, lags, own, fixed, size, X, S, slopes, ring, H, g, other)
                better = value < cost and _diagonal(other, diagonal)
        if not better:
            damping, growth = damping * growth, growth * 2.0
            if damping > _LARGEST_DAMPING or (solved and math.sqrt(short) <= 1e-15 * math.sqrt(long)):
                break
            if growth <= 2.0**8:  # the first rejections in a row cost no iteration
                tries -= 1
            continue
        predicted = damping * short
        for i in range(count):
            predicted -= step[i] * normal.slope[i]
        gain = (cost - value) / predicted if predicted > 0.0 else 1.0
        damping = max(damping * max(_SMALLEST_RELAXATION, 1.0 - (2.0 * gain - 1.0) ** 3), _SMALLEST_DAMPING)
        growth = 2.0
        settled = cost - value <= tolerance * cost or math.sqrt(short) <= tolerance * math.sqrt(long)
        normal, other = other, normal
        cost = value
        for i in range(p.size):
            p[i] = trial[i]
        for i in range(count):
            scale[i] = max(scale[i], math.sqrt(diagonal[i]))
        if settled:
            break
    return cost, normal
