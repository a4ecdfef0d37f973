"""Dynamic Takagi-Sugeno models, refined on the simulation error: the estimator.

It grows the model from a refined linear one, rule by rule, and stops by the validation free run; what comes
out is a `FittedTS`, flysid.model.tsmodel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.model.base import Structure
from flysid.model.noise import noise_models
from flysid.model.start import estimate_start, start_window
from flysid.model.threads import on_one_thread
from flysid.model.tsestimate import Learned, learn
from flysid.model.tsmodel import FittedTS, from_dict
from flysid.model.tsuncertainty import uncertainty

__all__ = ["MODEL", "TS", "FittedTS"]


@dataclass(frozen=True)
class TS:
    """Settings of a dynamic TS model; the defaults choose by themselves.

    Parameters
    ----------
    rules : number of rules, or "auto": as many as the validation free run supports.
    na : past outputs in every consequent, or "auto".
    nb, nk : past inputs and their delay, one number, one per input, or "auto".
    antecedents : names such as ("v_x(k-1)", "theta_in(k-1)"), or "auto": found by splitting.
    refine : lower the simulation error; False keeps clusters and one-step least squares, the
        literature's default, whose free run shows what refinement is for.
    most_rules : where "auto" stops.
    iterations : Levenberg-Marquardt steps per stage.
    """

    rules: int | Literal["auto"] = "auto"
    na: int | Literal["auto"] = "auto"
    nb: int | Sequence[int] | Literal["auto"] = "auto"
    nk: int | Sequence[int] | Literal["auto"] = "auto"
    antecedents: Sequence[str] | Literal["auto"] = "auto"
    refine: bool = True
    most_rules: int = 5
    iterations: int = 30

    @on_one_thread
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedTS:
        """Grow, refine and choose a model.

        Raises
        ------
        UsageError : settings that cannot be; antecedents that are not there.
        DataError : no or too few samples, a signal that never moves.
        FitError : no stable model was found.
        """
        fitted = _fitted(train, learn(self, train, validation))
        return _with_intervals(fitted, train) if self.refine else fitted


def _fitted(train: Dataset, learned: Learned) -> FittedTS:
    stage = learned.stage
    fitted = FittedTS(
        dt_s=train.dt_s,
        layout=stage.problem.layout,
        parameters=stage.problem.parameters(stage.body),
        initial_gain=learned.initial_gain,
        support=learned.support,
        notes=learned.notes,
    )
    return _with_noise_model(fitted, train)


def _with_noise_model(fitted: FittedTS, train: Dataset) -> FittedTS:
    """The model with a noise model, where that predicts the training data better one step ahead."""
    n = fitted.n_init
    pieces = [s for s in train.segments if len(s) > n + 1]
    errors = [_free_run_error(fitted, s.u, s.y) for s in pieces]
    if not errors:
        return fitted
    noisy = replace(fitted, noise=noise_models(errors))
    scale = fitted.layout.scale[: fitted.layout.n_y]
    plain, coloured = (
        sum(float((((s.y - m.predict(s.u, s.y))[n:] / scale) ** 2).sum()) for s in pieces)
        for m in (fitted, noisy)
    )
    return noisy if coloured < plain else fitted


def _with_intervals(fitted: FittedTS, train: Dataset) -> FittedTS:
    """The model with the intervals of its gains, where the data can tell."""
    try:
        return replace(fitted, gain_interval=uncertainty(fitted, train).gain_interval)
    except (DataError, np.linalg.LinAlgError):
        return fitted


def _free_run_error(fitted: FittedTS, u: FloatArray, y: FloatArray) -> FloatArray:
    """(N - window, n_y) measured less free run, after the window that starts it."""
    window = start_window(fitted.n_init, len(y), fitted.dt_s)
    return y[window:] - fitted.simulate(u, estimate_start(fitted, u[:window], y[:window]))[window:]


MODEL = Structure("ts", from_dict)
