"""The simulation error of rules over all runs, its normal equations, and Levenberg-Marquardt on it.

What is summed is told in `flysid.model.rules.free_run_error`. What is summed over rows is compiled, what over
unknowns is not.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.model.bordered import Bordered
from flysid.model.refine import levenberg_marquardt
from flysid.model.rules.kernel import IntArray, Lags, Parameters, compiled, sweep

HOLD = 3.0  # weight on memberships, relative to the ridge on consequents
SETS = (0.02, 3.0)
"""Widths in ranges of the antecedent: sets that words can name."""
Normal = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Corner (C, C), border (S, C, q), blocks (S, q, q) of a Gauss-Newton matrix, and half the gradient."""


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
def _over_runs(  # type: ignore[no-untyped-def]
    starts, lags, par, basis, chosen, runs, ring, H, g, normal
):
    """The mean squared error; where `ring` has columns, J'J (lower triangle) and J'e into `normal`, as means.

    Parameters
    ----------
    starts : (S, moving n) what every run starts from.
    runs : W and `edges` of `Fixed`, sizes, and X as W, to run in.
    H, g : (common + q, common + q), (common + q,) to work in, common the last chosen number + 1.
    """
    W, edges, size, X = runs
    n = par.theta.shape[1]
    n_y = size.n_y
    corner, border, blocks, slope = normal
    free = chosen.size
    q = size.moving * n
    common = ring.shape[2] - q
    differentiates = ring.shape[2] > 0
    kept = np.empty((0, n_y, 0))
    total = 0.0
    for s in range(edges.size - 1):
        if differentiates:
            clear(ring, H, g)
        first = edges[s] + size.depth - size.moving
        for k in range(size.moving):
            for i in range(n):
                X[first + k, i] = starts[s, k * n + i]
                gap = X[first + k, i] - W[first + k, i]
                if i < n_y:
                    total += gap * gap
                if differentiates:
                    own = common + k * n + i
                    ring[(first + k) % ring.shape[0], i, own] = 1.0
                    if i < n_y:
                        H[own, own] += 1.0
                        g[own] += gap
        rows = (edges[s] + size.depth, edges[s + 1])
        total += sweep(X, W, rows, lags, par, basis, q, ring, kept, H, g)
        if not differentiates:
            continue
        for i in range(free):
            a = chosen[i]
            slope[i] += g[a] / size.samples
            for j in range(i + 1):
                corner[i, j] += H[a, chosen[j]] / size.samples
            for j in range(q):
                border[s, i, j] = H[common + j, a] / size.samples
        for i in range(q):
            slope[free + s * q + i] = g[common + i] / size.samples
            for j in range(i + 1):
                value = H[common + i, common + j] / size.samples
                blocks[s, i, j] = value
                blocks[s, j, i] = value
    return total / size.samples


@compiled
def clear(ring, H, g):  # type: ignore[no-untyped-def]
    """Set what a sweep adds to back to zero."""
    for d in range(ring.shape[0]):
        for i in range(ring.shape[1]):
            for p in range(ring.shape[2]):
                ring[d, i, p] = 0.0
    for p in range(g.size):
        g[p] = 0.0
        for q in range(g.size):
            H[p, q] = 0.0


