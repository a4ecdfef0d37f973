"""The simulation error of a TS state-space model: cost, gradient and Gauss-Newton matrix.

The vector of unknowns is [theta | c | log s | one initial state per run]. The compiled free run of the
dynamic TS model serves as it is: states stand where its outputs stand, at lag 1, and only the first n_y
of them are compared with data. Cutting the runs into windows, each with an initial state of its own, is
multiple shooting without continuity (Bock 1983; Ribeiro et al. 2020, "On the smoothness of nonlinear system
identification"): short windows make a smoother cost with fewer bad minima.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.compiled import Parameters, free_run
from flysid.model.rules.free_run_error import Body
from flysid.model.rules.start_state import state_sensitivities
from flysid.model.rules.state_layout import StateLayout

_CHUNK = 512  # rows of sensitivities at a time: they stay in the cache
_HOLD = 3.0  # on memberships, relative to the ridge on consequents
_DRIFT = 1e-5  # on the hidden states' scale and origin, which no output shows


@dataclass(frozen=True, eq=False)
class StateProblem:
    """Normalised data and everything about a model that refinement does not move.

    Attributes
    ----------
    layout : states, lags and scaling.
    runs : W of every run or window; only the first n_y and the input columns are data.
    z_range : (2, n_z) range of the antecedents in training.
    limits : (2, n) normalised limits of the states.
    metric : (m, m) weight of a departure of one rule's consequents (n, n_x), flattened, from their mean.
    ridge : factor on that, and on how far memberships have moved from where a refinement began.
    """

    layout: StateLayout
    runs: tuple[FloatArray, ...]
    z_range: FloatArray
    limits: FloatArray
    metric: FloatArray
    ridge: float = 0.0

    @property
    def samples(self) -> int:
        """Compared numbers."""
        return sum(len(W) - self.layout.depth + 1 for W in self.runs) * self.layout.n_y

    def parameters(self, body: Body) -> Parameters:
        """Kernel parameters of a body, whose `a` are the consequents themselves."""
        parts = (body.a, body.centre, body.width, self.z_range, self.limits)
        return Parameters(*(np.ascontiguousarray(p) for p in parts))

    def simulate(self, body: Body, initial: FloatArray) -> list[FloatArray]:
        """W of every run with its states simulated from the given ones (S, n)."""
        lags, par, d, n = self.layout.lags, self.parameters(body), self.layout.depth, self.layout.n
        runs = []
        for W, x in zip(self.runs, initial, strict=True):
            run = W.copy()
            run[d - 1, :n] = x
            free_run(run, d, lags, par)
            runs.append(run)
        return runs


@dataclass(frozen=True, eq=False)
class StateError:
    """The cost that Levenberg-Marquardt lowers: mean squared simulation error plus the ridge.

    `body` is where the refinement begins; `free` marks which of its numbers may move.
    """

    problem: StateProblem
    body: Body
    free: FloatArray
    initial: FloatArray

    def start(self) -> FloatArray:
        """The vector of unknowns at the beginning."""
        return np.concatenate([self.body.vector()[self.free > 0], self.initial.ravel()])

    def split(self, p: FloatArray) -> tuple[Body, FloatArray]:
        """Body and initial states at a vector of unknowns."""
        whole = self.body.vector()
        count = int((self.free > 0).sum())
        whole[self.free > 0] = p[:count]
        body = self.body.moved(whole)
        low, high = self.problem.z_range
        span = np.maximum(high - low, 1e-12)
        centre, width = np.clip(body.centre, low, high), np.clip(body.width, 0.02 * span, 3.0 * span)
        return replace(body, centre=centre, width=width), p[count:].reshape(self.initial.shape)

    def _start_cost(self, initial: FloatArray) -> float:
        hidden = initial[:, self.problem.layout.n_y :]
        return _DRIFT * float((hidden * hidden).mean()) if hidden.size else 0.0

    def normal(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Cost, Gauss-Newton matrix H and half the gradient g, so that a full step is -H^-1 g."""
        body, initial = self.split(p)
        problem, n = self.problem, self.problem.layout.n
        count = int((self.free > 0).sum())
        H, g, total = np.zeros((len(p), len(p))), np.zeros(len(p)), 0.0
        for s, W in enumerate(problem.runs):
            with np.errstate(over="ignore", invalid="ignore"):  # an unstable trial; the search rejects it
                block, slope, square = _run_normal(problem, body, W, initial[s], self.free)
            total += square
            own = slice(count + s * n, count + (s + 1) * n)
            H[:count, :count] += block[:count, :count]
            H[own, own], H[:count, own], H[own, :count] = (
                block[count:, count:],
                block[:count, count:],
                block[count:, :count],
            )
            g[:count] += slope[:count]
            g[own] = slope[count:]
        samples = problem.samples
        H, g, total = H / samples, g / samples, total / samples
        self._add_ridge(H, g, body, initial)
        return total + self._departure(body)[0] + self._start_cost(initial), H, g

    def _departure(self, body: Body) -> tuple[float, FloatArray]:
        """The ridge's cost and its half gradient over the whole body."""
        problem, old = self.problem, self.body
        spread = (body.a - body.a.mean(axis=0)).reshape(len(body.a), -1)
        pulled = spread @ problem.metric
        moved = _HOLD * (body.centre - old.centre) / old.width, _HOLD * np.log(body.width / old.width)
        slopes = [_HOLD * moved[0] / old.width, _HOLD * moved[1]]
        cost = float((spread * pulled).sum()) + sum(float((m * m).sum()) for m in moved)
        gradient = np.concatenate([pulled.ravel(), *(s.ravel() for s in slopes)])
        return problem.ridge * cost, problem.ridge * gradient

    def _add_ridge(self, H: FloatArray, g: FloatArray, body: Body, initial: FloatArray) -> None:
        problem, rules = self.problem, len(body.a)
        chosen = np.flatnonzero(self.free > 0)
        count = len(chosen)
        if problem.ridge:
            size = body.a.size
            full = np.zeros((body.size, body.size))
            full[:size, :size] = np.kron(np.eye(rules) - 1.0 / rules, problem.metric)
            holds = _HOLD * np.concatenate([1.0 / self.body.width.ravel(), np.ones(self.body.width.size)])
            full[np.arange(size, body.size), np.arange(size, body.size)] = holds * holds
            H[:count, :count] += problem.ridge * full[np.ix_(chosen, chosen)]
            g[:count] += self._departure(body)[1][chosen]
        n, n_y = problem.layout.n, problem.layout.n_y
        hidden = np.zeros_like(initial)
        hidden[:, n_y:] = _DRIFT / max(1, len(initial) * (n - n_y))
        H[np.arange(count, len(H)), np.arange(count, len(H))] += hidden.ravel()
        g[count:] += (hidden * initial).ravel()


