"""A chosen model refined once more: on all the training data, on new flights, after its rules were edited."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.fuzzy.choice import is_bounded
from flysid.model.fuzzy.grow import Stage, best_started, first_basis, refine
from flysid.model.fuzzy.kernel import Parameters
from flysid.model.fuzzy.layout import Layout
from flysid.model.fuzzy.problem import Body, Problem, antecedent_range


def on_all_runs(stage: Stage, runs: Sequence[FloatArray], iterations: int) -> Stage:
    """The stage with its numbers refined on `runs`; unchanged where that would make it unstable."""
    whole, known = antecedent_range(stage.problem.layout, runs), stage.problem.z_range
    wider = np.stack([np.minimum(whole[0], known[0]), np.maximum(whole[1], known[1])])
    # differences of measured outputs are mostly noise: their range is that of the simulation
    change = np.array([a.minus >= 0 for a in stage.problem.layout.antecedents], dtype=bool)
    problem = replace(stage.problem, runs=tuple(runs), z_range=np.where(change, known, wider))
    refit = refine(best_started(problem, stage.body), iterations, 1e-5)
    return refit if is_bounded(refit) else stage


def restated(layout: Layout, parameters: Parameters, runs: tuple[FloatArray, ...]) -> tuple[Problem, Body]:
    """A fitted model as refinement writes it: consequents in a basis in which `runs` are well conditioned."""
    basis = np.ascontiguousarray(first_basis(layout, runs))
    theta, p = parameters.theta, parameters
    problem = Problem(layout, runs, basis, theta[0].copy(), p.z_range, p.limits)
    a = np.linalg.solve(basis.T, (theta - theta[0]).reshape(-1, len(basis)).T).T
    return problem, Body(np.ascontiguousarray(a.reshape(theta.shape)), p.centre, p.width)
