"""Growing a TS model: a refined linear model first, then rule after rule where it helps most.

The linear start is one-step least squares, moved off its noise bias by instrumental variables (the
instruments are the model's own simulation: Young 1970, Soderstrom and Stoica 1983), then refined on the
simulation error. Every later stage tries to split each rule along each antecedent (the idea of LOLIMOT,
Nelles 2001), ranks the splits by what one Gauss-Newton step on the new consequents promises, refines the
most promising ones a little and the best one fully.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.tskernel import firing
from flysid.model.tslayout import Antecedent, Layout
from flysid.model.tsproblem import (
    Body,
    Problem,
    SimulationError,
    levenberg_marquardt,
    simulate_runs,
)


@dataclass(frozen=True, eq=False)
class Stage:
    """A refined model: its problem, its numbers, the first outputs, and the cost reached in training."""

    problem: Problem
    body: Body
    initial: FloatArray
    cost: float

    @property
    def rules(self) -> int:
        """Number of rules."""
        return len(self.body.a)


def first_basis(layout: Layout, runs: tuple[FloatArray, ...]) -> FloatArray:
    """(n_x, n_x) basis in which the measured regressors are uncorrelated with unit mean square.

    Lags are turned into differences of growing order first: at 100 Hz the lags themselves are equal to
    three digits, and a direct factorisation would lose what tells them apart.
    """
    differences = _difference_matrix(layout)
    X = np.vstack([regressors(layout, W) for W in runs]) @ differences.T
    size = np.sqrt((X * X).mean(axis=0))
    size[size == 0] = 1.0
    _, s, vt = np.linalg.svd(np.linalg.qr(X / size, mode="r") / np.sqrt(len(X)))
    floor = np.maximum(s, 1e-12 * s[0])
    return np.asarray((vt / floor[:, None]) @ (differences / size[:, None]))


def _difference_matrix(layout: Layout) -> FloatArray:
    """(n_x, n_x) maps the lags of every signal to their differences of order 0, 1, 2, ..."""
    columns = [c for c, _ in layout.regressors]
    D = np.zeros((len(columns), len(columns)))
    for c in dict.fromkeys(columns):
        at = [m for m, other in enumerate(columns) if other == c]
        row = np.array([1.0])
        for m in at:
            D[m, at[: len(row)]] = row
            row = np.convolve(row, [1.0, -1.0])
    return D


def regressors(layout: Layout, W: FloatArray) -> FloatArray:
    """(N - depth, n_x) regressors of W."""
    d, n = layout.depth, len(W)
    return np.stack(
        [np.ones(n - d) if c < 0 else W[d - lag : n - lag, c] for c, lag in layout.regressors], axis=1
    )


def linear_stage(problem: Problem, iterations: int, more: tuple[Stage, ...] = ()) -> Stage:
    """The refined linear model: one rule, from the best of the linear starts and `more`."""
    estimated = min((unrefined(problem, body) for body in _linear_starts(problem)), key=lambda s: s.cost)
    short = max(8, iterations // 3)
    trials = [refine(rebased(start), short, 1e-4) for start in (*more, estimated)]
    return refine(rebased(min(trials, key=lambda s: s.cost)), iterations, 1e-6)


def unrefined(problem: Problem, body: Body | None = None) -> Stage:
    """A stage that has not seen its simulation error; one-step least squares where no body is given."""
    body = next(_linear_starts(problem)) if body is None else body
    error = SimulationError(problem, body, _free(body))
    initial = problem.measured_initial()
    return Stage(problem, body, initial, error.cost(error.start(initial)))


def embedded_start(stage: Stage, problem: Problem) -> tuple[Stage, ...]:
    """A lower-order linear model written as one of `problem`'s orders (the new lags weigh nothing)."""
    old, new = stage.problem.layout.regressors, problem.layout.regressors
    if not set(old) <= set(new):
        return ()
    theta = np.zeros((1, problem.layout.n_y, len(new)))
    theta[:, :, [new.index(term) for term in old]] = stage.problem.parameters(stage.body).theta
    body = Body(np.zeros_like(theta), stage.body.centre, stage.body.width)
    return (unrefined(replace(problem, offset=theta[0]), body),)


