"""Compiled: the simulation error of rules over all runs and its normal equations; the descent on it.

What is summed is told in `flysid.model.rules.free_run_error`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.bordered_step import Normal, damped_step, diagonal_of
from flysid.model.rules.kernel import IntArray, Lags, Parameters, compiled, simulate, stray, sweep

HOLD = 3.0  # weight on memberships, relative to the ridge on consequents
# widths in ranges of the antecedent: sets that words can name
_NARROWEST = 0.02
_WIDEST = 3.0
_MOST_LOG_WIDTH = 30.0
_FIRST_DAMPING = 1e-3
_LARGEST_DAMPING = 1e16
_SMALLEST_DAMPING = 1e-24
_SMALLEST_RELAXATION = 0.1


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


@compiled
def _expand(p, fixed, par):  # type: ignore[no-untyped-def]
    """Parameters at a vector of unknowns: centres within the data, widths that words can name."""
    n_rules, n, n_x = par.theta.shape
    n_b = fixed.basis.shape[0]
    n_z = par.centre.shape[1]
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
            low = fixed.z_known[0, j]
            high = fixed.z_known[1, j]
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
    m = n * fixed.basis.shape[0]
    n_z = par.centre.shape[1]
    total = 0.0
    at = n_rules * m
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
    q = size.moving * n
    total = 0.0
    pull = np.empty(size.moving * n)
    for s in range(fixed.edges.size - 1):
        total += _begin(p, at + s * q, s, fixed, size, n, X)
        total += size.samples * _unlikely(p, at + s * q, fixed, pull)
        begin = fixed.edges[s] + size.depth
        end = fixed.edges[s + 1]
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
            total += stray(S[k, i], par.limits, i) ** 2
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
    free = corner.shape[0]
    q = size.moving * n
    runs = fixed.edges.size - 1
    common = ring.shape[2] - q
    none = np.empty((0, size.n_y, 0))
    pull = np.empty(q)
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


def _workspace(
    lags: Lags, par: Parameters, fixed: Fixed, size: Sizes
) -> tuple[Parameters, tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """Parameters, runs and arrays to work in: private copies."""
    n = par.theta.shape[1]
    own = par._replace(theta=par.theta.copy(), centre=par.centre.copy(), width=par.width.copy())
    past = lags.lag[(lags.column >= 0) & (lags.column < n)]
    seen = np.concatenate([lags.z_lag, lags.z_minus])[np.tile(lags.z_column < n, 2)]
    deepest = max(1, past.max(initial=1), seen.max(initial=1))
    common = fixed.chosen[-1] + 1 if fixed.chosen.size else 0
    width = common + size.moving * n
    slopes = np.empty(par.theta[:, :, 0].size * len(fixed.basis) + 2 * par.centre.size)
    work = (fixed.W.copy(), fixed.stress.copy(), slopes)
    return own, work, (np.empty((deepest, n, width)), np.empty((width, width)), np.empty(width))


def _empty_normal(fixed: Fixed, q: int) -> Normal:
    free = fixed.chosen.size
    runs = fixed.edges.size - 1
    return Normal(
        np.empty((free, free)), np.empty((runs, free, q)), np.empty((runs, q, q)), np.empty(free + runs * q)
    )


def descend(
    p: FloatArray, lags: Lags, par: Parameters, fixed: Fixed, size: Sizes, iterations: int, tolerance: float
) -> tuple[float, Normal]:
    """Levenberg-Marquardt from p, which moves in place; the cost in the end, and its `Normal` there.

    The method is that of `flysid.model.refine`. A trial point is simulated first, and differentiated only
    where its cost is lower. The cost is not a number where the start of the search diverges. With 0
    iterations p stays where it is; with fewer, nothing is differentiated, either. The loop is not compiled:
    that would compile all that it calls once more (docs/measured/search.md).
    """
    own, (X, S, slopes), (ring, H, g) = _workspace(lags, par, fixed, size)
    normal, other = (_empty_normal(fixed, size.moving * par.theta.shape[1]) for _ in range(2))
    place = np.concatenate([fixed.chosen, np.arange(slopes.size, p.size)])
    count = place.size
    step = np.empty(count)
    diagonal = np.empty(count)
    if iterations < 0:
        return _cost(p, lags, own, fixed, size, X, S, slopes), normal
    cost = _normal(p, lags, own, fixed, size, X, S, slopes, ring, H, g, normal)
    if not (diagonal_of(normal, diagonal) and math.isfinite(cost)) or iterations == 0:
        return (cost if iterations == 0 else math.nan), normal
    scale = np.sqrt(diagonal)
    scale = np.maximum(scale, 1e-8 * (scale.max(initial=0.0) or 1.0))
    damping = _FIRST_DAMPING
    growth = 2.0
    tries = 0
    while tries < iterations:
        if cost == 0.0 or np.abs(normal.slope / scale).max(initial=0.0) <= 1e-14 * math.sqrt(cost):
            break
        tries += 1
        better = False
        value = 0.0
        short = 0.0
        long = 0.0
        solved = damped_step(normal, scale, damping, step)
        if solved:
            trial = p.copy()
            trial[place] += step
            short = float(((scale * step) ** 2).sum())
            long = float(((scale * p[place]) ** 2).sum())
            value = _cost(trial, lags, own, fixed, size, X, S, slopes)
            if value < cost:
                value = _normal(trial, lags, own, fixed, size, X, S, slopes, ring, H, g, other)
                better = value < cost and diagonal_of(other, diagonal)
        if not better:
            damping = damping * growth
            growth = growth * 2.0
            if damping > _LARGEST_DAMPING or (solved and math.sqrt(short) <= 1e-15 * math.sqrt(long)):
                break
            tries -= growth <= 2.0**8  # the first rejections in a row cost no iteration
            continue
        predicted = damping * short - float(step @ normal.slope)
        gain = (cost - value) / predicted if predicted > 0.0 else 1.0
        damping = max(damping * max(_SMALLEST_RELAXATION, 1.0 - (2.0 * gain - 1.0) ** 3), _SMALLEST_DAMPING)
        growth = 2.0
        settled = cost - value <= tolerance * cost or math.sqrt(short) <= tolerance * math.sqrt(long)
        normal, other, cost = other, normal, value
        p[:] = trial
        scale = np.maximum(scale, np.sqrt(diagonal))
        if settled:
            break
    return cost, normal
