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

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.kernel import IntArray, Parameters, free_run, sweep
from flysid.model.rules.regressor_layout import Layout

SETS = (0.02, 3.0)
"""Widths in ranges of the antecedent: sets that words can name."""


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

    def parameters(self, body: Body) -> Parameters:
        """Kernel parameters of a body."""
        return Parameters(
            np.ascontiguousarray(self.offset + body.a @ self.basis),
            np.ascontiguousarray(body.centre),
            np.ascontiguousarray(body.width),
            widen(self.z_range, self.layout.reach),
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


def widen(limits: FloatArray, times: float) -> FloatArray:
    """(2, n) ranges, wider by so many times themselves on each side."""
    margin = times * (limits[1] - limits[0])
    return np.ascontiguousarray(np.stack([limits[0] - margin, limits[1] + margin]))


def range_of(runs: Sequence[FloatArray]) -> FloatArray:
    """(2, n) smallest and largest values of every column."""
    x = np.vstack(runs)
    return np.stack([x.min(axis=0), x.max(axis=0)])


def antecedent_range(layout: Layout, runs: Sequence[FloatArray]) -> FloatArray:
    """(2, n_z) smallest and largest antecedent in the data."""
    return range_of([layout.antecedent_values(W) for W in runs])


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
    layout = problem.layout
    ring = np.zeros((max(layout.moving, 1), layout.n, body.size))
    par = problem.parameters(body)
    for begin in range(layout.depth, len(run), chunk):
        rows = slice(begin, min(begin + chunk, len(run)))
        J = np.empty((rows.stop - begin, layout.n_y, body.size))
        _sweep_into(J, layout, par, run, begin, ring, problem.basis, 0)
        yield rows, J


def run_sensitivities(
    layout: Layout, par: Parameters, W: FloatArray, start: FloatArray, basis: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """W of a free run, and the sensitivities (N - uncompared, n_y, P) of its outputs.

    To the numbers of the body, where a basis is given, then to those of the start.

    Parameters
    ----------
    W : (N, n + n_u) measured run, normalised.
    start : (moving n,) its start.
    """
    n = layout.n
    moving = layout.moving
    d = layout.depth
    common = 0 if basis is None else len(par.theta) * n * len(basis) + 2 * par.centre.size
    run = W.copy()
    run[layout.uncompared : d, :n] = start.reshape(moving, n)
    ring = np.zeros((max(moving, 1), n, common + start.size))
    J = np.zeros((len(W) - layout.uncompared, layout.n_y, common + start.size))
    for k in range(moving):
        own = common + k * n + np.arange(n)
        ring[(layout.uncompared + k) % len(ring), np.arange(n), own] = 1.0
        J[k, np.arange(layout.n_y), own[: layout.n_y]] = 1.0
    none = np.zeros((0, par.theta.shape[2]))
    _sweep_into(J[moving:], layout, par, run, d, ring, none if basis is None else basis, start.size)
    return run, J


def _sweep_into(
    J: FloatArray,
    layout: Layout,
    par: Parameters,
    run: FloatArray,
    begin: int,
    ring: FloatArray,
    basis: FloatArray,
    own: int,
) -> None:
    """Rows of a run from `begin` on with their sensitivities, as many as J (rows, n_y, P) has."""
    within = (begin, begin + len(J))
    columns = np.ascontiguousarray(basis.T)
    sweep(run, run, within, layout.lags, par, columns, own, ring, J, np.zeros((0, 0)), np.zeros(0))
