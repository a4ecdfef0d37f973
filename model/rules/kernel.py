"""Compiled: free runs of rules and their exact sensitivities.

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
    x = np.empty(n_x)
    z = np.empty(lags.z_lag.size)
    phi = np.empty(n_rules)
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
    z = np.empty(lags.z_lag.size)
    phi = np.empty(strength.shape[1])
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
    n_z = lags.z_lag.size
    n_b = basis.shape[0]
    n_y = J.shape[1]
    deep = ring.shape[0]
    size = ring.shape[2]
    common = size - own
    stressed = W.shape[0] == 0
    x = np.empty(n_x)
    z = np.empty(n_z)
    phi = np.empty(n_rules)
    e = np.empty(n_b)
    part = np.empty(n_rules)
    inverse = np.empty((n_rules, n_z))
    lean = np.empty((n_rules, n_z))
    G = np.empty((deep, n))
    new = np.empty((n, size))
    at_centre = n_rules * n * n_b
    at_width = at_centre + n_rules * n_z
    sums = H.shape[0] > 0
    keeps = J.shape[0] > 0
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
            error = stray(X[k, i], par.limits, i) if stressed else X[k, i] - W[k, i]
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
def stray(y, limits, i):  # type: ignore[no-untyped-def]
    """How far an output is on its way out of the training range to its limits; 0 inside.

    Half of the margin is free: a plant may well go a little further under inputs it has not seen.
    """
    margin = (limits[1, i] - limits[0, i]) / 6.0
    return max(y - (limits[1, i] - margin), 0.0) + min(y - (limits[0, i] + margin), 0.0)
