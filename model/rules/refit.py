"""A stage of refinement as a fitted model, a fitted model as a stage, and a chosen one refined once more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.model.noise import noise_models
from flysid.model.rules.boundedness import is_bounded
from flysid.model.rules.free_run_error import Body, Problem, antecedent_range, widen
from flysid.model.rules.growth import best_started, first_basis, holds_integrator, rule_support
from flysid.model.rules.judging import Candidate
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.likely_start import LikelyStart, start_spread
from flysid.model.rules.linear_starts import as_stage
from flysid.model.rules.regressor_layout import Layout
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.stages import Stage, on_other_runs, prior_of
from flysid.model.start import MAX_SHARE, most_start_rows, settled_start_rows, start_window

STEPS_ON_PARTS = 8
"""Of a known model's refinement on a part of the data."""
M = TypeVar("M", bound=RuleModel)


def refit(chosen: Candidate, data: Dataset, runs: Sequence[FloatArray], iterations: int) -> Stage:
    """The chosen model on all data, by the method that found it: what was judged is what is offered."""
    known = chosen.linear
    again = None if known is None or known.refined or chosen.moved else known.refitted(data)
    problem = chosen.stage.problem
    if again is None or again.orders != problem.layout.orders:
        return on_all_runs(chosen.stage, runs, iterations)
    stage = as_stage(again, replace(problem, runs=tuple(runs)))
    return stage if is_bounded(stage) else chosen.stage


def on_all_runs(stage: Stage, runs: Sequence[FloatArray], iterations: int) -> Stage:
    """The stage with its numbers refined on `runs`; unchanged where that would make it unstable."""
    if stage.layout.hidden:
        return on_other_runs(stage, tuple(runs)).refined(iterations, 1e-4)
    whole = antecedent_range(stage.problem.layout, runs)
    known = stage.problem.z_range
    wider = np.stack([np.minimum(whole[0], known[0]), np.maximum(whole[1], known[1])])
    # differences of measured outputs are mostly noise: their range is that of the simulation
    change = np.array([a.minus >= 0 for a in stage.problem.layout.antecedents], dtype=bool)
    problem = replace(stage.problem, runs=tuple(runs), z_range=np.where(change, known, wider))
    found = best_started(problem, stage.body).refined(iterations, 1e-5)
    return found if is_bounded(found) else stage


def as_problem(
    layout: Layout, parameters: Parameters, runs: tuple[FloatArray, ...], basis: FloatArray | None = None
) -> tuple[Problem, Body]:
    """A fitted model as refinement writes it.

    `basis`: of the consequents; by default one in which `runs` are well conditioned.
    """
    theta = parameters.theta
    p = parameters
    held = holds_integrator(theta, layout.orders.na)
    if basis is None:
        basis = first_basis(layout, runs, integrating=held)
    trained = widen(p.z_range, -layout.reach / (1.0 + 2.0 * layout.reach))
    problem = Problem(layout, runs, basis, theta[0].copy(), trained, p.limits)
    rows = (theta - theta[0]).reshape(-1, theta.shape[2]).T
    a = (np.linalg.lstsq(basis.T, rows, rcond=None)[0] if held else np.linalg.solve(basis.T, rows)).T
    return problem, Body(np.ascontiguousarray(a.reshape(*theta.shape[:2], -1)), p.centre, p.width)


def start_of(stage: Stage, dt_s: float) -> LikelyStart:
    """What the model's runs start from: the likely start, told from as many samples as help."""
    layout = stage.layout
    runs = stage.simulated()
    prior = prior_of(stage)
    fewest = layout.depth + (2 * -(-layout.n // layout.n_y) if layout.hidden else 0)
    most = most_start_rows(layout.depth, dt_s, min(len(W) for W in runs))
    spread = start_spread(layout, runs, stage.problem.parameters(stage.body), prior, round(most / MAX_SHARE))
    return LikelyStart(prior, settled_start_rows(spread, fewest, most))


def at_stage(model: M, stage: Stage, train: Dataset) -> M:
    """The model with the rules of a stage, their start, support and noise model."""
    moved = replace(
        model,
        layout=stage.layout,
        parameters=stage.problem.parameters(stage.body),
        start=start_of(stage, train.dt_s),
        support=rule_support(stage),
    )
    return with_noise_model(moved, train)


def free_run_errors(model: RuleModel, data: Dataset) -> list[FloatArray]:
    """(N - window, n_y) measured less free run per segment, after the window that starts it."""
    found = []
    for s in data.segments:
        if len(s) > model.n_init + 1:
            window = start_window(model.n_init, len(s), model.dt_s)
            found.append(s.y[window:] - model.run_from_measured(s.u, s.y[:window])[window:])
    return found


def free_run_rmse(model: RuleModel, data: Dataset) -> FloatArray:
    """(n_y,) RMSE of the free run over all segments, physical units.

    Raises
    ------
    DataError : no segment is long enough to simulate.
    """
    errors = free_run_errors(model, data)
    if not errors:
        raise DataError(f"no segment is longer than {model.n_init} samples", hint="record longer")
    gaps = np.vstack(errors)
    return np.asarray(np.sqrt((gaps * gaps).mean(axis=0)))


def with_noise_model(model: M, train: Dataset) -> M:
    """The model with a noise model, where that predicts the training data better one step ahead."""
    n = model.n_init
    pieces = [s for s in train.segments if len(s) > n + 1]
    errors = free_run_errors(model, train)
    if not errors:
        return model
    plain = replace(model, noise=None)
    noisy = replace(model, noise=noise_models(errors))
    scale = model.layout.scale[: model.layout.n_y]
    misses = [
        sum(float((((s.y - m.predict(s.u, s.y))[n:] / scale) ** 2).sum()) for s in pieces)
        for m in (plain, noisy)
    ]
    return noisy if misses[1] < misses[0] else plain
