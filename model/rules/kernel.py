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

One kernel runs models, with or without sensitivities, in plain loops over scalars and with one signature:
slices, broadcasting, linear algebra and a second copy of the loop would each take seconds to compile.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.model.compiled_filters import GONE, compiled

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


_SILENT = math.log(GONE)


def free_run(W: FloatArray, first: int, lags: Lags, par: Parameters) -> None:
    """Write the simulated columns of rows first.. of W (N, n + n_u) from its own earlier rows, in place."""
    none = np.zeros((1, par.theta.shape[1], 0))
    nothing = np.zeros((0, 0))
    sweep(W, W, (first, len(W)), lags, par, nothing, 0, none, np.zeros((0, 0, 0)), nothing, np.zeros(0))


def predict(W: FloatArray, first: int, steps: int, lags: Lags, par: Parameters) -> FloatArray:
    """(N, n) `steps`-ahead predictions along measured W; rows before first + steps - 1 are NaN."""
    n = par.theta.shape[1]
    ahead = np.full((len(W), n), np.nan)
    begin = np.arange(first, len(W) - steps + 1)
    found: list[FloatArray] = []

    def past(column: int, lag: int) -> FloatArray:
        """A column so many rows before the one that is computed, foretold where it is not measured yet."""
        if column < 0:
            return np.ones(len(begin))
        step = len(found)
        known = W[begin + step - lag, column]
        return found[step - lag][:, column] if column < n and lag <= step else np.asarray(known)

    for _ in range(steps if len(begin) else 0):
        x = np.stack([past(*term) for term in zip(lags.column, lags.lag, strict=True)], axis=1)
        z = np.empty((len(begin), len(lags.z_lag)))
        for j, (column, lag, minus) in enumerate(zip(lags.z_column, lags.z_lag, lags.z_minus, strict=True)):
            z[:, j] = past(column, lag) - (past(column, minus) if minus >= 0 else 0.0)
        value = np.einsum("kr,rim,km->ki", strengths(z, par), par.theta, x, optimize=True)
        found.append(np.clip(np.where(np.isnan(value), par.limits[0], value), *par.limits))
    if found:
        ahead[first + steps - 1 :] = found[-1]
    return ahead


def firing(W: FloatArray, first: int, lags: Lags, par: Parameters) -> FloatArray:
    """(N, R) normalised firing strengths along W; rows before `first` repeat row `first`."""
    rules = len(par.theta)
    if first >= len(W):
        return np.full((len(W), rules), 1.0 / rules)
    rows = np.arange(first, len(W))[:, None]
    minus = np.where(lags.z_minus < 0, 0.0, W[rows - lags.z_minus * (lags.z_minus > 0), lags.z_column])
    strength = strengths(W[rows - lags.z_lag, lags.z_column] - minus, par)
    return np.concatenate([np.repeat(strength[:1], first, axis=0), strength])


def strengths(z: FloatArray, par: Parameters) -> FloatArray:
    """(N, R) normalised firing strengths at antecedents z (N, n_z), of many rows at once."""
    lean = (np.clip(z, *par.z_range)[:, None, :] - par.centre) / par.width
    loud = -0.5 * (lean * lean).sum(axis=2)
    gap = loud - loud.max(axis=1, keepdims=True)
    strength = np.where(gap > _SILENT, np.exp(gap), 0.0)
    total = strength.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, strength / np.where(total > 0.0, total, 1.0), 1.0 / len(par.theta))


@compiled
def _add(rows, errors, H, g):  # type: ignore[no-untyped-def]
    """Four rows J and errors e into J'J (lower triangle) and J'e: one pass over the sums for all of them."""
    for p in range(g.size):
        a = rows[0, p]
        b = rows[1, p]
        c = rows[2, p]
        d = rows[3, p]
        g[p] += a * errors[0] + b * errors[1] + c * errors[2] + d * errors[3]
        for q in range(p + 1):
            H[p, q] += a * rows[0, q] + b * rows[1, q] + c * rows[2, q] + d * rows[3, q]


