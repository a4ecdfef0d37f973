"""A model on its way, over lags and hidden states alike: its cost, refined, ranked, a rule inserted.

What is summed is told in `flysid.model.rules.free_run_error`. What is summed over rows is compiled, what over
unknowns is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.model.bordered import Bordered
from flysid.model.polynomials import ROUNDING
from flysid.model.refine import FIRST_DAMPING, levenberg_marquardt
from flysid.model.rules.free_run_error import SETS, Body, Problem
from flysid.model.rules.kernel import IntArray, sweep
from flysid.model.rules.likely_start import Prior, initial_states, rows_before
from flysid.model.rules.regressor_layout import Layout

HOLD = 3.0  # weight on memberships, relative to the ridge on consequents
_DRIFT = 1e-5  # on the hidden states' scale and origin, which no output shows
Normal = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Corner (C, C), border (S, C, q), blocks (S, q, q) of a Gauss-Newton matrix, and half the gradient."""
Work = tuple[FloatArray, FloatArray, FloatArray]
"""What a sweep works in: a ring of sensitivities, J'J and J'e; without columns it only simulates."""


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
        self.basis = np.ascontiguousarray(problem.basis.T)
        known = problem.parameters(body)
        self.par = known._replace(centre=known.centre.copy(), width=known.width.copy())
        layout = problem.layout
        self.q = layout.moving * layout.n
        hidden = np.arange(layout.n) >= layout.n_y
        self.drift = np.tile(_DRIFT / max(1, len(problem.runs) * layout.hidden) * hidden, layout.moving)
        self.seen = np.tile(~hidden, layout.moving).astype(np.float64)
        self.known = problem.starts(problem.runs).reshape(len(problem.runs), self.q)
        self.runs = [(W.copy(), np.ascontiguousarray(W)) for W in problem.runs]
        self.S = np.zeros((0, len(layout.scale))) if problem.stress is None else problem.stress.copy()
        common = int(self.chosen[-1]) + 1 if self.chosen.size else 0
        width = common + self.q
        self.ring = np.zeros((max(layout.moving, 1), layout.n, width))
        for k, column in enumerate(range(common, width)):  # of a run that begins with what moves
            row, i = divmod(k, layout.n)
            self.ring[(layout.uncompared + row) % len(self.ring), i, column] = 1.0
        self.H = np.diag(np.concatenate([np.zeros(common), self.seen]))
        self.work = (np.zeros_like(self.ring), np.zeros((width, width)), np.zeros(width))
        self.kept = np.zeros((0, layout.n_y, 0))
        self.plain = (np.zeros((1, layout.n, 0)), np.zeros((0, 0)), np.zeros(0))

    def at(self, p: FloatArray) -> float:
        """The cost at p."""
        return self._sum_up(p, self.plain, None)

    def normal(self, p: FloatArray) -> tuple[float, Bordered, FloatArray]:
        """The cost at p, its Gauss-Newton matrix and half its gradient, over what moves."""
        q = self.q
        runs = len(self.runs)
        free = self.chosen.size
        sums = np.zeros((free, free)), np.zeros((runs, free, q)), np.zeros((runs, q, q))
        normal = (*sums, np.zeros(free + runs * q))
        cost = self._sum_up(p, self.work, normal)
        corner, border, blocks, slope = normal
        return cost, Bordered(_symmetric(corner), border, _symmetric(blocks)), slope

    def _sum_up(self, p: FloatArray, work: Work, normal: Normal | None) -> float:
        problem = self.problem
        self._expand(p)
        starts = p[self.body.size :].reshape(self.known.shape)
        cost = self._miss(starts, work, normal)
        if problem.layout.hidden:
            cost += self._drift(starts, normal)
        if problem.ridge > 0.0 and len(self.body.a) > 1:
            cost += self._departure(p, normal)
        if len(self.S):
            cost += self._stray(normal)
        return cost

    def _miss(self, starts: FloatArray, work: Work, normal: Normal | None) -> float:
        """Mean squares of simulated less measured outputs, of what every run starts from as well."""
        layout = self.problem.layout
        begun = slice(layout.uncompared, layout.depth)
        gaps = (starts - self.known) * self.seen
        total = float((gaps * gaps).sum())
        ring, H, g = work
        size = len(self.H) - self.q
        both = np.zeros((size, size))
        along = np.zeros(size)
        for at, (X, W) in enumerate(self.runs):
            X[begun, : layout.n] = starts[at].reshape(-1, layout.n)
            if normal is None:
                total += self._sweep(X, W, 0, work)
                continue
            ring[:] = self.ring
            H[:] = self.H
            g[:size] = 0.0
            g[size:] = gaps[at]
            total += self._sweep(X, W, self.q, work)
            both += H[:size, :size]
            along += g[:size]
            normal[1][at] = H[size:, self.chosen].T
            normal[2][at] = H[size:, size:]
            normal[3][self.chosen.size + at * self.q :][: self.q] = g[size:]
        if normal is not None:
            normal[0][:] = both[np.ix_(self.chosen, self.chosen)]
            normal[3][: self.chosen.size] = along[self.chosen]
            for part in normal:
                part /= self.problem.samples
        return total / self.problem.samples

    def _sweep(self, X: FloatArray, W: FloatArray, own: int, work: Work) -> float:
        layout = self.problem.layout
        rows = (layout.depth, len(X))
        ring, H, g = work
        return float(sweep(X, W, rows, layout.lags, self.par, self.basis, own, ring, self.kept, H, g))

    def _expand(self, p: FloatArray) -> None:
        """Parameters at a vector of unknowns: centres within the data, widths that words can name."""
        if not self.chosen.size:  # as they were given
            return
        par = self.par
        body = self.body
        begin = body.a.size
        np.matmul(p[:begin].reshape(body.a.shape), self.problem.basis, out=par.theta)
        par.theta[:] += self.problem.offset
        if par.centre.size:
            low, high = self.problem.z_range
            narrow, wide = np.outer(SETS, np.maximum(high - low, 1e-12))
            centre, width = p[begin : body.size].reshape(2, *par.centre.shape)
            np.minimum(np.maximum(centre, low), high, out=par.centre)
            np.clip(np.exp(np.minimum(width, np.log(wide) + 1.0)), narrow, wide, out=par.width)

    def _drift(self, starts: FloatArray, normal: Normal | None) -> float:
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

    def _stray(self, normal: Normal | None) -> float:
        """Mean squares by which the outputs leave their range under stress; differentiated if they do."""
        nowhere = np.zeros((0, self.S.shape[1]))
        square = self._sweep(self.S, nowhere, 0, self.plain)
        if square > 0.0 and normal is not None:
            for part in self.work:
                part[:] = 0.0
            self._sweep(self.S, nowhere, self.q, self.work)
            chosen = self.chosen
            _, H, g = self.work
            normal[3][: chosen.size] += g[chosen] / len(self.S)
            normal[0][:] += H[np.ix_(chosen, chosen)] / len(self.S)
        return square / len(self.S)


