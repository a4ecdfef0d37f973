"""From the last stage of a refinement to a fitted model: what it stores beside its rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.model.noise import noise_models
from flysid.model.rules.fitted_lags import FittedTS
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.growth import rule_support
from flysid.model.rules.judging import initial_state_gain
from flysid.model.rules.operating_points import described
from flysid.model.start import estimate_start, start_window


def finished(
    stage: Stage,
    train: Dataset,
    notes: tuple[str, ...],
    *,
    intervals: bool = True,
    neighbour: Stage | None = None,
) -> FittedTS:
    """The stage as a fitted model, with its start, support, noise model and, on request, what it does.

    Parameters
    ----------
    intervals : say what the model does at operating points, and how surely.
    neighbour : the model with one rule more, or one fewer where growth ended, see `operating_points`.
    """
    fitted = FittedTS(
        dt_s=train.dt_s,
        layout=stage.problem.layout,
        parameters=stage.problem.parameters(stage.body),
        initial_gain=initial_state_gain(stage),
        support=rule_support(stage),
        notes=notes,
    )
    fitted = with_noise_model(fitted, train)
    return described(fitted, train, neighbour) if intervals else fitted


def free_run_errors(model: FittedTS, data: Dataset) -> list[FloatArray]:
    """(N - window, n_y) measured less free run per segment, after the window that starts it."""
    return [_free_run_error(model, s.u, s.y) for s in data.segments if len(s) > model.n_init + 1]


def free_run_rmse(model: FittedTS, data: Dataset) -> FloatArray:
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


def _free_run_error(fitted: FittedTS, u: FloatArray, y: FloatArray) -> FloatArray:
    window = start_window(fitted.n_init, len(y), fitted.dt_s)
    return y[window:] - fitted.simulate(u, estimate_start(fitted, u[:window], y[:window]))[window:]


def with_noise_model(fitted: FittedTS, train: Dataset) -> FittedTS:
    """The model with a noise model, where that predicts the training data better one step ahead."""
    n = fitted.n_init
    pieces = [s for s in train.segments if len(s) > n + 1]
    errors = free_run_errors(fitted, train)
    if not errors:
        return fitted
    noisy = replace(fitted, noise=noise_models(errors))
    scale = fitted.layout.scale[: fitted.layout.n_y]
    plain, coloured = (
        sum(float((((s.y - m.predict(s.u, s.y))[n:] / scale) ** 2).sum()) for s in pieces)
        for m in (fitted, noisy)
    )
    return noisy if coloured < plain else fitted
