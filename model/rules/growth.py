"""Growing a TS model: a refined linear model first, then rule after rule where it helps most.

The linear start over lags is one-step least squares, moved off its noise bias by instrumental variables (the
instruments are the model's own simulation: Young 1970, Soderstrom and Stoica 1983), then refined on the
simulation error. Every later stage, over lags and hidden states alike, inserts one rule, within each rule's
region and along each antecedent (LOLIMOT, Nelles 2001, splits there), ranks the places by the cost that one
Gauss-Newton step promises, refines the most promising ones a little and the best ones fully.
`TS(refine=False)` stops at product-space clusters and one-step least squares instead (Babuska, Fuzzy Modeling
for Control, 1998).

Of a plant that integrates the pole at one is kept exactly, in the linear model and in every rule from it.
Estimated freely it comes out a little inside or outside the unit circle by what friction and noise happen to
be, and a free run that is longer or otherwise excited than the record drifts away from it. Where the sum over
an output's lags is one in every rule, it is one in every blend of them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.linear.output_error import WORSE_FIT
from flysid.model.polynomials import RCOND, ROUNDING, VANISHING
from flysid.model.rules.clustering import cluster, project
from flysid.model.rules.free_run_error import Body, Problem, antecedent_range
from flysid.model.rules.kernel import firing
from flysid.model.rules.memberships import Partition
from flysid.model.rules.regressor_layout import Antecedent, Layout, windows
from flysid.model.rules.stages import Stage, expected_cost, insert, on_runs_of
from flysid.model.start import START_SHARE, STEPS

_PLACES = (0.15, 0.5, 0.85)
_FIRST_PLACES = (0.1, 0.3, 0.7, 0.9)  # not the middle, from where there is no other side
_PIECE = 1000  # rows of a piece, where long records are thinned, and what starts it a small share
_FEW = 5000  # rows for ranking insertions and for trying the best ones
NOTHING = np.zeros(0, dtype=np.int64)
"""Of a body that stays as it is while the runs' starts are searched for."""


def first_basis(layout: Layout, runs: tuple[FloatArray, ...], *, integrating: bool = False) -> FloatArray:
    """(n_b, n_x) basis in which the measured regressors are uncorrelated with unit mean square.

    Lags are turned into differences of growing order first: at 100 Hz the lags themselves are equal to
    three digits, and a direct factorisation would lose what tells them apart. For a single output that
    integrates its level is left out (n_b = n_x - 1): only its differences are free.
    """
    differences = _difference_matrix(layout)[1 if integrating else 0 :]
    X = np.vstack([layout.regressor_values(W) for W in runs]) @ differences.T
    size = np.sqrt((X * X).mean(axis=0))
    size[size == 0] = 1.0
    return np.asarray(whitening(X / size) @ (differences / size[:, None]))


def whitening(X: FloatArray) -> FloatArray:
    """(n, n) coordinates in which the columns of X (N, n) are uncorrelated with unit mean square."""
    _, s, vt = np.linalg.svd(np.linalg.qr(X, mode="r") / np.sqrt(len(X)))
    return np.asarray(vt / np.maximum(s, 1e-12 * s.max(initial=0.0))[:, None])


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


