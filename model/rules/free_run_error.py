"""The simulation error of a TS model over all segments, its gradient and its Gauss-Newton matrix.

The vector of unknowns is [a | c | log s | initial outputs of every segment]: consequent coordinates a
(theta = offset + a @ basis), centres, log widths, and the first `depth` outputs of every segment, which are
estimated along with the rest, as output-error methods do (Ljung 1999, section 10.5): measured first
samples carry noise, and at 100 Hz their differences carry little else.

The basis is what makes fast-sampled data tractable. Lag polynomials at 100 Hz are nearly singular; in a
basis where the refined linear model's Gauss-Newton matrix is the identity they are not, and a ridge there
has a meaning: the simulated variance that a departure from the common linear model would cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray, Segment
from flysid.model.bordered import Bordered
from flysid.model.rules.compiled import IntArray, Lags, Parameters, free_run, sensitivities
from flysid.model.rules.probe_inputs import beyond
from flysid.model.rules.regressor_layout import Layout

REACH = 0.25  # of the range of an antecedent: so far beyond the training data its rules go on as they are
_HOLD = 3.0  # on memberships, relative to the ridge on consequents
_CHUNK = 1024  # rows of sensitivities at a time: they stay in the cache


@dataclass(frozen=True, eq=False)
class Body:
    """The numbers that refinement moves.

    Attributes
    ----------
    a : (R, n_y, n_b) consequent coordinates.
    centre, width : (R, n_z) memberships, normalised units.
    """

    a: FloatArray
    centre: FloatArray
    width: FloatArray

    @property
    def size(self) -> int:
        """Unknowns apart from initial outputs."""
        return int(self.a.size + 2 * self.centre.size)

    def vector(self) -> FloatArray:
        """All numbers as one vector."""
        return np.concatenate([self.a.ravel(), self.centre.ravel(), np.log(self.width).ravel()])

    def moved(self, p: FloatArray) -> Body:
        """The body at another vector."""
        m, n = self.a.size, self.centre.size
        return Body(
            p[:m].reshape(self.a.shape).copy(),
            p[m : m + n].reshape(self.centre.shape).copy(),
            np.exp(np.clip(p[m + n : m + 2 * n], -30, 30)).reshape(self.centre.shape),
        )


@dataclass(frozen=True, eq=False)
class Problem:
    """Normalised data and everything about a model that refinement does not move.

    Attributes
    ----------
    layout : lags and scaling.
    runs : measured W of every segment, each longer than the depth.
    basis, offset : (n_b, n_x) and (n_y, n_x); consequents are offset + a @ basis. The offset keeps what
        was reached before a change of basis, to the last digit. n_b = n_x, but for a plant that integrates:
        there no row of the basis moves the sum over an output's lags, which the offset puts at 1.
    z_range : (2, n_z) range of the antecedents in training. They are clamped `REACH` beyond it: a blend that
        froze at the edge would change its slope there.
    limits : (2, n_y) normalised output limits.
    ridge : weight on the spread of the rules' consequents about their mean, and on how far memberships
        have moved from where a refinement began.
    stress : W of inputs under which the model must stay near the range of its training, or None.
    """

    layout: Layout
    runs: tuple[FloatArray, ...]
    basis: FloatArray
    offset: FloatArray
    z_range: FloatArray
    limits: FloatArray
    ridge: float = 0.0
    stress: FloatArray | None = None

    @property
    def samples(self) -> int:
        """Simulated numbers that count."""
        return sum(len(W) for W in self.runs) * self.layout.n_y

    @property
    def moving(self) -> int:
        """First outputs of every run that the free run depends on: so many, the last ones, are unknowns."""
        z = (max(a.lag, a.minus) for a in self.layout.antecedents if a.column < self.layout.n_y)
        return min(self.layout.depth, max(self.layout.orders.na, *z, 0))

    @property
    def integrates(self) -> bool:
        """Whether every model of this problem has a pole at one."""
        return bool(len(self.basis) < self.basis.shape[1])

    def parameters(self, body: Body) -> Parameters:
        """Kernel parameters of a body."""
        return Parameters(
            np.ascontiguousarray(self.offset + body.a @ self.basis),
            np.ascontiguousarray(body.centre),
            np.ascontiguousarray(body.width),
            widened(self.z_range, REACH),
            np.ascontiguousarray(self.limits),
        )

    def measured_initial(self) -> FloatArray:
        """(S, depth, n_y) first outputs as measured."""
        d, n_y = self.layout.depth, self.layout.n_y
        return np.stack([W[:d, :n_y] for W in self.runs])

    def smooth_initial(self) -> FloatArray:
        """(S, depth, n_y) first outputs on a straight line through the beginning of every run.

        Noisy lags of a high order can start a simulation that runs into its limits, where no gradient
        shows the way back.
        """
        d, n_y = self.layout.depth, self.layout.n_y
        found = []
        for W in self.runs:
            rows = np.arange(min(len(W), max(2 * d, 10)), dtype=np.float64)
            line = np.polynomial.polynomial.polyfit(rows, W[: len(rows), :n_y], 1)
            found.append(np.vander(rows[:d], 2, increasing=True) @ line)
        return np.stack(found)

    def with_antecedents(self, layout: Layout) -> Problem:
        """The same data for other antecedents."""
        return replace(self, layout=layout, z_range=antecedent_range(layout, self.runs))


def widened(limits: FloatArray, times: float) -> FloatArray:
    """(2, n) ranges, wider by so many times themselves on each side."""
    margin = times * (limits[1] - limits[0])
    return np.ascontiguousarray(np.stack([limits[0] - margin, limits[1] + margin]))


def antecedent_range(layout: Layout, runs: Sequence[FloatArray]) -> FloatArray:
    """(2, n_z) smallest and largest antecedent in the data."""
    z = np.vstack([layout.antecedent_values(W) for W in runs])
    return np.stack([z.min(axis=0), z.max(axis=0)]) if z.shape[1] else np.zeros((2, 0))


def runs_of(layout: Layout, segments: Sequence[Segment], least: int) -> tuple[FloatArray, ...]:
    """Normalised W of every segment that has at least `least` rows."""
    return tuple(layout.stack(s.u, s.y) for s in segments if len(s) >= least)


def simulate_runs(problem: Problem, body: Body, initial: FloatArray) -> list[FloatArray]:
    """W of every run with its outputs simulated from the given first outputs (S, depth, n_y)."""
    lags, par = problem.layout.lags, problem.parameters(body)
    return [_simulated(W, initial[i], lags, par) for i, W in enumerate(problem.runs)]


def _simulated(W: FloatArray, initial: FloatArray, lags: Lags, par: Parameters) -> FloatArray:
    run = W.copy()
    run[: len(initial), : initial.shape[1]] = initial
    free_run(run, len(initial), lags, par)
    return run


@dataclass(frozen=True, eq=False)
class SimulationError:
    """The cost that Levenberg-Marquardt lowers: mean squared simulation error plus the ridge.

    `free` marks which unknowns of `Body` may move (memberships may not where there is one rule).
    """

    problem: Problem
    body: Body
    free: FloatArray

    def start(self, initial: FloatArray) -> FloatArray:
        """The vector of unknowns at `body` and the given first outputs."""
        tail = initial[:, initial.shape[1] - self.problem.moving :]
        return np.concatenate([self.body.vector()[self.free > 0], tail.ravel()])

    def split(self, p: FloatArray) -> tuple[Body, FloatArray]:
        """Body and first outputs at a vector of unknowns."""
        whole = self.body.vector()
        count = int((self.free > 0).sum())
        whole[self.free > 0] = p[:count]
        initial = self.problem.measured_initial()
        first = initial.shape[1] - self.problem.moving
        initial[:, first:] = p[count:].reshape(len(initial), -1, initial.shape[2])
        return self._named(self.body.moved(whole)), initial

    def _named(self, body: Body) -> Body:
        """Centres within the data, widths between 1/50 and 3 of its range: sets that words can name."""
        low, high = self.problem.z_range
        span = np.maximum(high - low, 1e-12)
        return replace(
            body,
            centre=np.clip(body.centre, low, high),
            width=np.clip(body.width, 0.02 * span, 3.0 * span),
        )

    def cost(self, p: FloatArray) -> float:
        """Mean squared simulation error (in units of the outputs' variance) plus the ridge."""
        body, initial = self.split(p)
        n_y = self.problem.layout.n_y
        total = 0.0
        for run, W in zip(simulate_runs(self.problem, body, initial), self.problem.runs, strict=True):
            gap = run[:, :n_y] - W[:, :n_y]
            total += float(np.einsum("ni,ni->", gap, gap))
        return total / self.problem.samples + self.problem.ridge * self._departure(body) + self._stray(body)

    def _stray(self, body: Body) -> float:
        """Mean square by which the outputs leave the range under the stress inputs."""
        problem = self.problem
        if problem.stress is None:
            return 0.0
        run = problem.stress.copy()
        free_run(run, problem.layout.depth, problem.layout.lags, problem.parameters(body))
        over = beyond(run[:, : problem.layout.n_y], problem.limits)
        return float(np.einsum("ni,ni->", over, over)) / len(run)

    def normal(self, p: FloatArray) -> tuple[float, Bordered, FloatArray]:
        """Cost, its Gauss-Newton matrix H and half its gradient g, so that a full step is -H^-1 g."""
        body, initial = self.split(p)
        chosen = np.flatnonzero(self.free > 0)
        count, q = len(chosen), self.problem.moving * self.problem.layout.n_y
        runs = self.problem.runs
        corner, g, total = np.zeros((count, count)), np.zeros(count), 0.0
        border, blocks = np.zeros((len(runs), count, q)), np.zeros((len(runs), q, q))
        own = np.zeros((len(runs), q))
        for s, W in enumerate(runs):
            with np.errstate(over="ignore", invalid="ignore"):  # an unstable trial; the search rejects it
                block, slope, square = _segment_normal(self.problem, body, W, initial[s], chosen)
            total += square
            corner += block[:count, :count]
            g += slope[:count]
            border[s], blocks[s], own[s] = block[:count, count:], block[count:, count:], slope[count:]
        n = self.problem.samples
        corner, g = corner / n, g / n
        if self.problem.ridge:
            self._add_ridge(corner, g, body)
        cost = total / n + self.problem.ridge * self._departure(body)
        if self.problem.stress is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                block, slope, square = _stress_normal(self.problem, body, self.problem.stress, chosen)
            m = len(self.problem.stress)
            corner, g, cost = corner + block / m, g + slope / m, cost + square / m
        return cost, Bordered(corner, border / n, blocks / n), np.concatenate([g, own.ravel() / n])

    def _departures(self, body: Body) -> tuple[FloatArray, FloatArray]:
        """What the ridge is on, and what one unit of each unknown but the first outputs adds to it.

        Consequents are held to their mean; centres (in widths) and log widths to where they started,
        weakly, so that no direction of the search is flat.
        """
        old = self.body
        parts = (
            body.a - body.a.mean(axis=0),
            _HOLD * (body.centre - old.centre) / old.width,
            _HOLD * np.log(body.width / old.width),
        )
        ones = np.ones(old.width.size)
        values = np.concatenate([part.ravel() for part in parts])
        slopes = np.concatenate([np.ones(body.a.size), _HOLD / old.width.ravel(), _HOLD * ones])
        return values, slopes

    def _departure(self, body: Body) -> float:
        values, _ = self._departures(body)
        return float(values @ values)

    def _add_ridge(self, H: FloatArray, g: FloatArray, body: Body) -> None:
        """Add the ridge's half gradient and its matrix; of one rule, the departure is zero."""
        rules, m = len(body.a), body.a[0].size
        if rules == 1:
            return
        values, slopes = self._departures(body)
        g += self.problem.ridge * values * slopes
        H[np.diag_indices_from(H)] += self.problem.ridge * slopes * slopes
        at = np.arange(rules * m).reshape(rules, m)
        H[at[:, None, :], at[None, :, :]] -= self.problem.ridge / rules


def _segment_normal(
    problem: Problem, body: Body, W: FloatArray, initial: FloatArray, chosen: IntArray
) -> tuple[FloatArray, FloatArray, float]:
    """J'J, J'e and e'e of one segment, over the chosen unknowns and its own initial outputs."""
    depth, n_y = initial.shape
    first, q = depth - problem.moving, problem.moving * n_y
    columns = np.concatenate([chosen, body.size + np.arange(q)]).astype(np.int64)
    run = W.copy()
    run[:depth, :n_y] = initial
    J = np.zeros((depth + min(_CHUNK, len(W) - depth), n_y, body.size + q))
    for k in range(first, depth):
        for i in range(n_y):
            J[k, i, body.size + (k - first) * n_y + i] = 1.0
    gap = initial - W[:depth, :n_y]
    H = np.zeros((len(columns), len(columns)))
    H[len(chosen) :, len(chosen) :] = np.eye(q)
    g = np.concatenate([np.zeros(len(chosen)), gap[first:].ravel()])
    total = float((gap * gap).sum())
    whole = len(columns) == J.shape[2]
    for rows, found in swept(problem, body, run, J):
        part = found.reshape(-1, J.shape[2])
        part = part if whole else part[:, columns]
        error = (run[rows, :n_y] - W[rows, :n_y]).ravel()
        H += part.T @ part
        g += part.T @ error
        total += float(error @ error)
    return H, g, total


def swept(
    problem: Problem, body: Body, run: FloatArray, J: FloatArray | None = None
) -> Iterator[tuple[slice, FloatArray]]:
    """Rows of a free run and their sensitivities (rows, n_y, P + Q), in pieces of bounded memory.

    Parameters
    ----------
    run : W, whose first `depth` rows are the start; the others are computed in place.
    J : (depth + rows of a piece, n_y, P + Q) to work in, whose first rows are the start's; None where the
        start hangs on nothing (Q = 0). What was given out before is overwritten.
    """
    depth, n_y = problem.layout.depth, problem.layout.n_y
    lags, par = problem.layout.lags, problem.parameters(body)
    basis = np.ascontiguousarray(problem.basis)
    if J is None:
        J = np.zeros((depth + min(_CHUNK, max(len(run) - depth, 0)), n_y, body.size))
    for begin in range(depth, len(run), _CHUNK):
        end = min(begin + _CHUNK, len(run))
        sensitivities(run, (begin, end, begin - depth), lags, par, basis, J)
        yield slice(begin, end), J[depth : depth + end - begin]
        J[:depth] = J[end - begin : end - begin + depth].copy()


def _stress_normal(
    problem: Problem, body: Body, W: FloatArray, chosen: IntArray
) -> tuple[FloatArray, FloatArray, float]:
    """J'J, J'e and e'e of how far the stress run leaves the range."""
    n_y, run = problem.layout.n_y, W.copy()
    H, g, total = np.zeros((len(chosen), len(chosen))), np.zeros(len(chosen)), 0.0
    for rows, found in swept(problem, body, run):
        over = beyond(run[rows, :n_y], problem.limits).ravel()
        outside = np.flatnonzero(over)
        if len(outside):
            part = found.reshape(-1, found.shape[2])[outside][:, chosen]
            H += part.T @ part
            g += part.T @ over[outside]
            total += float(over @ over)
    return H, g, total
