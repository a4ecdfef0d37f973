"""The simulation error of rules over all runs, its gradient, its Gauss-Newton matrix, the descent on it.

The vector of unknowns is [a | c | log s | start of every run]: consequent coordinates a (theta = offset +
a @ basis), centres, log widths, and what every run starts from, which is estimated along with the rest, as
output-error methods do (Ljung 1999, section 10.5). Over lags that are the last outputs before the first
computed one (measured first samples carry noise, and at 100 Hz their differences carry little else), over
hidden states the state before it. Cutting runs into pieces, each with a start of its own, is multiple
shooting without continuity (Bock 1983).

The basis is what makes fast-sampled data tractable. Lag polynomials at 100 Hz are nearly singular; in a
basis where the refined linear model's Gauss-Newton matrix is the identity they are not, and a ridge there
has a meaning: the simulated variance that a departure from the common linear model would cause. Over states
the consequents stand as they are, and `metric` says the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.bordered import Bordered
from flysid.model.rules.descent import SETS, Cost, Fixed, Sizes, descended
from flysid.model.rules.kernel import IntArray, Parameters, free_run, sweep
from flysid.model.rules.regressor_layout import Layout

_DRIFT = 1e-5  # on the hidden states' scale and origin, which no output shows


@dataclass(frozen=True, eq=False)
class Body:
    """The numbers that refinement moves.

    Attributes
    ----------
    a : (R, n, n_b) consequent coordinates.
    centre, width : (R, n_z) memberships, normalised units.
    """

    a: FloatArray
    centre: FloatArray
    width: FloatArray

    @property
    def size(self) -> int:
        """Unknowns apart from the runs' starts."""
        return int(self.a.size + 2 * self.centre.size)

    @property
    def free(self) -> IntArray:
        """Which of `vector()` may move: memberships only where there are several rules."""
        return np.arange(self.size if len(self.a) > 1 else self.a.size)

    def vector(self) -> FloatArray:
        """All numbers as one vector."""
        return np.concatenate([self.a.ravel(), self.centre.ravel(), np.log(self.width).ravel()])

    def moved(self, p: FloatArray) -> Body:
        """The body at another vector."""
        m = self.a.size
        n = self.centre.size
        return Body(
            p[:m].reshape(self.a.shape).copy(),
            p[m : m + n].reshape(self.centre.shape).copy(),
            np.exp(np.clip(p[m + n : m + 2 * n], -30, 30)).reshape(self.centre.shape),
        )

    def within(self, z_range: FloatArray) -> Body:
        """Centres within the data, widths within `SETS` of its range."""
        low, high = z_range
        span = np.maximum(high - low, 1e-12)
        width = np.clip(self.width, SETS[0] * span, SETS[1] * span)
        return replace(self, centre=np.clip(self.centre, low, high), width=width)