def _symmetric(lower: FloatArray) -> FloatArray:
    """Matrices (..., n, n) of which only the lower triangles are known."""
    return np.where(np.tri(lower.shape[-1], dtype=bool), lower, np.swapaxes(lower, -1, -2))


def descend(cost: Cost, p: FloatArray, iterations: int, tolerance: float) -> tuple[float, FloatArray]:
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


@dataclass(frozen=True, eq=False)
class Stage:
    """A model on its way: problem, numbers, starts of runs (S, moving, n), the cost reached in training."""

    problem: Problem
    body: Body
    initial: FloatArray
    cost: float = np.inf

    @property
    def rules(self) -> int:
        """Number of rules."""
        return len(self.body.a)

    @property
    def layout(self) -> Layout:
        """Lags or states, antecedents, scaling."""
        return self.problem.layout

    @property
    def unknowns(self) -> FloatArray:
        """[a | centre | log width | starts] as one vector."""
        return np.concatenate([self.body.vector(), self.initial.ravel()])

    def at(self, p: FloatArray, cost: float) -> Stage:
        """The stage at another vector of unknowns."""
        body = self.body.moved(p[: self.body.size]).within(self.problem.z_range)
        return replace(self, body=body, initial=p[self.body.size :].reshape(self.initial.shape), cost=cost)

    def under(self, **changes: Any) -> Stage:
        """The same stage under a problem that is changed so, its runs started as they were."""
        return replace(self, problem=replace(self.problem, **changes))

    def simulated(self) -> list[FloatArray]:
        """W of every run, simulated."""
        return self.problem.simulate(self.body, self.initial)

    def mean_square(self) -> float:
        """Mean squared simulation error, without the ridge."""
        first = self.layout.uncompared
        n_y = self.layout.n_y
        total = 0.0
        for run, W in zip(self.simulated(), self.problem.runs, strict=True):
            gap = run[first:, :n_y] - W[first:, :n_y]
            total += float((gap * gap).sum())
        return total / self.problem.samples

    def cost_of(self, chosen: IntArray | None = None) -> Cost:
        """The cost by the unknowns; the ridge holds memberships where they are in this stage.

        Parameters
        ----------
        chosen : indices of the numbers of the body that move beside the starts; all free ones where None.
        """
        return Cost(self.problem, self.body, self.body.free if chosen is None else chosen)

    def priced(self) -> Stage:
        """The same stage with the cost of where it is: mean squared error in variances, ridge, stress."""
        return replace(self, cost=self.cost_of().at(self.unknowns))

    def normal(self) -> tuple[float, Bordered, FloatArray]:
        """Cost, its Gauss-Newton matrix H and half its gradient g, so that a full step is -H^-1 g."""
        return self.cost_of().normal(self.unknowns)

    def refined(self, iterations: int, tolerance: float, chosen: IntArray | None = None) -> Stage:
        """The stage after Levenberg-Marquardt on the simulation error.

        Itself, its cost infinite, where it diverges from the start. `chosen` as in `cost_of`.
        """
        cost, p = descend(self.cost_of(chosen), self.unknowns, iterations, tolerance)
        return self.at(p, cost) if np.isfinite(cost) else replace(self, cost=np.inf)


