"""The simulation error of rules over all runs, its normal equations, and Levenberg-Marquardt on it.

What is summed is told in `flysid.model.rules.free_run_error`. What is summed over rows is compiled, what over
unknowns is not.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.model.bordered import Bordered
from flysid.model.compiled_filters import compiled
from flysid.model.refine import levenberg_marquardt
from flysid.model.rules.free_run_error import SETS, Body, Problem
from flysid.model.rules.kernel import IntArray, sweep

HOLD = 3.0  # weight on memberships, relative to the ridge on consequents
_DRIFT = 1e-5  # on the hidden states' scale and origin, which no output shows
Normal = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Corner (C, C), border (S, C, q), blocks (S, q, q) of a Gauss-Newton matrix, and half the gradient."""


@compiled
def _over_runs(  # type: ignore[no-untyped-def]
    starts, lags, par, basis, chosen, runs, sizes, ring, H, g, normal
):
    """The mean squared error; where `ring` has columns, J'J (lower triangle) and J'e into `normal`, as means.

    Parameters
    ----------
    starts : (S, moving n) what every run starts from.
    chosen : (C,) indices into [a | centre | log width], ascending, of the numbers that move.
    runs : all runs one below the other, their edges, and room for them to be simulated in.
    sizes : first simulated row of a run, rows before it that are unknowns, compared columns and numbers.
    H, g : (common + q, common + q), (common + q,) to work in, common the last chosen number + 1.
    """
    W, edges, X = runs
    depth, moving, n_y, samples = sizes
    n = par.theta.shape[1]
    corner, border, blocks, slope = normal
    free = chosen.size
    q = moving * n
    common = ring.shape[2] - q
    differentiates = ring.shape[2] > 0
    kept = np.empty((0, n_y, 0))
    total = 0.0
    for s in range(edges.size - 1):
        if differentiates:
            clear(ring, H, g)
        first = edges[s] + depth - moving
        for k in range(moving):
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
        rows = (edges[s] + depth, edges[s + 1])
        total += sweep(X, W, rows, lags, par, basis, q, ring, kept, H, g)
        if not differentiates:
            continue
        for i in range(free):
            a = chosen[i]
            slope[i] += g[a] / samples
            for j in range(i + 1):
                corner[i, j] += H[a, chosen[j]] / samples
            for j in range(q):
                border[s, i, j] = H[common + j, a] / samples
        for i in range(q):
            slope[free + s * q + i] = g[common + i] / samples
            for j in range(i + 1):
                value = H[common + i, common + j] / samples
                blocks[s, i, j] = value
                blocks[s, j, i] = value
    return total / samples


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
    """Mean squared simulation error, ridge, drifting states and stress at vectors of unknowns.

    The ridge holds memberships where they are in `body`.

    Parameters
    ----------
    chosen : (C,) indices into [a | centre | log width], ascending, of what moves beside the starts.
    """

    def __init__(self, problem: Problem, body: Body, chosen: IntArray) -> None:
        self.problem = problem
        self.body = body
        self.chosen = np.ascontiguousarray(chosen, dtype=np.int64)
        self.basis = np.ascontiguousarray(problem.basis)
        known = problem.parameters(body)
        self.par = known._replace(centre=known.centre.copy(), width=known.width.copy())
        layout = problem.layout
        self.q = layout.moving * layout.n
        hidden = np.arange(layout.n) >= layout.n_y
        self.drift = np.tile(_DRIFT / max(1, len(problem.runs) * layout.hidden) * hidden, layout.moving)
        width = (int(self.chosen[-1]) + 1 if self.chosen.size else 0) + self.q
        self.W, self.edges = problem.stacked
        self.X = self.W.copy()
        self.S = np.zeros((0, self.W.shape[1])) if problem.stress is None else problem.stress.copy()
        self.work = (
            np.zeros((max(layout.moving, 1), layout.n, width)),
            np.zeros((width, width)),
            np.zeros(width),
        )
        self.plain = (np.zeros((1, layout.n, 0)), np.zeros((0, 0)), np.zeros(0))

    def at(self, p: FloatArray) -> float:
        """The cost at p."""
        return self._summed(p, self.plain, self._zero(0), derive=False)

    def normal(self, p: FloatArray) -> tuple[float, Bordered, FloatArray]:
        """The cost at p, its Gauss-Newton matrix and half its gradient, over what moves."""
        normal = self._zero(self.chosen.size)
        cost = self._summed(p, self.work, normal, derive=True)
        corner, border, blocks, slope = normal
        return cost, Bordered(np.tril(corner) + np.tril(corner, -1).T, border, blocks), slope

    def _zero(self, free: int) -> Normal:
        """Normal equations to be summed into."""
        q = self.q
        runs = len(self.problem.runs)
        slope = np.zeros(free + runs * q)
        return np.zeros((free, free)), np.zeros((runs, free, q)), np.zeros((runs, q, q)), slope

    def _summed(
        self, p: FloatArray, work: tuple[FloatArray, FloatArray, FloatArray], normal: Normal, *, derive: bool
    ) -> float:
        problem = self.problem
        layout = problem.layout
        self._expand(p)
        starts = np.ascontiguousarray(p[self.body.size :].reshape(len(problem.runs), -1))
        runs = (self.W, self.edges, self.X)
        sizes = (layout.depth, layout.moving, layout.n_y, float(problem.samples))
        cost = float(
            _over_runs(starts, layout.lags, self.par, self.basis, self.chosen, runs, sizes, *work, normal)
        )
        into = normal if derive else None
        if layout.hidden:
            cost += self._drifted(starts, into)
        if problem.ridge > 0.0 and len(self.body.a) > 1:
            cost += self._departure(p, into)
        if len(self.S):
            cost += self._strayed(into)
        return cost

    def _expand(self, p: FloatArray) -> None:
        """Parameters at a vector of unknowns: centres within the data, widths that words can name."""
        if not self.chosen.size:  # as they were given
            return
        par = self.par
        body = self.body
        begin = body.a.size
        np.matmul(p[:begin].reshape(body.a.shape), self.basis, out=par.theta)
        par.theta[:] += self.problem.offset
        if par.centre.size:
            low, high = self.problem.z_range
            narrow, wide = np.outer(SETS, np.maximum(high - low, 1e-12))
            centre, width = p[begin : body.size].reshape(2, *par.centre.shape)
            np.minimum(np.maximum(centre, low), high, out=par.centre)
            np.clip(np.exp(np.minimum(width, np.log(wide) + 1.0)), narrow, wide, out=par.width)

    def _drifted(self, starts: FloatArray, normal: Normal | None) -> float:
        """What hidden states add that are far from zero where a run starts."""
        pull = starts * self.drift
        if normal is not None:
            normal[3][self.chosen.size :] += pull.ravel()
            normal[2][:] += np.diag(self.drift)
        return float((pull * starts).sum())

    def _departure(self, p: FloatArray, normal: Normal | None) -> float:
        """What the ridge is on: consequents against their mean, memberships against where they began."""
        body = self.body
        ridge = self.problem.ridge
        a = p[: body.a.size].reshape(len(body.a), -1)
        away = a - a.mean(axis=0)
        pulled = away if self.problem.metric is None else away @ self.problem.metric
        moved = HOLD * (self.par.centre - body.centre) / body.width
        grown = HOLD * np.log(self.par.width / body.width)
        if normal is not None:
            held = self._pulls * np.concatenate([moved.ravel(), grown.ravel()])
            free = self.chosen.size
            normal[3][:free] += ridge * np.concatenate([pulled.ravel(), held])[self.chosen]
            normal[0][:] += ridge * self._metric
        return ridge * float((pulled * away).sum() + (moved * moved).sum() + (grown * grown).sum())

    @cached_property
    def _pulls(self) -> FloatArray:
        """Roots of the ridge's weights on centres, then on log widths."""
        return np.concatenate([(HOLD / self.body.width).ravel(), np.full(self.body.width.size, HOLD)])

    @cached_property
    def _metric(self) -> FloatArray:
        """(C, C) the ridge's matrix over the chosen unknowns."""
        rules = len(self.body.a)
        share = np.eye(rules) - 1.0 / rules
        begin = self.body.a.size
        metric = np.eye(begin // rules) if self.problem.metric is None else self.problem.metric
        whole = np.zeros((self.body.size, self.body.size))
        whole[:begin, :begin] = np.kron(share, metric)
        whole[begin:, begin:] = np.diag(self._pulls * self._pulls)
        return np.asarray(whole[np.ix_(self.chosen, self.chosen)])

    def _strayed(self, normal: Normal | None) -> float:
        """Mean squares by which the outputs leave their range under stress; differentiated if they do."""
        square = self._under_stress(0, self.plain)
        if square > 0.0 and normal is not None:
            ring, H, g = self.work
            clear(ring, H, g)
            self._under_stress(self.q, self.work)
            chosen = self.chosen
            normal[3][: chosen.size] += g[chosen] / len(self.S)
            normal[0][:] += H[np.ix_(chosen, chosen)] / len(self.S)
        return square / len(self.S)

    def _under_stress(self, own: int, work: tuple[FloatArray, FloatArray, FloatArray]) -> float:
        layout = self.problem.layout
        nowhere = np.zeros((0, self.S.shape[1]))
        kept = np.zeros((0, layout.n_y, 0))
        rows = (layout.depth, len(self.S))
        ring, H, g = work
        return float(sweep(self.S, nowhere, rows, layout.lags, self.par, self.basis, own, ring, kept, H, g))


def descended(cost: Cost, p: FloatArray, iterations: int, tolerance: float) -> tuple[float, FloatArray]:
    """Levenberg-Marquardt from p: the cost, and the unknowns there; NaN, and p, where the start diverges.

    A trial point is simulated first, and differentiated only where its cost is lower.
    """
    place = np.concatenate([cost.chosen, np.arange(cost.body.size, p.size)])

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
