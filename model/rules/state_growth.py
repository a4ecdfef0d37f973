"""Growing a TS state-space model: a linear state space first, then rule after rule where it helps most.

Every stage inserts one rule, within each rule's region and along each variable (states, hidden ones
included, and inputs), ranks the places by the cost that one regularised Gauss-Newton step promises, refines
the most promising ones a little and the best fully.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.model.rules.free_run_error import Body, Problem, Stage
from flysid.model.rules.growth import with_variables, z_and_firing
from flysid.model.rules.judging import prior_of
from flysid.model.rules.realisation import Prior, Realisation, initial_states, uncorrelated
from flysid.model.rules.regressor_layout import Antecedent, Layout, windows
from flysid.model.rules.stages import expected_cost, inserted, on_runs, refine, with_ridge

_PLACES = (0.15, 0.5, 0.85)
_FIRST_PLACES = (0.1, 0.3, 0.7, 0.9)  # not the middle, from where there is no other side
_HIDDEN_LIMIT = 12.0  # spreads that a hidden state may reach
_FLOOR = 1e-3  # of the metric's diagonal, added to it: directions that the linear model does not feel
_START_ROWS = 400  # of a run from which a linear start takes its initial state
_PIECE = 600  # rows of a piece, where long records are thinned
# rows for ranking insertions, and for trying the best ones
_FEW = 3000
_MORE = 4000
_OVERFLOW = 1e9  # spreads: a state beyond has run away
_FEWEST = 10  # samples of a region that takes another rule


def linear_stage(
    layout: Layout,
    runs: tuple[FloatArray, ...],
    real: Realisation,
    ends: FloatArray,
    iterations: int,
    *,
    whiten: bool = False,
) -> Stage:
    """The refined linear model in the coordinates of `real`, hidden states scaled to their spread.

    With `whiten` in coordinates of its own: hidden states uncorrelated with the outputs and each other.

    Parameters
    ----------
    ends : (2, n_y) normalised outputs at which the plant itself saturates; infinite where it does not.
    """
    n = layout.n
    n_y = layout.n_y
    d = layout.depth
    y = np.vstack([W[d - 1 :, :n_y] for W in runs])
    margin = np.ptp(y, axis=0)
    limits = np.full((2, n), np.inf) * np.array([[-1.0], [1.0]])
    limits[:, :n_y] = np.stack([y.min(axis=0) - margin, y.max(axis=0) + margin])
    problem = unmoved(layout, runs, np.zeros((2, 0)), limits)
    nowhere = Prior(np.zeros(n), 1e-6 * np.eye(n), 1.0)
    stage = _linear(problem, real, nowhere)
    states = np.vstack([r[d - 1 :, :n] for r in stage.simulated()])
    spread = states.std(axis=0)
    middle = states.mean(axis=0)
    spread[:n_y] = 1.0
    middle[:n_y] = 0.0
    spread = np.where((spread > 1e-12) & np.isfinite(spread), spread, 1.0)
    if whiten and np.abs(states).max() < _OVERFLOW:
        T = uncorrelated(np.cov(states, rowvar=False).reshape(n, n), n_y)
        shift = T @ states.mean(axis=0)
        real = real.transformed(T, np.where(np.arange(n) < n_y, 0.0, shift))
    else:
        real = real.transformed(np.diag(1.0 / spread), np.where(np.isfinite(middle), middle, 0.0) / spread)
    limits[:, n_y:] = np.array([[-_HIDDEN_LIMIT], [_HIDDEN_LIMIT]])
    limits[0, :n_y] = np.maximum(limits[0, :n_y], ends[0])
    limits[1, :n_y] = np.minimum(limits[1, :n_y], ends[1])
    stage = _linear(problem, real, nowhere)
    stage = refine(stage, iterations, 1e-6) if iterations else stage
    H = stage.normal()[1].corner
    diagonal = np.diag(H)
    metric = H + np.diag(_FLOOR * diagonal + 1e-9 * diagonal.max())
    return replace(stage, problem=replace(stage.problem, metric=metric))


def _linear(problem: Problem, real: Realisation, prior: Prior) -> Stage:
    """One rule from a realisation, every run started from its most likely state."""
    still = np.zeros((1, 0))
    body = Body(real.consequent(problem.layout)[None], still, still)
    par = problem.parameters(body)
    initial = initial_states(problem.layout, problem.runs, par, prior, _START_ROWS)
    return Stage(problem, body, initial, np.inf)


def unmoved(layout: Layout, runs: tuple[FloatArray, ...], z_range: FloatArray, limits: FloatArray) -> Problem:
    """A problem whose consequents stand as they are, without a ridge."""
    n_x = len(layout.regressors)
    return Problem(layout, runs, np.eye(n_x), np.zeros((layout.n, n_x)), z_range, limits)


def in_windows(stage: Stage, rows: int) -> Stage:
    """The stage over windows of about `rows` rows, each started where the free run is."""
    d = stage.layout.depth
    data = windows(stage.problem.runs, d, rows)
    initial = stage.problem.starts(windows(stage.simulated(), d, rows))
    return replace(stage, problem=replace(stage.problem, runs=data), initial=initial)


def on_runs_of(stage: Stage, other: Stage) -> Stage:
    """A stage's model on the runs of another, from the most likely states."""
    moved = on_other_runs(stage, other.problem.runs)
    kept = replace(moved, initial=other.initial)
    return min((moved, kept), key=lambda s: s.mean_square())