def _free(body: Body) -> FloatArray:
    """Which unknowns move: memberships only where there are several rules."""
    free = np.ones(body.size)
    if len(body.a) == 1:
        free[body.a.size :] = 0.0
    return free


def _linear_starts(problem: Problem) -> Iterator[Body]:
    """Least squares, then instrumental-variable estimates that start from it."""
    X = np.vstack([regressors(problem.layout, W) for W in problem.runs])
    E = X @ problem.basis.T
    d, n_y, n_z = problem.layout.depth, problem.layout.n_y, problem.z_range.shape[1]
    Y = np.vstack([W[d:, :n_y] for W in problem.runs])
    a: FloatArray = np.zeros((E.shape[1], n_y))
    for _ in range(3):  # repeated on the remainder: the regressors are nearly collinear
        a = np.asarray(a + np.linalg.lstsq(E, Y - X @ (problem.basis.T @ a), rcond=1e-13)[0])
    for _ in range(6):
        body = Body(np.ascontiguousarray(a.T[None]), problem.z_range.mean(axis=0)[None], np.ones((1, n_z)))
        yield body
        runs = simulate_runs(problem, body, problem.measured_initial())
        Z = np.vstack([regressors(problem.layout, W) for W in runs]) @ problem.basis.T
        a = np.linalg.lstsq(Z.T @ E, Z.T @ Y, rcond=1e-12)[0]


def refine(stage: Stage, iterations: int, tolerance: float) -> Stage:
    """Levenberg-Marquardt on the simulation error from where the stage is."""
    error = SimulationError(stage.problem, stage.body, _free(stage.body))
    p, cost = levenberg_marquardt(error, error.start(stage.initial), iterations, tolerance)
    body, initial = error.split(p)
    return Stage(stage.problem, body, initial, cost)


def rebased(stage: Stage) -> Stage:
    """The same one-rule model in the basis where its Gauss-Newton matrix is the identity."""
    error = SimulationError(stage.problem, stage.body, _free(stage.body))
    _, _, H = error.normal(error.start(stage.initial))
    m = stage.body.a[0].size
    n_x = stage.body.a.shape[2]
    block = sum(H[i : i + n_x, i : i + n_x] for i in range(0, m, n_x))
    values, vectors = np.linalg.eigh(np.asarray(block))
    values = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    problem = replace(
        stage.problem,
        basis=np.ascontiguousarray((vectors / values).T @ stage.problem.basis),
        offset=stage.problem.parameters(stage.body).theta[0],
    )
    return replace(stage, problem=problem, body=replace(stage.body, a=np.zeros_like(stage.body.a)))


@dataclass(frozen=True)
class Split:
    """Rule `rule` becomes two along antecedent `variable`."""

    rule: int
    variable: int


def with_variables(stage: Stage, antecedents: tuple[Antecedent, ...]) -> Stage:
    """The same model looking at more antecedents, in which every rule covers everything."""
    layout = replace(stage.problem.layout, antecedents=antecedents)
    problem = stage.problem.with_antecedents(layout)
    old = stage.problem.layout.antecedents
    span = problem.z_range[1] - problem.z_range[0]
    centre = np.tile(problem.z_range.mean(axis=0), (stage.rules, 1))
    width = np.tile(2.0 * np.maximum(span, 1e-12), (stage.rules, 1))
    for j, antecedent in enumerate(antecedents):
        if antecedent in old:
            centre[:, j] = stage.body.centre[:, old.index(antecedent)]
            width[:, j] = stage.body.width[:, old.index(antecedent)]
    return replace(stage, problem=problem, body=Body(stage.body.a, centre, width))


