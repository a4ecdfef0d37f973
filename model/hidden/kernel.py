"""Compiled estimate of the state a free run starts from.

Hidden states are not measured; they are inferred from the first rows as the most likely ones: the state x
that minimises

    weight * sum_k |y(k) - yhat(k; x)|^2 + (x - m)' P (x - m)

with m and P the mean and the inverse covariance of the states along the training data (a Bayesian estimate
with Gaussian noise and prior). Gauss-Newton with forward differences; one step is exact for a linear model.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from flysid.model.fuzzy.kernel import free_run

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