def on_other_runs(stage: Stage, runs: tuple[FloatArray, ...]) -> Stage:
    """A stage's model on other runs, from the most likely states."""
    problem = replace(stage.problem, runs=runs)
    initial = initial_states(stage.layout, runs, problem.parameters(stage.body), prior_of(stage), 100)
    return replace(stage, problem=problem, initial=initial)


@dataclass(frozen=True)
class Insertion:
    """Where a rule goes: along which variable, in whose region, at which quantile of the variable there."""

    antecedent: Antecedent
    rule: int
    place: float

    def into(self, stage: Stage) -> Stage | None:
        """The stage with that rule more, not refined; None where the region holds next to no samples.

        The new rule takes the other rule's centre in the other variables. Its width is half the spread there.
        """
        known = stage.layout.antecedents
        wide = stage if self.antecedent in known else with_variables(stage, (*known, self.antecedent))
        z, phi = z_and_firing(wide, wide.simulated())
        return self._into(wide, z, phi.argmax(axis=1))

    def _into(self, wide: Stage, z: FloatArray, strongest: npt.NDArray[np.intp]) -> Stage | None:
        j = wide.layout.antecedents.index(self.antecedent)
        span = float(np.ptp(z[:, j]))
        chosen = z[strongest == self.rule, j]
        if len(chosen) < _FEWEST or span == 0.0:
            return None
        centre = wide.body.centre[self.rule].copy()
        width = wide.body.width[self.rule].copy()
        centre[j] = np.quantile(chosen, self.place)
        width[j] = min(max(0.5 * float(np.std(chosen)), 0.03 * span), 0.3 * span)
        if wide.rules == 1:
            width[j] = max(width[j], 0.2 * span)
        return inserted(wide, centre, width)


def insertions(stage: Stage, candidates: Sequence[Antecedent]) -> list[tuple[Insertion, Stage]]:
    """One rule more, at several places along every candidate variable in every rule's region."""
    options = []
    places = _PLACES if stage.rules > 1 else _FIRST_PLACES
    for antecedent in candidates:
        known = stage.layout.antecedents
        wide = stage if antecedent in known else with_variables(stage, (*known, antecedent))
        z, phi = z_and_firing(wide, wide.simulated())
        strongest = phi.argmax(axis=1)
        for rule, place in itertools.product(range(stage.rules), places):
            insertion = Insertion(antecedent, rule, place)
            grown = insertion._into(wide, z, strongest)
            if grown is not None:
                options.append((insertion, grown))
    return options


@dataclass(frozen=True)
class Training:
    """How a rule is trained.

    Attributes
    ----------
    ridge : of the mean square error: 0.01 is as if one more sample in a hundred said that rules are equal.
    tries : insertions tried out.
    iterations, tolerance : Levenberg-Marquardt steps of the last refinement, and when it has converged.
    """

    ridge: float = 0.01
    tries: int = 3
    iterations: int = 30
    tolerance: float = 1e-6


def one_rule_more(stage: Stage, candidates: Sequence[Antecedent], how: Training) -> Stage:
    """The best insertion, refined fully."""
    return best_insertion(stage, candidates, how)[0]


def best_insertion(
    stage: Stage, candidates: Sequence[Antecedent], how: Training
) -> tuple[Stage, Insertion | None]:
    """The stage with the best insertion, refined fully, and where that was; the stage itself where none fits.

    Promises are computed on few samples, tried out on more, and the best is refined on all.
    """
    stage = with_ridge(stage, how.ridge * stage.mean_square())
    options = insertions(thinned(stage, _FEW), candidates)
    if not options:
        return stage, None
    order = np.argsort([expected_cost(option) for _, option in options], kind="stable")[: how.tries]
    more = thinned(stage, _MORE)
    trials = [refine(on_runs(options[i][1], more), max(6, how.iterations // 3), 1e-5) for i in order]
    at = int(np.argmin([t.cost for t in trials]))
    best = trials[at]
    if more is not stage:
        best = refine(with_ridge(best, how.ridge * best.mean_square()), how.iterations, how.tolerance)
        best = on_runs_of(best, stage)
    return settled(best, how), options[order[at]][0]


def same_insertion(stage: Stage, insertion: Insertion, how: Training) -> Stage | None:
    """A rule more where another part of the data wanted it, refined fully; None where it cannot be."""
    grown = insertion.into(with_ridge(stage, how.ridge * stage.mean_square()))
    return None if grown is None else settled(grown, how)


def settled(stage: Stage, how: Training) -> Stage:
    """Refined fully, under the ridge that its present error asks for."""
    return refine(with_ridge(stage, how.ridge * stage.mean_square()), how.iterations, how.tolerance)


def thinned(stage: Stage, samples: int) -> Stage:
    """The stage on at most about `samples` rows: evenly spaced windows, started where the model is."""
    total = sum(len(W) for W in stage.problem.runs)
    if total <= samples:
        return stage
    cut = in_windows(stage, _PIECE)
    every = max(1, round(total / samples))
    runs = cut.problem.runs[::every]
    return replace(cut, problem=replace(cut.problem, runs=runs), initial=cut.initial[::every])
