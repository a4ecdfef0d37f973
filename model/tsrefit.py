"""A chosen model refined once more on all the training data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from flysid.dataset import FloatArray
from flysid.model.tsgrow import Stage, best_started, refine
from flysid.model.tsproblem import antecedent_range
from flysid.model.tsselect import is_bounded


def on_all_runs(stage: Stage, runs: Sequence[FloatArray], iterations: int) -> Stage:
    """The stage with its numbers refined on `runs`; unchanged where that would make it unstable."""
    problem = replace(stage.problem, runs=tuple(runs), z_range=antecedent_range(stage.problem.layout, runs))
    refit = refine(best_started(problem, stage.body), iterations, 1e-5)
    return refit if is_bounded(refit) else stage
