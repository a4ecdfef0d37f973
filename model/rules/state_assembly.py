"""From the last stage of a refinement to a fitted TS state-space model: what it stores beside its rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset
from flysid.model.noise import noise_models
from flysid.model.rules.fitted_states import FittedTSStateSpace
from flysid.model.rules.operating_points import described
from flysid.model.rules.state_growth import StateStage, prior_of, rule_support
from flysid.model.start import start_window


def finished(
    train: Dataset,
    stage: StateStage,
    notes: tuple[str, ...],
    *,
    intervals: bool = False,
    neighbour: StateStage | None = None,
) -> FittedTSStateSpace:
    """The stage as a fitted model, with its start, support, noise model and, on request, what it does.

    Parameters
    ----------
    intervals : say what the model does at operating points, and how surely.
    neighbour : the model with one rule more, or one fewer where growth ended, see `operating_points`.
    """
    layout = stage.layout
    n_y = stage.layout.n_y
    y = np.vstack([s.y for s in train.segments])
    low = y.min(axis=0)
    high = y.max(axis=0)
    fitted = FittedTSStateSpace(
        dt_s=train.dt_s,
        layout=layout,
        parameters=stage.problem.parameters(stage.body),
        prior=prior_of(stage),
        n_init=layout.depth + 2 * -(-layout.n // n_y),
        output_limits=np.stack([low - (high - low), high + (high - low)]),
        support=rule_support(stage),
        notes=notes,
        noise=np.ones((1, n_y)),
    )
    fitted = _with_noise_model(fitted, train)
    return described(fitted, train, neighbour) if intervals else fitted


def _with_noise_model(fitted: FittedTSStateSpace, train: Dataset) -> FittedTSStateSpace:
    """The model with an autoregression of what its free run leaves over on the training data."""
    errors = []
    for s in train.segments:
        window = start_window(fitted.n_init, len(s), fitted.dt_s)
        if len(s) > window + 1:
            run = fitted.run(fitted.layout.stack(s.u, s.y[:window]), window)
            errors.append((s.y - fitted.outputs_of(run))[window:])
    return replace(fitted, noise=noise_models(errors)) if errors else fitted
