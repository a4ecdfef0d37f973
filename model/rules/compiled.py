"""Compiled free run of a Takagi-Sugeno model, with its exact forward sensitivities.

All signals stand in one matrix W (N, n_y + n_u), outputs first, in normalised units. A regressor is a
column of W at a lag, an antecedent variable z is one too, or the difference of two lags. With the firing
strengths phi_r of the paper's eq. (2) and (7),

    y(k) = sum_r phi_r(z(k)) theta_r x(k),    phi_r = w_r / sum w,    log w_r = -1/2 sum ((z-c_r)/s_r)^2

The sensitivity S(k) = dy(k)/dp obeys the same recursion as the model, driven by the direct derivative:

    S(k) = df/dp + sum_l (df/dy(k-l)) S(k-l)

which is exact, costs one pass, and needs no tape. z is clamped a little beyond the range seen in training, so
that far away the nearest rules speak and nothing wakes a distant wide one; outputs are clamped to their
limits, so that every run is finite. Cost per step: R (n_x + n_z) for the run, P n_lags more for P
sensitivities.
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
    theta : (R, n_y, n_x) consequents.
    centre, width : (R, n_z) Gaussian memberships.
    z_range : (2, n_z) antecedents are clamped to this range.
    limits : (2, n_y) outputs are clamped to these limits.
    """

    theta: FloatArray
    centre: FloatArray
    width: FloatArray
    z_range: FloatArray
    limits: FloatArray


@njit(cache=True)
def _regress(W, k, lags, x):  # type: ignore[no-untyped-def]
    for m in range(x.size):
        c = lags.column[m]
        x[m] = 1.0 if c < 0 else W[k - lags.lag[m], c]


@njit(cache=True)
def _antecedents(W, k, lags, par, z):  # type: ignore[no-untyped-def]
    for j in range(z.size):
        value = W[k - lags.z_lag[j], lags.z_column[j]]
        if lags.z_minus[j] >= 0:
            value -= W[k - lags.z_minus[j], lags.z_column[j]]
        z[j] = min(max(value, par.z_range[0, j]), par.z_range[1, j])


@njit(cache=True)
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


@njit(cache=True)
def _conclude(x, phi, par, i):  # type: ignore[no-untyped-def]
    value = 0.0
    for r in range(phi.size):
        if phi[r] > 0.0:
            part = 0.0
            for m in range(x.size):
                part += par.theta[r, i, m] * x[m]
            value += phi[r] * part
    return value


@njit(cache=True)
def _clamp(value, low, high):  # type: ignore[no-untyped-def]
    if not value > low:  # also true for NaN, which becomes the low limit
        return low
    return min(value, high)


@njit(cache=True)
def free_run(W, first, lags, par):  # type: ignore[no-untyped-def]
    """Write the outputs of rows first.. of W (N, n_y + n_u) from its own earlier outputs, in place."""
    n_rules, n_y, n_x = par.theta.shape
    x, z, phi = np.empty(n_x), np.empty(lags.z_lag.size), np.empty(n_rules)
    for k in range(first, W.shape[0]):
        _regress(W, k, lags, x)
        _antecedents(W, k, lags, par, z)
        _fire(z, par, phi)
        for i in range(n_y):
            W[k, i] = _clamp(_conclude(x, phi, par, i), par.limits[0, i], par.limits[1, i])


@njit(cache=True)
def predict(W, first, steps, lags, par):  # type: ignore[no-untyped-def]
    """(N, n_y) `steps`-ahead predictions along measured W; rows before first + steps - 1 are NaN."""
    n_rules, n_y, n_x = par.theta.shape
    x, z, phi = np.empty(n_x), np.empty(lags.z_lag.size), np.empty(n_rules)
    result = np.full((W.shape[0], n_y), np.nan)
    kept = np.empty((steps, n_y))
    for k in range(first + steps - 1, W.shape[0]):
        begin = k - steps + 1
        kept[:] = W[begin : k + 1, :n_y]
        for t in range(begin, k + 1):
            _regress(W, t, lags, x)
            _antecedents(W, t, lags, par, z)
            _fire(z, par, phi)
            for i in range(n_y):
                W[t, i] = _clamp(_conclude(x, phi, par, i), par.limits[0, i], par.limits[1, i])
        result[k] = W[k, :n_y]
        W[begin : k + 1, :n_y] = kept
    return result