class Cost:
    """Mean squared simulation error, ridge, unlikely starts and stress at vectors of unknowns."""

    def __init__(self, lags: Lags, par: Parameters, fixed: Fixed, size: Sizes) -> None:
        rules, self.n, _ = par.theta.shape
        self.lags = lags
        self.par = par._replace(theta=par.theta.copy(), centre=par.centre.copy(), width=par.width.copy())
        self.fixed = fixed
        self.size = size
        self.shape = (rules, self.n, len(fixed.basis))
        self.consequents = int(np.prod(self.shape))
        self.unknowns = self.consequents + 2 * par.centre.size
        self.runs = len(fixed.edges) - 1
        q = size.moving * self.n
        past = lags.lag[(lags.column >= 0) & (lags.column < self.n)]
        seen = np.concatenate([lags.z_lag, lags.z_minus])[np.tile(lags.z_column < self.n, 2)]
        deepest = max(1, past.max(initial=1), seen.max(initial=1))
        width = (fixed.chosen[-1] + 1 if fixed.chosen.size else 0) + q
        span = np.maximum(fixed.z_known[1] - fixed.z_known[0], 1e-12)
        self.widths = (SETS[0] * span, SETS[1] * span)
        self.weighed = bool(fixed.weight.any())
        self.X = fixed.W.copy()
        self.S = fixed.stress.copy()
        self.work = (np.zeros((deepest, self.n, width)), np.zeros((width, width)), np.zeros(width))
        self.plain = (np.zeros((1, self.n, 0)), np.zeros((0, 0)), np.zeros(0))

    def at(self, p: FloatArray) -> float:
        """The cost at p."""
        return self._summed(p, self.plain, self._zero(0), derive=False)

    def normal(self, p: FloatArray) -> tuple[float, Bordered, FloatArray]:
        """The cost at p, its Gauss-Newton matrix and half its gradient, over what moves."""
        normal = self._zero(self.fixed.chosen.size)
        cost = self._summed(p, self.work, normal, derive=True)
        corner, border, blocks, slope = normal
        return cost, Bordered(np.tril(corner) + np.tril(corner, -1).T, border, blocks), slope

    def _zero(self, free: int) -> Normal:
        """Normal equations to be summed into."""
        q = self.size.moving * self.n
        runs = self.runs
        slope = np.zeros(free + runs * q)
        return np.zeros((free, free)), np.zeros((runs, free, q)), np.zeros((runs, q, q)), slope

    def _summed(
        self, p: FloatArray, work: tuple[FloatArray, FloatArray, FloatArray], normal: Normal, *, derive: bool
    ) -> float:
        fixed = self.fixed
        self._expand(p)
        starts = np.ascontiguousarray(p[self.unknowns :].reshape(self.runs, -1))
        runs = (fixed.W, fixed.edges, self.size, self.X)
        ring, H, g = work
        cost = float(
            _over_runs(starts, self.lags, self.par, fixed.basis, fixed.chosen, runs, ring, H, g, normal)
        )
        into = normal if derive else None
        if self.weighed:
            cost += self._unlikely(starts, into)
        if self.size.ridge > 0.0 and self.shape[0] > 1:
            cost += self._departure(p, into)
        if len(self.S):
            cost += self._strayed(into)
        return cost

    def _expand(self, p: FloatArray) -> None:
        """Parameters at a vector of unknowns: centres within the data, widths that words can name."""
        if not self.fixed.chosen.size:  # as they were given
            return
        par = self.par
        begin = self.consequents
        np.matmul(p[:begin].reshape(self.shape), self.fixed.basis, out=par.theta)
        par.theta[:] += self.fixed.offset
        if par.centre.size:
            low, high = self.fixed.z_known
            narrow, wide = self.widths
            centre, width = p[begin : self.unknowns].reshape(2, *par.centre.shape)
            np.minimum(np.maximum(centre, low), high, out=par.centre)
            np.clip(np.exp(np.minimum(width, np.log(wide) + 1.0)), narrow, wide, out=par.width)

    def _unlikely(self, starts: FloatArray, normal: Normal | None) -> float:
        """What the runs' starts add."""
        away = starts - self.fixed.likely
        pull = away @ self.fixed.weight
        if normal is not None:
            normal[3][self.fixed.chosen.size :] += pull.ravel()
            normal[2][:] += self.fixed.weight
        return float((pull * away).sum())

    def _departure(self, p: FloatArray, normal: Normal | None) -> float:
        """What the ridge is on: consequents against their mean, memberships against where they began."""
        fixed = self.fixed
        rules = self.shape[0]
        ridge = self.size.ridge
        a = p[: self.consequents].reshape(rules, -1)
        away = a - a.mean(axis=0)
        pulled = away @ fixed.metric
        moved = HOLD * (self.par.centre - fixed.centre) / fixed.width
        grown = HOLD * np.log(self.par.width / fixed.width)
        if normal is not None:
            pulls = np.concatenate([(HOLD / fixed.width).ravel(), np.full(grown.size, HOLD)])
            held = pulls * np.concatenate([moved.ravel(), grown.ravel()])
            free = fixed.chosen.size
            normal[3][:free] += ridge * np.concatenate([pulled.ravel(), held])[fixed.chosen]
            normal[0][:] += ridge * self._metric
        return ridge * float((pulled * away).sum() + (moved * moved).sum() + (grown * grown).sum())

    @cached_property
    def _metric(self) -> FloatArray:
        """(C, C) the ridge's matrix over the chosen unknowns."""
        rules = self.shape[0]
        share = np.eye(rules) - 1.0 / rules
        pulls = np.concatenate([(HOLD / self.fixed.width).ravel(), np.full(self.par.width.size, HOLD)])
        whole = np.zeros((self.unknowns, self.unknowns))
        whole[: self.consequents, : self.consequents] = np.kron(share, self.fixed.metric)
        whole[self.consequents :, self.consequents :] = np.diag(pulls * pulls)
        return np.asarray(whole[np.ix_(self.fixed.chosen, self.fixed.chosen)])

    def _strayed(self, normal: Normal | None) -> float:
        """Mean squares by which the outputs leave their range under stress; differentiated if they do."""
        rows = (self.size.depth, len(self.S))
        q = self.size.moving * self.n
        nowhere = np.zeros((0, self.S.shape[1]))
        kept = np.zeros((0, self.size.n_y, 0))
        basis = self.fixed.basis
        ring, H, g = self.plain
        square = float(sweep(self.S, nowhere, rows, self.lags, self.par, basis, 0, ring, kept, H, g))
        if square > 0.0 and normal is not None:
            ring, H, g = self.work
            clear(ring, H, g)
            sweep(self.S, nowhere, rows, self.lags, self.par, basis, q, ring, kept, H, g)
            chosen = self.fixed.chosen
            normal[3][: chosen.size] += g[chosen] / len(self.S)
            normal[0][:] += H[np.ix_(chosen, chosen)] / len(self.S)
        return square / len(self.S)


def descended(cost: Cost, p: FloatArray, iterations: int, tolerance: float) -> tuple[float, FloatArray]:
    """Levenberg-Marquardt from p: the cost, and the unknowns there; NaN, and p, where the start diverges.

    A trial point is simulated first, and differentiated only where its cost is lower.
    """
    place = np.concatenate([cost.fixed.chosen, np.arange(cost.unknowns, p.size)])

    def whole(theta: FloatArray) -> FloatArray:
        found = p.copy()
        found[place] = theta
        return found

    try:
        end = levenberg_marquardt(
            lambda theta: cost.normal(whole(theta)),
            p[place],
            cost=lambda theta: cost.at(whole(theta)),
            max_iterations=iterations,
            tolerance=tolerance,
        )
    except FitError:
        return float("nan"), p
    return end.cost, whole(end.theta)