def _run_normal(
    problem: StateProblem, body: Body, W: FloatArray, initial: FloatArray, free: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """J'J, J'e and e'e of one run, over the free unknowns and its own initial state."""
    columns = np.concatenate([np.flatnonzero(free > 0), body.size + np.arange(problem.layout.n)])
    whole = len(columns) == body.size + problem.layout.n
    H, g, total = np.zeros((len(columns),) * 2), np.zeros(len(columns)), 0.0
    for J, e in swept(problem, body, W, initial):
        part = J.reshape(-1, J.shape[2])
        part, error = part if whole else part[:, columns], e.ravel()
        H += part.T @ part
        g += part.T @ error
        total += float(error @ error)
    return H, g, total


def swept(
    problem: StateProblem, body: Body, W: FloatArray, initial: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """(rows, n_y, P + n) sensitivities to the body and the initial state and (rows, n_y) errors, in pieces.

    Errors are simulated less measured. The first piece is the initial state's own row.
    """
    d, n_y, n = problem.layout.depth, problem.layout.n_y, problem.layout.n
    lags, par = problem.layout.lags, problem.parameters(body)
    run = W.copy()
    run[d - 1, :n] = initial
    S = np.zeros((n, body.size + n))
    S[np.arange(n), body.size + np.arange(n)] = 1.0
    yield S[None, :n_y].copy(), (initial[:n_y] - W[d - 1, :n_y])[None]
    J = np.empty((min(_CHUNK, len(W) - d), n_y, body.size + n))
    for begin in range(d, len(W), _CHUNK):
        end = min(begin + _CHUNK, len(W))
        state_sensitivities(run, (begin, end), lags, par, n_y, S, J)
        yield J[: end - begin], run[begin:end, :n_y] - W[begin:end, :n_y]


def antecedent_range(
    layout: StateLayout, runs: Sequence[FloatArray], data: Sequence[FloatArray]
) -> FloatArray:
    """(2, n_z) range of the antecedents: hidden states along simulated runs, the rest as measured."""
    if not layout.antecedents:
        return np.zeros((2, 0))
    mixed = []
    for run, W in zip(runs, data, strict=True):
        both = W.copy()
        both[:, layout.n_y : layout.n] = run[:, layout.n_y : layout.n]
        mixed.append(layout.antecedent_values(both))
    z = np.vstack(mixed)
    return np.stack([z.min(axis=0), z.max(axis=0)])