@dataclass(frozen=True, eq=False)
class Problem:
    """Normalised data and everything about a model that refinement does not move.

    Attributes
    ----------
    layout : lags or states, and scaling.
    runs : W of every run, each longer than the depth; only the first n_y and the input columns are data.
    basis, offset : (n_b, n_x) and (n, n_x); consequents are offset + a @ basis. The offset keeps what
        was reached before a change of basis, to the last digit. n_b = n_x, but for a plant that integrates:
        there no row of the basis moves the sum over an output's lags, which the offset puts at 1.
    z_range : (2, n_z) range of the antecedents in training. They are clamped `layout.reach` beyond it: a
        blend that froze at the edge would change its slope there.
    limits : (2, n) normalised limits of what is simulated.
    ridge : weight on the spread of the rules' consequents about their mean, and on how far memberships
        have moved from where a refinement began.
    stress : W of inputs under which the model must stay near the range of its training, or None.
    metric : (n n_b, n n_b) weight of a departure of one rule's coordinates, flattened, in that ridge; None:
        the identity.
    """

    layout: Layout
    runs: tuple[FloatArray, ...]
    basis: FloatArray
    offset: FloatArray
    z_range: FloatArray
    limits: FloatArray
    ridge: float = 0.0
    stress: FloatArray | None = None
    metric: FloatArray | None = None

    @property
    def samples(self) -> int:
        """Compared numbers."""
        return sum(len(W) - self.layout.uncompared for W in self.runs) * self.layout.n_y

    @property
    def integrates(self) -> bool:
        """Whether every model of this problem has a pole at one."""
        return bool(len(self.basis) < self.basis.shape[1])

    @cached_property
    def stacked(self) -> tuple[FloatArray, IntArray]:
        """All runs one below the other, and where each begins and ends."""
        edges = np.cumsum([0, *(len(W) for W in self.runs)])
        return np.ascontiguousarray(np.vstack(self.runs)), edges.astype(np.int64)

    @property
    def sizes(self) -> Sizes:
        """The problem's numbers as the compiled descent takes them."""
        layout = self.layout
        return Sizes(layout.depth, layout.moving, layout.n_y, float(self.samples), float(self.ridge))

    def fixed(self, body: Body, chosen: IntArray) -> Fixed:
        """What a descent from a body does not move, as the compiled code takes it."""
        W, edges = self.stacked
        layout = self.layout
        m = self.layout.n * len(self.basis)
        hidden = np.arange(layout.n) >= layout.n_y
        drift = np.where(hidden, _DRIFT / max(1, len(self.runs) * int(hidden.sum())), 0.0)
        return Fixed(
            np.ascontiguousarray(self.basis),
            np.ascontiguousarray(self.offset),
            np.eye(m) if self.metric is None else np.ascontiguousarray(self.metric),
            np.ascontiguousarray(body.centre),
            np.ascontiguousarray(body.width),
            np.ascontiguousarray(self.z_range),
            np.ascontiguousarray(chosen, dtype=np.int64),
            W,
            edges,
            np.zeros((0, W.shape[1])) if self.stress is None else np.ascontiguousarray(self.stress),
            np.zeros(layout.moving * layout.n),
            np.diag(np.tile(drift, layout.moving)),
        )

    def parameters(self, body: Body) -> Parameters:
        """Kernel parameters of a body."""
        return Parameters(
            np.ascontiguousarray(self.offset + body.a @ self.basis),
            np.ascontiguousarray(body.centre),
            np.ascontiguousarray(body.width),
            widened(self.z_range, self.layout.reach),
            np.ascontiguousarray(self.limits),
        )

    def simulate(self, body: Body, initial: FloatArray) -> list[FloatArray]:
        """W of every run, simulated from the given starts (S, moving, n)."""
        par = self.parameters(body)
        return [started_run(self.layout, W, start, par) for W, start in zip(self.runs, initial, strict=True)]

    def starts(self, runs: Sequence[FloatArray]) -> FloatArray:
        """(S, moving, n) what given runs, simulated or measured, start from."""
        d = self.layout.depth
        moving = self.layout.moving
        n = self.layout.n
        return np.stack([W[d - moving : d, :n] for W in runs])

    def measured_initial(self) -> FloatArray:
        """(S, moving, n) first outputs as measured."""
        return self.starts(self.runs)

    def smooth_initial(self) -> FloatArray:
        """(S, moving, n) first rows on a straight line through the beginning of every run.

        Noisy lags of a high order can start a simulation that runs into its limits, where no gradient
        shows the way back.
        """
        d = self.layout.depth
        n = self.layout.n
        found = []
        for W in self.runs:
            rows = np.arange(min(len(W), max(2 * d, 10)), dtype=np.float64)
            line = np.polynomial.polynomial.polyfit(rows, W[: len(rows), :n], 1)
            found.append((np.vander(rows[:d], 2, increasing=True) @ line)[d - self.layout.moving :])
        return np.stack(found)

    def with_antecedents(self, layout: Layout) -> Problem:
        """The same data for other antecedents."""
        return replace(self, layout=layout, z_range=antecedent_range(layout, self.runs))


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
        problem = self.problem
        fixed = problem.fixed(self.body, self.body.free if chosen is None else chosen)
        return Cost(problem.layout.lags, problem.parameters(self.body), fixed, problem.sizes)

    def priced(self) -> Stage:
        """The same stage with the cost of where it is: mean squared error in variances, ridge, stress."""
        return replace(self, cost=self.cost_of().at(self.unknowns))

    def normal(self) -> tuple[float, Bordered, FloatArray]:
        """Cost, its Gauss-Newton matrix H and half its gradient g, so that a full step is -H^-1 g."""
        return self.cost_of().normal(self.unknowns)

    def descended(self, iterations: int, tolerance: float, chosen: IntArray | None = None) -> Stage:
        """The stage after Levenberg-Marquardt on the simulation error.

        Itself, its cost infinite, where it diverges from the start. `chosen` as in `cost_of`.
        """
        cost, p = descended(self.cost_of(chosen), self.unknowns, iterations, tolerance)
        return self.at(p, cost) if np.isfinite(cost) else replace(self, cost=np.inf)


