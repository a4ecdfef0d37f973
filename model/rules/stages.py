"""What is done to a model on its way, over lags and hidden states alike: refined, ranked, a rule inserted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.free_run_error import Body, Stage
from flysid.model.rules.likely_start import Prior, initial_states, rows_before

_FLAT = 1e-9  # of the largest diagonal entry: unknowns that the cost does not feel
_PROMISE_DAMPING = 1e-3


def refine(stage: Stage, iterations: int, tolerance: float) -> Stage:
    """Levenberg-Marquardt on the simulation error from where the stage is."""
    return stage.descended(iterations, tolerance)


def with_ridge(stage: Stage, ridge: float) -> Stage:
    """The same stage under another ridge on the spread of its rules."""
    return replace(stage, problem=replace(stage.problem, ridge=ridge))


def on_runs_of(stage: Stage, other: Stage) -> Stage:
    """A stage's model on the runs of another, started where that one is; hidden states where is likely."""
    runs = other.problem.runs
    kept = replace(stage, problem=replace(stage.problem, runs=runs), initial=other.initial)
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
    scale = np.sqrt(np.maximum(diagonal, _FLAT * diagonal.max()))
    step = H.damped_step(scale, _PROMISE_DAMPING, g)
    return float("inf") if step is None else cost + float(step @ g)


def inserted(stage: Stage, centre: FloatArray, width: FloatArray) -> Stage:
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