@njit(cache=True)
def firing(W, first, lags, par):  # type: ignore[no-untyped-def]
    """(N, R) normalised firing strengths along W; rows before `first` repeat row `first`."""
    n_rules = par.theta.shape[0]
    z, result = np.empty(lags.z_lag.size), np.empty((W.shape[0], n_rules))
    for k in range(first, W.shape[0]):
        _antecedents(W, k, lags, par, z)
        _fire(z, par, result[k])
    for k in range(min(first, W.shape[0])):
        if first < W.shape[0]:
            result[k] = result[first]
        else:
            result[k] = 1.0 / n_rules
    return result


@njit(cache=True)
def sensitivities(W, rows, lags, par, basis, J):  # type: ignore[no-untyped-def]
    """Free run of rows[0] <= k < rows[1] with dy/dp of every row in J.

    Parameters
    ----------
    W : (N, n_y + n_u), outputs written in place.
    rows : first row, row after the last, row of W that J[0] stands for.
    basis : (n_b, n_x); consequent coordinates a with theta = offset + a @ basis.
    J : (B, n_y, P + Q), P = R n_y n_b + 2 R n_z ordered as a, centre, log width; Q further columns
        (initial states) only propagate. Rows of the lags before rows[0] must be filled.
    """
    n_rules, n_y, n_x = par.theta.shape
    n_z, n_b = lags.z_lag.size, basis.shape[0]
    x, z, phi = np.empty(n_x), np.empty(n_z), np.empty(n_rules)
    e, part = np.empty(n_b), np.empty((n_rules, n_y))
    slope = np.empty(n_z)
    deepest = 1
    for m in range(n_x):
        deepest = max(deepest, lags.lag[m])
    for j in range(n_z):
        deepest = max(deepest, lags.z_lag[j], lags.z_minus[j])
    G = np.zeros((deepest + 1, n_y))
    at_centre = n_rules * n_y * n_b
    at_width = at_centre + n_rules * n_z
    for k in range(rows[0], rows[1]):
        b = k - rows[2]
        _regress(W, k, lags, x)
        _antecedents(W, k, lags, par, z)
        _fire(z, par, phi)
        for m in range(n_b):
            total = 0.0
            for n in range(n_x):
                total += basis[m, n] * x[n]
            e[m] = total
        for i in range(n_y):
            value = 0.0
            for r in range(n_rules):
                total = 0.0
                for m in range(n_x):
                    total += par.theta[r, i, m] * x[m]
                part[r, i] = total
                value += phi[r] * total
            W[k, i] = _clamp(value, par.limits[0, i], par.limits[1, i])
            row = J[b, i]
            row[:] = 0.0
            if W[k, i] != value:  # clamped (or NaN): nothing moves it
                continue
            G[:] = 0.0
            for m in range(n_x):
                c = lags.column[m]
                if 0 <= c < n_y:
                    total = 0.0
                    for r in range(n_rules):
                        total += phi[r] * par.theta[r, i, m]
                    G[lags.lag[m], c] += total
            slope[:] = 0.0
            for r in range(n_rules):
                lever = phi[r] * (part[r, i] - value)
                if lever != 0.0:
                    for j in range(n_z):
                        d = (z[j] - par.centre[r, j]) / par.width[r, j]
                        slope[j] -= lever * d / par.width[r, j]
            for j in range(n_z):
                c = lags.z_column[j]
                if c < n_y and par.z_range[0, j] < z[j] < par.z_range[1, j]:
                    G[lags.z_lag[j], c] += slope[j]
                    if lags.z_minus[j] >= 0:
                        G[lags.z_minus[j], c] -= slope[j]
            for lag in range(1, deepest + 1):
                for c in range(n_y):
                    g = G[lag, c]
                    if g != 0.0:
                        past = J[b - lag, c]
                        for p in range(row.size):
                            row[p] += g * past[p]
            for r in range(n_rules):
                if phi[r] == 0.0:
                    continue
                base = (r * n_y + i) * n_b
                for m in range(n_b):
                    row[base + m] += phi[r] * e[m]
                lever = phi[r] * (part[r, i] - value)
                for j in range(n_z):
                    d = (z[j] - par.centre[r, j]) / par.width[r, j]
                    row[at_centre + r * n_z + j] += lever * d / par.width[r, j]
                    row[at_width + r * n_z + j] += lever * d * d