def split(stage: Stage, choice: Split) -> Stage:
    """Two rules in place of one, side by side along one antecedent, with the same consequents."""
    layout, body = stage.problem.layout, stage.body
    z, phi = _z_and_firing(stage)
    weight = phi[:, choice.rule] / max(phi[:, choice.rule].sum(), 1e-12)
    value = z[:, choice.variable]
    mean = float(weight @ value)
    spread = float(np.sqrt(weight @ (value - mean) ** 2))
    span = float(np.ptp(value))
    spread = min(max(spread, 0.02 * span), 0.3 * span) if span else 1.0
    a = np.concatenate([body.a, body.a[[choice.rule]]])
    centre = np.concatenate([body.centre, body.centre[[choice.rule]]])
    width = np.concatenate([body.width, body.width[[choice.rule]]])
    for r, side in ((choice.rule, -1.0), (len(a) - 1, 1.0)):
        centre[r, choice.variable] = mean + side * spread
        width[r, choice.variable] = spread
    del layout
    return replace(stage, body=Body(a, centre, width))


def _z_and_firing(stage: Stage) -> tuple[FloatArray, FloatArray]:
    """Antecedents and firing strengths along the measured runs."""
    problem = stage.problem
    lags, par = problem.layout.lags, problem.parameters(stage.body)
    d = problem.layout.depth
    z = np.vstack([problem.layout.antecedent_values(W) for W in problem.runs])
    return z, np.vstack([firing(W, d, lags, par)[d:] for W in problem.runs])


def promise(stage: Stage) -> float:
    """Fall of the cost that one regularised Gauss-Newton step on all unknowns promises."""
    error = SimulationError(stage.problem, stage.body, _free(stage.body))
    _, g, H = error.normal(error.start(stage.initial))
    scale = np.maximum(H.diagonal(), 1e-9 * H.diagonal().max())
    d = 1.0 / np.sqrt(scale)
    scaled = H * d[:, None] * d[None, :]
    scaled[np.diag_indices_from(scaled)] += 1e-3
    return float((d * g) @ np.linalg.solve(scaled, d * g))


def best_split(
    stage: Stage, candidates: tuple[Antecedent, ...], iterations: int, tries: int = 2
) -> tuple[Stage, Stage]:
    """The most promising split, before and after full refinement."""
    options: list[tuple[float, Stage]] = []
    for antecedent in candidates:
        known = stage.problem.layout.antecedents
        wide = stage if antecedent in known else with_variables(stage, (*known, antecedent))
        variable = wide.problem.layout.antecedents.index(antecedent)
        for rule in range(stage.rules):
            option = split(wide, Split(rule, variable))
            options.append((promise(option), option))
    options.sort(key=lambda pair: -pair[0])
    starts = [option for _, option in options[:tries]]
    trials = [refine(option, max(4, iterations // 4), 1e-3) for option in starts]
    at = min(range(len(trials)), key=lambda i: trials[i].cost)
    return starts[at], refine(trials[at], iterations, 1e-5)


def with_ridge(stage: Stage, ridge: float) -> Stage:
    """The same stage under another ridge on the spread of its rules."""
    return replace(stage, problem=replace(stage.problem, ridge=ridge))


def ordered(stage: Stage) -> Stage:
    """The same model with its rules in the order of their centres, first antecedent first."""
    if stage.body.centre.shape[1] == 0:
        return stage
    order = np.lexsort(stage.body.centre.T[::-1])
    body = stage.body
    return replace(stage, body=Body(body.a[order], body.centre[order], body.width[order]))


def rule_support(stage: Stage) -> FloatArray:
    """(R,) share of training samples for which each rule is the strongest."""
    _, phi = _z_and_firing(stage)
    return np.asarray(np.bincount(phi.argmax(axis=1), minlength=stage.rules) / len(phi))