def linear_stage(problem: Problem, iterations: int, more: tuple[Stage, ...] = ()) -> Stage:
    """The refined linear model: one rule, from the best of the linear starts and `more`."""
    estimated = min((skip_refining(problem, body) for body in _linear_starts(problem)), key=lambda s: s.cost)
    short = max(8, iterations // 3)
    trials = [rebase(start).refined(short, 1e-4) for start in (*more, estimated)]
    return rebase(min(trials, key=lambda s: s.cost)).refined(iterations, 1e-6)


def skip_refining(problem: Problem, body: Body | None = None, initial: FloatArray | None = None) -> Stage:
    """A stage that has not seen its simulation error; one-step least squares where no body is given."""
    body = next(_linear_starts(problem)) if body is None else body
    return best_started(problem, body) if initial is None else Stage(problem, body, initial).priced()


def best_started(problem: Problem, body: Body) -> Stage:
    """The stage from the first outputs that suit it best, near the measured or the smoothed ones.

    Whichever simulates better is where a search over the first outputs alone begins: noisy ones start a
    model of high order, or one that integrates, so badly that a good model would look hopeless.
    """
    starts = problem.starts(problem.runs), problem.smooth_initial()
    plain = replace(problem, ridge=0.0, stress=None)
    stage = min((skip_refining(plain, body, initial) for initial in starts), key=lambda s: s.cost)
    found = stage.refined(STEPS, 1e-3, NOTHING)
    return skip_refining(problem, body, found.initial)


def embedded_start(stage: Stage, problem: Problem) -> tuple[Stage, ...]:
    """A lower-order linear model written as one of `problem`'s orders (the new lags weigh nothing)."""
    old = stage.problem.layout.regressors
    new = problem.layout.regressors
    if not set(old) <= set(new):
        return ()
    theta = np.zeros((1, problem.layout.n_y, len(new)))
    theta[:, :, [new.index(term) for term in old]] = stage.problem.parameters(stage.body).theta
    body = Body(np.zeros((1, problem.layout.n_y, len(problem.basis))), stage.body.centre, stage.body.width)
    initial = problem.starts(stage.simulated())
    wider = replace(problem, offset=theta[0])
    # from the simulated start the lower order is a saddle that no gradient leaves; from the measured one
    # the search is pushed off it, but a noisy start may be hopeless: try both
    return skip_refining(wider, body, initial), skip_refining(wider, body)


def _linear_starts(problem: Problem) -> Iterator[Body]:
    """Least squares, then instrumental-variable estimates that start from it."""
    X = np.vstack([problem.layout.regressor_values(W) for W in problem.runs])
    E = X @ problem.basis.T
    d = problem.layout.depth
    n_y = problem.layout.n_y
    n_z = problem.z_range.shape[1]
    Y = np.vstack([W[d:, :n_y] for W in problem.runs]) - X @ problem.offset.T
    a: FloatArray = np.zeros((E.shape[1], n_y))
    for _ in range(3):  # repeated on the remainder: the regressors are nearly collinear
        remainder: FloatArray = Y - X @ (problem.basis.T @ a)
        a = a + np.asarray(np.linalg.lstsq(E, remainder, rcond=RCOND)[0], dtype=np.float64)
    for _ in range(6):
        body = Body(np.ascontiguousarray(a.T[None]), problem.z_range.mean(axis=0)[None], np.ones((1, n_z)))
        yield body
        runs = problem.simulate(body, problem.starts(problem.runs))
        Z = np.vstack([problem.layout.regressor_values(W) for W in runs]) @ problem.basis.T
        a = np.asarray(np.linalg.lstsq(Z.T @ E, Z.T @ Y, rcond=1e-12)[0], dtype=np.float64)


def rebase(stage: Stage) -> Stage:
    """The same one-rule model in the basis where its Gauss-Newton matrix is the identity.

    Where its sensitivities overflow it is no start: its cost becomes infinite.
    """
    _, whole, _ = stage.normal()
    if not whole.is_finite():
        return replace(stage, cost=float("inf"))
    H = whole.corner
    m = stage.body.a[0].size
    n_b = stage.body.a.shape[2]
    block = sum(H[i : i + n_b, i : i + n_b] for i in range(0, m, n_b))
    values, vectors = np.linalg.eigh(np.asarray(block))
    values = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    problem = replace(
        stage.problem,
        basis=np.ascontiguousarray((vectors / values).T @ stage.problem.basis),
        offset=stage.problem.parameters(stage.body).theta[0],
    )
    return replace(stage, problem=problem, body=replace(stage.body, a=np.zeros_like(stage.body.a)))


def clustered_stage(linear: Stage, antecedents: tuple[Antecedent, ...], rules: int) -> Stage:
    """`rules` rules from Gustafson-Kessel clusters, consequents by global one-step least squares.

    Raises
    ------
    DataError : fewer distinct samples than rules.
    """
    if rules == 1:
        return linear
    layout = replace(linear.problem.layout, antecedents=antecedents)
    z_range = antecedent_range(layout, linear.problem.runs)
    problem = replace(linear.problem, layout=layout, z_range=z_range)
    d = layout.depth
    n_y = layout.n_y
    z = np.vstack([layout.antecedent_values(W) for W in problem.runs])
    Y = np.vstack([W[d:, :n_y] for W in problem.runs])
    centre, width, _ = project(cluster(np.hstack([z, Y]), rules), z.shape[1], two_sided=False)
    low, high = problem.z_range
    phi = Partition(centre, width, width, low, high).firing(z)
    E = np.vstack([layout.regressor_values(W) for W in problem.runs]) @ problem.basis.T
    design = (phi[:, :, None] * E[:, None, :]).reshape(len(E), -1)
    solution = np.linalg.lstsq(design, Y, rcond=VANISHING)[0].reshape(rules, E.shape[1], n_y)
    a = np.ascontiguousarray(solution.transpose(0, 2, 1))
    return skip_refining(replace(problem, offset=np.zeros_like(problem.offset)), Body(a, centre, width))


def holds_integrator(theta: FloatArray, lags: int) -> bool:
    """Whether consequents (R, 1, n_x) sum to one over the output's lags, their first terms, in every rule."""
    sums = theta[:, 0, :lags].sum(axis=1)
    return theta.shape[1] == 1 and lags > 0 and bool((np.abs(sums - 1.0) < ROUNDING).all())


def slowest_pole(stage: Stage) -> float:
    """The largest real pole of a linear stage of one output; 0 of other stages, and where there is none."""
    layout = stage.problem.layout
    if layout.n_y != 1 or layout.orders.na == 0 or stage.rules > 1:
        return 0.0
    theta = stage.problem.parameters(stage.body).theta[0, 0, : layout.orders.na]
    poles = np.roots(np.concatenate([[1.0], -theta]))
    return float(poles[np.abs(poles.imag) < ROUNDING].real.max(initial=0.0))


def looks_integrating(stage: Stage) -> bool:
    """A linear stage of one output with a real pole that its longest run cannot tell from one."""
    longest = max(len(W) for W in stage.problem.runs)
    return slowest_pole(stage) > 1.0 - 1.0 / longest


def with_integrator(stage: Stage, iterations: int, known: Sequence[Stage] = ()) -> tuple[Stage, ...]:
    """The linear stage with its pole at one, refined; without it as well where it may be a slow lag.

    A pole outside the unit circle is offered only where one on it explains the record badly.

    Parameters
    ----------
    known : stages of lower orders that hold an integrator: further starts.
    """
    problem = integrating(stage.problem)
    theta = stage.problem.parameters(stage.body).theta[0].copy()
    theta[0, 0] += 1.0 - theta[0, : problem.layout.orders.na].sum()
    still = Body(np.zeros((1, 1, len(problem.basis))), stage.body.centre, stage.body.width)
    near = skip_refining(replace(problem, offset=theta), still)
    nested = (embedded_start(lower, problem) for lower in reversed(known) if lower.problem.integrates)
    held = linear_stage(problem, iterations, (*next(filter(None, nested), ()), near))
    outside = slowest_pole(stage) > 1.0 and held.cost <= WORSE_FIT * stage.cost
    return (held,) if outside else (held, stage)


def integrating(problem: Problem) -> Problem:
    """The problem in which the sum over the output's lags stays at one."""
    offset = np.zeros((1, len(problem.layout.regressors)))
    offset[0, 0] = 1.0
    basis = first_basis(problem.layout, problem.runs, integrating=True)
    return replace(problem, basis=np.ascontiguousarray(basis), offset=offset)


def with_variables(stage: Stage, antecedents: tuple[Antecedent, ...]) -> Stage:
    """The same model looking at more antecedents, in which every rule covers everything."""
    layout = replace(stage.layout, antecedents=antecedents)
    z_range = antecedent_range(layout, seen(stage))
    if any(a.minus >= 0 for a in antecedents):  # of measured outputs, differences are mostly noise
        change = np.array([a.minus >= 0 for a in antecedents])
        z_range = np.where(change, antecedent_range(layout, stage.simulated()), z_range)
    span = z_range[1] - z_range[0]
    centre = np.tile(z_range.mean(axis=0), (stage.rules, 1))
    width = np.tile(2.0 * np.maximum(span, 1e-12), (stage.rules, 1))
    for i, antecedent in enumerate(stage.layout.antecedents):
        if antecedent in antecedents:
            j = antecedents.index(antecedent)
            centre[:, j] = stage.body.centre[:, i]
            width[:, j] = stage.body.width[:, i]
            z_range[:, j] = stage.problem.z_range[:, i]
    problem = replace(stage.problem, layout=layout, z_range=z_range)
    initial = stage.initial
    if layout.moving > stage.layout.moving or layout.depth != stage.layout.depth:
        initial = problem.starts(stage.simulated())  # an antecedent that looks back further than any lag
    return Stage(problem, Body(stage.body.a, centre, width), initial, stage.cost)


@dataclass(frozen=True)
class Training:
    """How a rule is trained.

    Attributes
    ----------
    ridge : of the mean square error: 0.01 is as if one more sample in a hundred said that rules are equal.
    tries : insertions that are tried out, the most promising ones.
    iterations, tolerance : Levenberg-Marquardt steps of the last refinement, and when it has converged.
    """

    ridge: float = 0.01
    tries: int = 3
    iterations: int = 30
    tolerance: float = 1e-6


@dataclass(frozen=True)
class Insertion:
    """Where a rule goes: along which variable, in whose region, at which quantile of the variable there."""

    antecedent: Antecedent
    rule: int
    place: float


@dataclass(frozen=True, eq=False)
class Grown:
    """One rule more: where it went, and the stage refined with it."""

    where: Insertion
    stage: Stage


def insertions(stage: Stage, antecedents: Sequence[Antecedent]) -> list[tuple[Insertion, Stage]]:
    """One rule more, at several places along every antecedent in every rule's region."""
    places = _PLACES if stage.rules > 1 else _FIRST_PLACES
    return [
        option
        for a in antecedents
        for option in _inserted_along(
            stage, a, [Insertion(a, r, p) for r, p in itertools.product(range(stage.rules), places)]
        )
    ]


def _inserted_along(
    stage: Stage, antecedent: Antecedent, places: Sequence[Insertion]
) -> Iterator[tuple[Insertion, Stage]]:
    """The stage with a rule more at each of the places along one antecedent, where there are samples.

    Places are quantiles of the antecedent where a present rule speaks; the new rule takes that rule's centre
    in the other variables. Its width is half the spread there.
    """
    known = stage.layout.antecedents
    wide = stage if antecedent in known else with_variables(stage, (*known, antecedent))
    j = wide.layout.antecedents.index(antecedent)
    z, phi = z_and_firing(wide, wide.simulated())
    strongest = phi.argmax(axis=1)
    span = float(np.ptp(z[:, j]))
    for at in places:
        chosen = z[strongest == at.rule, j]
        if len(chosen) < len(wide.layout.regressors) or span == 0.0:  # fewer than the rule has numbers
            continue
        centre = wide.body.centre[at.rule].copy()
        width = wide.body.width[at.rule].copy()
        centre[j] = np.quantile(chosen, at.place)
        width[j] = first_width(chosen, span, stage.rules)
        yield at, insert(wide, centre, width)


def first_width(chosen: FloatArray, span: float, rules: int) -> float:
    """Of a new rule's set: half the spread of the samples where it is put, `span` being the whole range."""
    width = min(max(0.5 * float(np.std(chosen)), 0.03 * span), 0.3 * span)
    return max(width, 0.2 * span) if rules == 1 else width


def z_and_firing(stage: Stage, runs: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Antecedents and firing strengths along runs."""
    problem = stage.problem
    lags = problem.layout.lags
    par = problem.parameters(stage.body)
    d = problem.layout.depth
    z = np.vstack([problem.layout.antecedent_values(W) for W in runs])
    return z, np.vstack([firing(W, d, lags, par)[d:] for W in runs])


def seen(stage: Stage) -> list[FloatArray]:
    """Training runs as measured, with the hidden states as simulated."""
    hidden = slice(stage.layout.n_y, stage.layout.n)
    found = [W.copy() for W in stage.problem.runs]
    if stage.layout.hidden:
        for W, run in zip(found, stage.simulated(), strict=True):
            W[:, hidden] = run[:, hidden]
    return found


def thin(stage: Stage, samples: int) -> Stage:
    """The stage on at most about `samples` rows: evenly spaced windows, started where the model is."""
    total = sum(len(W) for W in stage.problem.runs)
    if total <= samples:
        return stage
    d = stage.layout.depth
    rows = max(_PIECE, round(d / START_SHARE))
    every = max(1, round(total / samples))
    runs = windows(stage.problem.runs, d, rows)[::every]
    initial = stage.problem.starts(windows(stage.simulated(), d, rows)[::every])
    return replace(stage.under(runs=runs), initial=initial)


def one_rule_more(stage: Stage, antecedents: Sequence[Antecedent], how: Training) -> Grown | None:
    """The best insertion, refined fully; None where no region has samples.

    What a Gauss-Newton step promises ranks insertions well, but for the first few: these are tried out on few
    rows, by a few steps of refinement.
    """
    stage = stage.under(ridge=how.ridge * stage.mean_square())
    few = thin(stage, _FEW)
    options = insertions(few, antecedents)
    promised = [expected_cost(grown) for _, grown in options]
    order = [i for i in np.argsort(promised, kind="stable") if np.isfinite(promised[i])][: how.tries]
    trials = [(options[i][0], options[i][1].refined(max(6, how.iterations // 3), 1e-5)) for i in order]
    if not trials:
        return None
    where, trial = min(trials, key=lambda each: each[1].cost)
    best = settle(trial, how)
    if few is not stage:
        best = settle(on_runs_of(best, stage), how)
    return Grown(where, best)


def settle(stage: Stage, how: Training) -> Stage:
    """Refined fully, under the ridge that its present error asks for."""
    return stage.under(ridge=how.ridge * stage.mean_square()).refined(how.iterations, how.tolerance)


def split(stage: Stage, antecedents: Sequence[Antecedent], rules: int) -> Stage | None:
    """`rules` rules, of which each new one concludes what the others do at its centre.

    A single rule split is the very same model. None where no region has samples for another rule.
    """
    while stage.rules < rules:
        options = insertions(stage, antecedents)
        if not options:
            return None
        stage = options[0][1]
    return stage


def same_insertion(stage: Stage, insertion: Insertion, how: Training) -> Stage | None:
    """A rule more where another part of the data wanted it, refined fully; None where it cannot be."""
    ridged = stage.under(ridge=how.ridge * stage.mean_square())
    return next((settle(s, how) for _, s in _inserted_along(ridged, insertion.antecedent, [insertion])), None)


def rule_support(stage: Stage) -> FloatArray:
    """(R,) share of training samples for which each rule is the strongest."""
    _, phi = z_and_firing(stage, seen(stage))
    return np.asarray(np.bincount(phi.argmax(axis=1), minlength=stage.rules) / len(phi))
