"""Compiled: the free run of a polynomial NARX model and its exact sensitivities.

All signals stand in one matrix W (N, n_y + n_u), outputs first, normalised. Every term is a product of at
most three factors: a column at a lag or its change since the sample before, as it is, its magnitude, or its
sign. An output is the sum of its terms,

    y_i(k) = sum_t theta_t phi_t(k),    S(k) = dy(k)/dp = dphi/dp + sum_l (df/dy(k-l)) S(k-l)

A factor may be held inside a range (`TermTable.low`, `high`), or stand for what its value has beyond it:
together these let a product go on along its tangents where signals leave the range of training
(`polynomial_terms.continued`). The recursion of S is exact but where a sign changes or a range ends. It costs
one pass, for terms of coefficient 0 too: what the free run would gain by them is known before any of them is
tried. Outputs are held at their limits inside the recursion: no polynomial runs away, and whoever fits one is
told where it would have.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from flysid.compiling import njit
from flysid.dataset import FloatArray

IntArray = npt.NDArray[np.int64]
MOST_FACTORS = 3
PLAIN, MAGNITUDE, SIGN = range(3)


class TermTable(NamedTuple):
    """T terms as compiled code takes them.

    `equation`: (T,) output whose equation a term stands in.
    `column`, `lag`: (T, 3) of every factor; column -1: none. A term without factors is the constant 1.
    `change`: (T, 3) 1: the difference to the sample before.
    `form`: (T, 3) 0 as it is, 1 magnitude, 2 sign.
    `low`, `high`: (T, 3) a factor's signal is held inside; a sign is that of the signal itself.
    `excess`: (T, 3) 1: the factor is what its signal has beyond what is held, 0 inside the range.
    """

    equation: IntArray
    column: IntArray
    lag: IntArray
    change: IntArray
    form: IntArray
    low: FloatArray
    high: FloatArray
    excess: IntArray


@njit(cache=True, error_model="numpy")
def sweep(W, rows, terms, theta, limits, S):  # type: ignore[no-untyped-def]
    """Free run of rows[0] <= k < rows[1] of W in place; how many of them were held at a limit.

    `S`: (D + rows, n_y, P) sensitivities, D at least the deepest lag; those of the D rows before are given.
        The first T columns are the coefficients', the others only propagate. Without columns: the run alone.
    """
    n_y = limits.shape[1]
    size = S.shape[2]
    deep = S.shape[0] - (rows[1] - rows[0]) if size > 0 else 1
    phi = np.empty(theta.size)
    f = np.empty(MOST_FACTORS)
    slope = np.empty(MOST_FACTORS)
    value = np.empty(n_y)
    G = np.empty((deep, n_y, n_y))
    held = 0
    for k in range(rows[0], rows[1]):
        for i in range(n_y):
            value[i] = 0.0
            for j in range(n_y):
                for d in range(deep):
                    G[d, i, j] = 0.0
        for t in range(theta.size):
            i = terms.equation[t]
            product = 1.0
            for m in range(MOST_FACTORS):
                c = terms.column[t, m]
                f[m] = 1.0
                slope[m] = 0.0
                if c < 0:
                    continue
                s = W[k - terms.lag[t, m], c]
                if terms.change[t, m] == 1:
                    s -= W[k - terms.lag[t, m] - 1, c]
                low = terms.low[t, m]
                high = terms.high[t, m]
                inside = low if s < low else (high if s > high else s)
                side = 1.0 if s > 0.0 else (-1.0 if s < 0.0 else 0.0)
                if terms.form[t, m] == PLAIN:
                    f[m] = s - inside if terms.excess[t, m] == 1 else inside
                    slope[m] = 1.0
                elif terms.form[t, m] == MAGNITUDE:
                    f[m] = abs(s) - abs(inside) if terms.excess[t, m] == 1 else abs(inside)
                    slope[m] = side
                else:
                    f[m] = side
                if (s == inside) == (terms.excess[t, m] == 1):
                    slope[m] = 0.0
                product *= f[m]
            phi[t] = product
            value[i] += theta[t] * product
            if size == 0 or theta[t] == 0.0:
                continue
            for m in range(MOST_FACTORS):
                c = terms.column[t, m]
                if c < 0 or c >= n_y or slope[m] == 0.0:
                    continue
                g = theta[t] * slope[m]
                for o in range(MOST_FACTORS):
                    if o != m:
                        g *= f[o]
                G[terms.lag[t, m] - 1, i, c] += g
                if terms.change[t, m] == 1:
                    G[terms.lag[t, m], i, c] -= g
        at = deep + k - rows[0]
        for i in range(n_y):
            # NaN becomes the low limit
            limited = min(value[i], limits[1, i]) if value[i] > limits[0, i] else limits[0, i]
            W[k, i] = limited
            held += limited != value[i]
            for p in range(size):
                S[at, i, p] = 0.0
            if size == 0 or limited != value[i]:  # nothing moves what is held
                continue
            for d in range(deep):
                for j in range(n_y):
                    g = G[d, i, j]
                    if g != 0.0:
                        for p in range(size):
                            S[at, i, p] += g * S[at - 1 - d, j, p]
        if size > 0:
            for t in range(theta.size):
                if W[k, terms.equation[t]] == value[terms.equation[t]]:
                    S[at, terms.equation[t], t] += phi[t]
    return held


def free_run(W: FloatArray, first: int, terms: TermTable, theta: FloatArray, limits: FloatArray) -> int:
    """Write the outputs of rows first.. of W from its own earlier rows; how many were held at a limit."""
    nothing = np.zeros((0, limits.shape[1], 0))
    return int(sweep(W, (first, len(W)), terms, theta, limits, nothing))


def products(terms: TermTable, past: Callable[[int, int], FloatArray], rows: int) -> FloatArray:
    """(rows, T) the terms' values, `past` giving a column (rows,) so many samples ago."""
    out = np.ones((rows, len(terms.equation)))
    for t, m in np.ndindex(*terms.column.shape):
        column = int(terms.column[t, m])
        if column < 0:
            continue
        lag = int(terms.lag[t, m])
        s = past(column, lag)
        if terms.change[t, m]:
            s = s - past(column, lag + 1)
        inside = np.clip(s, terms.low[t, m], terms.high[t, m])
        form = terms.form[t, m]
        if form == SIGN:
            out[:, t] *= np.sign(s)
            continue
        if form == MAGNITUDE:
            s, inside = np.abs(s), np.abs(inside)
        out[:, t] *= s - inside if terms.excess[t, m] else inside
    return out


def steps_ahead(
    W: FloatArray, first: int, steps: int, terms: TermTable, theta: FloatArray, limits: FloatArray
) -> FloatArray:
    """(N, n_y) predictions along measured W; rows before first + steps - 1 are NaN."""
    n_y = limits.shape[1]
    ahead = np.full((len(W), n_y), np.nan)
    begin = np.arange(first, len(W) - steps + 1)
    found: list[FloatArray] = []
    equations = (terms.equation[:, None] == np.arange(n_y)) * theta[:, None]

    def past(column: int, lag: int) -> FloatArray:
        """A column so many rows before the one that is computed, foretold where it is not measured yet."""
        step = len(found)
        known = W[begin + step - lag, column]
        return found[step - lag][:, column] if column < n_y and lag <= step else np.asarray(known)

    for _ in range(steps if len(begin) else 0):
        with np.errstate(over="ignore", invalid="ignore"):
            value = products(terms, past, len(begin)) @ equations
        found.append(np.clip(np.where(np.isnan(value), limits[0], value), *limits))
    if found:
        ahead[first + steps - 1 :] = found[-1]
    return ahead
