"""A chosen model refined once more: on all the training data, on new flights, after its rules were edited."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.rules.boundedness import is_bounded
from flysid.model.rules.free_run_error import Body, Problem, antecedent_range, widened
from flysid.model.rules.growth import best_started, first_basis
from flysid.model.rules.integrator import holds_integrator
from flysid.model.rules.judging import Candidate
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.linear_starts import as_stage
from flysid.model.rules.regressor_layout import Layout
from flysid.model.rules.stages import Stage, on_other_runs


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
    trained = widened(p.z_range, -layout.reach / (1.0 + 2.0 * layout.reach))
    problem = Problem(layout, runs, basis, theta[0].copy(), trained, p.limits)
    rows = (theta - theta[0]).reshape(-1, theta.shape[2]).T
    a = (np.linalg.lstsq(basis.T, rows, rcond=None)[0] if held else np.linalg.solve(basis.T, rows)).T
    return problem, Body(np.ascontiguousarray(a.reshape(*theta.shape[:2], -1)), p.centre, p.width)
