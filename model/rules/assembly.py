"""From the last stage of a refinement to a fitted model: what it stores beside its rules."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.model.noise import noise_models
from flysid.model.rules.growth import rule_support
from flysid.model.rules.likely_start import start_spread
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.run_start import LikelyStart
from flysid.model.rules.stages import Stage, prior_of
from flysid.model.start import MAX_SHARE, most_start_rows, settled_start_rows, start_window

M = TypeVar("M", bound=RuleModel)


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