def on_runs_of(stage: Stage, other: Stage) -> Stage:
    """A stage's model on the runs of another, started where that one is; hidden states where is likely."""
    runs = other.problem.runs
    kept = replace(stage.under(runs=runs), initial=other.initial)
    if not stage.layout.hidden:
        return kept
    return min((on_other_runs(stage, runs), kept), key=lambda s: s.mean_square())


def on_other_runs(stage: Stage, runs: tuple[FloatArray, ...]) -> Stage:
    """A model over hidden states on other runs, from the most likely states."""
    problem = replace(stage.problem, runs=runs)
    par = problem.parameters(stage.body)
    return replace(
        stage, problem=problem, initial=initial_states(stage.layout, runs, par, prior_of(stage), 100)
    )


def prior_of(stage: Stage) -> Prior:
    """What training says about the starts of other runs."""
    layout = stage.layout
    starts = [rows_before(layout, run[layout.uncompared :]) for run in stage.simulated()]
    return Prior.of(np.vstack(starts), stage.mean_square())


def expected_cost(stage: Stage) -> float:
    """The cost that one regularised Gauss-Newton step on all unknowns promises; inf where it cannot."""
    cost, H, g = stage.normal()
    if not (H.is_finite() and np.isfinite(g).all()):
        return float("inf")
    diagonal = H.diagonal()
    scale = np.sqrt(np.maximum(diagonal, ROUNDING * diagonal.max()))
    step = H.damped_step(scale, FIRST_DAMPING, g)
    return float("inf") if step is None else cost + float(step @ g)


def insert(stage: Stage, centre: FloatArray, width: FloatArray) -> Stage:
    """One rule more, whose consequents are what the others conclude together at its centre.

    The blend near the centre stays nearly what it was, so that nothing learned is lost, whereas replacing
    a rule by two changes its weight against all others.
    """
    body = stage.body
    z_range = stage.problem.z_range
    distance = (centre - body.centre) / body.width
    strength = -0.5 * (distance * distance).sum(axis=1)
    phi = np.exp(strength - strength.max())
    blend = np.einsum("r,rim->im", phi / phi.sum(), body.a)
    if stage.rules == 1:  # the first rule moves to the other side, or the two would be one
        mirrored = 2.0 * z_range.mean(axis=0) - centre
        away = np.where(width < 1.5 * np.ptp(z_range, axis=0), mirrored, centre)
        body = Body(body.a, np.clip(away, *z_range)[None], width[None])
    grown = Body(
        np.concatenate([body.a, blend[None]]),
        np.vstack([body.centre, centre]),
        np.vstack([body.width, width]),
    )
    return replace(stage, body=grown)


def ordered(stage: Stage) -> Stage:
    """The same model with its rules in the order of their centres, first antecedent first."""
    body = stage.body
    if body.centre.shape[1] == 0:
        return stage
    order = np.lexsort(body.centre.T[::-1])
    return replace(stage, body=Body(body.a[order], body.centre[order], body.width[order]))