def widened(limits: FloatArray, times: float) -> FloatArray:
    """(2, n) ranges, wider by so many times themselves on each side."""
    margin = times * (limits[1] - limits[0])
    return np.ascontiguousarray(np.stack([limits[0] - margin, limits[1] + margin]))


def antecedent_range(layout: Layout, runs: Sequence[FloatArray]) -> FloatArray:
    """(2, n_z) smallest and largest antecedent in the data."""
    z = np.vstack([layout.antecedent_values(W) for W in runs])
    return np.stack([z.min(axis=0), z.max(axis=0)]) if z.shape[1] else np.zeros((2, 0))


def started_run(layout: Layout, W: FloatArray, start: FloatArray, par: Parameters) -> FloatArray:
    """W simulated from the last (moving, n) rows before the first computed one."""
    run = W.copy()
    d = layout.depth
    run[d - layout.moving : d, : layout.n] = start
    free_run(run, d, layout.lags, par)
    return run


def swept(
    problem: Problem, body: Body, run: FloatArray, *, chunk: int = 1024
) -> Iterator[tuple[slice, FloatArray]]:
    """Rows of a free run and their sensitivities (rows, n_y, P) to the body, in pieces of bounded memory.

    Parameters
    ----------
    run : W, whose first `depth` rows are the start, which hangs on nothing; the others are computed in place.
    chunk : rows of sensitivities that are handed out at a time.
    """
    ring = _ring(problem.layout, body.size)
    for begin in range(problem.layout.depth, len(run), chunk):
        rows = slice(begin, min(begin + chunk, len(run)))
        yield rows, _sensitivities(problem, body, run, rows, ring)


def run_sensitivities(
    problem: Problem, body: Body, W: FloatArray, initial: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, n_y, P + moving n) sensitivities of a free run, those to its start last, and (N, n_y) errors.

    Errors are measured less simulated.

    Parameters
    ----------
    W : (N, n + n_u) measured run, normalised.
    initial : (moving, n) its start.
    """
    layout = problem.layout
    d = layout.depth
    n = layout.n
    n_y = layout.n_y
    first = layout.depth - layout.moving
    run = W.copy()
    run[first:d, :n] = initial
    ring = _ring(layout, body.size + initial.size)
    J = np.zeros((len(W), n_y, body.size + initial.size))
    for k in range(layout.moving):
        own = body.size + k * n + np.arange(n)
        ring[(first + k) % len(ring), np.arange(n), own] = 1.0
        J[first + k, np.arange(n_y), own[:n_y]] = 1.0
    J[d:] = _sensitivities(problem, body, run, slice(d, len(W)), ring)
    return J, W[:, :n_y] - run[:, :n_y]


def _ring(layout: Layout, columns: int) -> FloatArray:
    lags = layout.lags
    past = [lag for c, lag in zip(lags.column, lags.lag, strict=True) if 0 <= c < layout.n]
    past += [max(a.lag, a.minus) for a in layout.antecedents if a.column < layout.n]
    return np.zeros((max(past, default=1), layout.n, columns))


def _sensitivities(
    problem: Problem, body: Body, run: FloatArray, rows: slice, ring: FloatArray
) -> FloatArray:
    J = np.empty((rows.stop - rows.start, problem.layout.n_y, ring.shape[2]))
    basis = np.ascontiguousarray(problem.basis)
    par = problem.parameters(body)
    within = (rows.start, rows.stop)
    lags = problem.layout.lags
    own = ring.shape[2] - body.size
    sweep(run, run, within, lags, par, basis, own, ring, J, np.zeros((0, 0)), np.zeros(0))
    return J