@compiled
def sweep(X, W, rows, lags, par, basis, own, ring, J, H, g):  # type: ignore[no-untyped-def]
    """Free run of rows[0] <= k < rows[1], with sensitivities where `ring` has columns; squared errors' sum.

    Parameters
    ----------
    X : (N, n + n_u) simulated columns are written in place.
    W : (N, n + n_u) what they are compared with, in its first J.shape[1] columns; without rows, errors are
        how far outputs leave the range of training on their way to the limits.
    rows : first row, row after the last.
    basis : (n_x, n_b); consequent coordinates a with theta = offset + a @ basis.T.
    own : of the columns of sensitivities so many, the last (the start), only propagate; those before are the
        first of the unknowns [a (R n n_b) | centre | log width].
    ring : (D, n, M) sensitivities of row k in ring[k % D], D at least the deepest lag. Holds those of the
        rows before rows[0]; on return of the last. Without columns there is only the run.
    J : (rows, n_y, M) filled with the sensitivities of compared columns; (0, n_y, 0) to keep none.
    H, g : (M, M), (M,) J'J (lower triangle) and J'e are added to them; empty to leave that out.
    """
    n_rules, n, n_x = par.theta.shape
    n_z = lags.z_lag.size
    n_b = basis.shape[1]
    n_y = J.shape[1]
    deep = ring.shape[0]
    size = ring.shape[2]
    common = size - own
    stressed = W.shape[0] == 0
    x = np.empty(n_x)
    z = np.zeros(n_z)
    phi = np.ones(n_rules)
    e = np.empty(n_b)
    part = np.empty(n_rules)
    inverse = np.empty((n_rules, n_z))
    lean = np.zeros((n_rules, n_z))
    G = np.empty((deep, n))
    new = np.empty((n, size))
    at_centre = n_rules * n * n_b
    at_width = at_centre + n_rules * n_z
    several = np.zeros((4, size))
    errors = np.zeros(4)
    waiting = 0
    sums = H.shape[0] > 0
    keeps = J.shape[0] > 0
    square = 0.0
    for r in range(n_rules):
        for j in range(n_z):
            inverse[r, j] = 1.0 / par.width[r, j]
    slot = rows[0] % deep - 1
    for k in range(rows[0], rows[1]):
        slot += 1  # k % deep, without a division
        if slot == deep:
            slot = 0
        for m in range(n_x):
            c = lags.column[m]
            x[m] = 1.0 if c < 0 else X[k - lags.lag[m], c]
        if n_rules > 1:  # a single one speaks wherever it is, and does not lean anywhere
            for j in range(n_z):
                value = X[k - lags.z_lag[j], lags.z_column[j]]
                if lags.z_minus[j] >= 0:
                    value -= X[k - lags.z_minus[j], lags.z_column[j]]
                z[j] = min(max(value, par.z_range[0, j]), par.z_range[1, j])
            top = -np.inf
            for r in range(n_rules):
                phi[r] = 0.0
                for j in range(n_z):
                    lean[r, j] = (z[j] - par.centre[r, j]) / par.width[r, j]  # as exported C does
                    phi[r] -= 0.5 * lean[r, j] * lean[r, j]
                top = max(top, phi[r])
            total = 0.0
            for r in range(n_rules):
                gap = phi[r] - top
                phi[r] = math.exp(gap) if gap > _SILENT else 0.0
                total += phi[r]
            for r in range(n_rules):  # the sum is 0 only where z is not a number
                phi[r] = phi[r] / total if total > 0.0 else 1.0 / n_rules
        if size > 0:
            for m in range(n_b):
                e[m] = basis[0, m] * x[0]
            for c in range(1, n_x):
                for m in range(n_b):
                    e[m] += basis[c, m] * x[c]
        for i in range(n):
            value = 0.0
            for r in range(n_rules):
                if phi[r] > 0.0 or size > 0:
                    total = 0.0
                    for m in range(n_x):
                        total += par.theta[r, i, m] * x[m]
                    part[r] = total
                    value += phi[r] * total
            # NaN becomes the low limit
            X[k, i] = min(value, par.limits[1, i]) if value > par.limits[0, i] else par.limits[0, i]
            if size == 0:
                continue
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
                past = slot - 1 - d
                if past < 0:
                    past += deep
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
        if size > 0:
            for i in range(n):
                for p in range(size):
                    ring[slot, i, p] = new[i, p]
        for i in range(n_y):
            if stressed:  # half of the margin is free: a plant may well go further under unseen inputs
                free = (par.limits[1, i] - par.limits[0, i]) / 6.0
                error = max(X[k, i] - (par.limits[1, i] - free), 0.0)
                error += min(X[k, i] - (par.limits[0, i] + free), 0.0)
            else:
                error = X[k, i] - W[k, i]
            square += error * error
            if keeps:
                for p in range(size):
                    J[k - rows[0], i, p] = new[i, p]
            if sums and not (stressed and error == 0.0):
                for p in range(size):
                    several[waiting, p] = new[i, p]
                errors[waiting] = error
                waiting += 1
                if waiting == len(several):
                    _add(several, errors, H, g)
                    waiting = 0
    if waiting > 0:
        for m in range(waiting, len(several)):
            for p in range(size):
                several[m, p] = 0.0
        _add(several, errors, H, g)
    return square
