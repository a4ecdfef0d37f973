"""Compiled: the free run with its sensitivities, and an estimate of the state that a free run starts from.

All states stand at lag 1, so that only one row of sensitivities is carried from sample to sample, and only
those of the outputs are written down: a third of the time of `flysid.model.rules.compiled.sensitivities`,
which must keep every lag of every output.

Hidden states are not measured; they are inferred from the first rows as the most likely ones: the state x
that minimises

    weight * sum_k |y(k) - yhat(k; x)|^2 + (x - m)' P (x - m)

with m and P the mean and the inverse covariance of the states along the training data (a Bayesian estimate
with Gaussian noise and prior). Gauss-Newton with forward differences; one step is exact for a linear model.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from flysid.model.rules.compiled import _antecedents, _clamp, _fire, _regress, free_run

_STEPS = 12
_NUDGE = 1e-6


@njit(cache=True)
def _miss(W, x, first, n_y, lags, par, out):  # type: ignore[no-untyped-def]
    """Simulated minus measured outputs of every row from first - 1 on, into out; their sum of squares."""
    run = W.copy()
    for i in range(x.size):
        run[first - 1, i] = x[i]
    free_run(run, first, lags, par)
    total = 0.0
    at = 0
    for k in range(first - 1, W.shape[0]):
        for i in range(n_y):
            gap = run[k, i] - W[k, i]
            out[at] = gap
            total += gap * gap
            at += 1
    return total


@njit(cache=True)
def start_state(W, first, n_y, lags, par, guess, mean, inverse, weight):  # type: ignore[no-untyped-def]
    """(n,) the most likely state of row first - 1, given the outputs of W's rows from there on.

    Parameters
    ----------
    W : (N, n + n_u) rows whose first n_y and whose input columns are data; N >= first.
    guess, mean : (n,) where the search starts, and the prior's mean.
    inverse : (n, n) the prior's inverse covariance.
    weight : inverse variance of the outputs' noise.
    """
    n = guess.size
    size = (W.shape[0] - first + 1) * n_y
    x = guess.copy()
    base, moved = np.empty(size), np.empty(size)
    J = np.empty((size, n))
    gap = x - mean
    cost = weight * _miss(W, x, first, n_y, lags, par, base) + gap @ (inverse @ gap)
    for _ in range(_STEPS):
        for j in range(n):
            nudged = x.copy()
            nudged[j] += _NUDGE
            _miss(W, nudged, first, n_y, lags, par, moved)
            J[:, j] = (moved - base) / _NUDGE
        H = weight * (J.T @ J) + inverse
        g = weight * (J.T @ base) + inverse @ (x - mean)
        if not (np.isfinite(H).all() and np.isfinite(g).all()):  # a model that runs away
            break
        for j in range(n):
            H[j, j] += 1e-14 * H[j, j] + 1e-300
        step = np.linalg.solve(H, g)
        size_of_step = 1.0
        better = False
        for _ in range(6):
            trial = x - size_of_step * step
            gap = trial - mean
            value = weight * _miss(W, trial, first, n_y, lags, par, moved) + gap @ (inverse @ gap)
            if value < cost:
                better = True
                break
            size_of_step *= 0.5
        if not better:
            break
        settled = cost - value <= 1e-10 * cost
        x = trial
        cost = value
        base[:] = moved
        if settled:
            break
    return x, cost


@njit(cache=True)
def state_sensitivities(W, rows, lags, par, n_y, S, J):  # type: ignore[no-untyped-def]
    """Free run of rows[0] <= k < rows[1], with the derivatives of its outputs.

    Parameters
    ----------
    W : (N, n + n_u), states written in place; regressors and antecedents hold states at lag 1 only.
    rows : first row, row after the last.
    S : (n, P + Q) derivatives of the states in row rows[0] - 1; on return those in the last row.
        P = R n n_x + 2 R n_z ordered as consequents, centres, log widths; Q further columns (the initial
        state) only propagate.
    J : (rows[1] - rows[0], n_y, P + Q) filled with the derivatives of the outputs.
    """
    n_rules, n, n_x = par.theta.shape
    n_z, size = lags.z_lag.size, S.shape[1]
    inverse = 1.0 / par.width
    x, z, phi = np.empty(n_x), np.empty(n_z), np.empty(n_rules)
    part, lean, new = np.empty(n_rules), np.empty((n_rules, n_z)), np.empty((n, size))
    G = np.empty(n)
    at_centre = n_rules * n * n_x
    at_width = at_centre + n_rules * n_z
    for k in range(rows[0], rows[1]):
        _regress(W, k, lags, x)
        _antecedents(W, k, lags, par, z)
        _fire(z, par, phi)
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
            W[k, i] = _clamp(value, par.limits[0, i], par.limits[1, i])
            row = new[i]
            if W[k, i] != value:  # clamped (or NaN): nothing moves it
                for p in range(size):
                    row[p] = 0.0
                continue
            for m in range(n):
                G[m] = 0.0
            for m in range(n_x):
                c = lags.column[m]
                if 0 <= c < n:
                    total = 0.0
                    for r in range(n_rules):
                        total += phi[r] * par.theta[r, i, m]
                    G[c] += total
            for j in range(n_z):
                c = lags.z_column[j]
                if c < n and par.z_range[0, j] < z[j] < par.z_range[1, j]:
                    slope = 0.0
                    for r in range(n_rules):
                        slope -= phi[r] * (part[r] - value) * lean[r, j] * inverse[r, j]
                    G[c] += slope
            f = G[0]
            for p in range(size):
                row[p] = f * S[0, p]
            for c in range(1, n):
                f = G[c]
                for p in range(size):
                    row[p] += f * S[c, p]
            for r in range(n_rules):
                if phi[r] == 0.0:
                    continue
                base = (r * n + i) * n_x
                for m in range(n_x):
                    row[base + m] += phi[r] * x[m]
                lever = phi[r] * (part[r] - value)
                for j in range(n_z):
                    pull = lever * lean[r, j]
                    row[at_centre + r * n_z + j] += pull * inverse[r, j]
                    row[at_width + r * n_z + j] += pull * lean[r, j]
        for i in range(n):  # slices would cost as much as all the rest
            for p in range(size):
                S[i, p] = new[i, p]
        for i in range(n_y):
            for p in range(size):
                J[k - rows[0], i, p] = new[i, p]
