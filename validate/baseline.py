"""The linear side: which structures compete, and which of them is the baseline of the verdict.

The baseline is the best linear model by validation, so that rules are compared with what a linear model can
do at best, not with a straw man. Every candidate is fitted to the same part of the training data and judged
by its free run over the rest; the held-out part stays shut. ARX stays unless another is better by more than
noise there, and no worse over all of the training data once both are fitted to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError
from flysid.model.base import Estimator, Fitted
from flysid.model.selection import block_means, clearly_better
from flysid.progress import tell
from flysid.validate.fitone import UNFIT, reason
from flysid.validate.trials import FREE_RUN, Trial, run_trials

FIRST = "arx"
HELD_OUT = 0.25
REFERENCES = ("mean", "persistence")
"""Structures that no verdict is about: what loses to them has learnt nothing."""


@dataclass(frozen=True)
class Choice:
    """The baseline, and why.

    Attributes
    ----------
    label : of the linear model chosen.
    rmse : validation free-run RMSE in standard deviations of the output, by label; empty where the training
        part is too short to hold anything out.
    words : one sentence.
    """

    label: str
    rmse: Mapping[str, float] = field(default_factory=dict)
    words: str = ""


def linear_estimators(nk_hint: tuple[int, ...] = ()) -> dict[str, Estimator]:
    """The linear structures that compete for the baseline, by label, with their defaults.

    `nk_hint`: delays per input that they try besides their own.
    """
    from flysid.model.armax import ARMAX
    from flysid.model.arx import ARX
    from flysid.model.bj import BJ
    from flysid.model.oe import OE
    from flysid.model.statespace import StateSpace

    kinds = {"arx": ARX, "oe": OE, "armax": ARMAX, "bj": BJ, "statespace": StateSpace}
    return {label: kind(nk_hint=nk_hint) for label, kind in kinds.items()}


def choose_baseline(train: Dataset, candidates: Mapping[str, Estimator]) -> Choice:
    """Fit every candidate to a part of `train`, judge it by its free run over the rest.

    Raises
    ------
    FitError : no candidate could be fitted.
    """
    try:
        fit, check = train.split(holdout=HELD_OUT)
        errors = _bounded_errors(_fitted(candidates, fit, check), check)
    except DataError:
        return Choice(_first(candidates), words="the training part is too short to choose on")
    label = _first(errors)
    for name, e in errors.items():
        if clearly_better(e, errors[label]):
            label = name
    rmse = {name: float(np.sqrt(e.mean())) for name, e in errors.items()}
    for name, value in rmse.items():
        tell("free run on the validation part", model=name, validation=value)
    said = ", ".join(f"{name.upper()} {value:.3g}" for name, value in rmse.items())
    if rmse[label] > min(rmse.values()):
        said += f"; none is clearly better than {label.upper()}"
    return Choice(label, rmse, f"validation free-run RMSE, in standard deviations of the output: {said}")


def confirmed(choice: Choice, models: Mapping[str, Fitted], train: Dataset) -> Choice:
    """The choice, unless ARX follows all of the training data better once both are fitted to them.

    Validation is one flight or a few: what wins there and then fits the whole worse has won by luck.

    Parameters
    ----------
    models : the linear models fitted to all training data, by label.
    """
    first = _first(models)
    if choice.label == first or choice.label not in models:
        return replace(choice, label=first)
    errors = free_run_errors({n: models[n] for n in (first, choice.label)}, train)
    if errors[choice.label].mean() <= errors[first].mean():
        return choice
    rmse = {n.upper(): f"{np.sqrt(e.mean()):.3g}" for n, e in errors.items()}
    said = " against ".join(f"{n} {v}" for n, v in rmse.items())
    return replace(
        choice,
        label=first,
        words=f"{choice.words}; {choice.label.upper()} was not kept: free run of all training data {said}",
    )


def _first(named: Mapping[str, object]) -> str:
    return FIRST if FIRST in named else next(iter(named))


def _fitted(candidates: Mapping[str, Estimator], fit: Dataset, check: Dataset) -> dict[str, Fitted]:
    models: dict[str, Fitted] = {}
    reasons: list[str] = []
    for i, (name, estimator) in enumerate(candidates.items()):
        tell("choosing the best linear model", model=name, share=i / len(candidates))
        try:
            models[name] = estimator.fit(fit, check)
        except UNFIT as error:
            reasons.append(f"{name}: {reason(error)}")
    if not models:
        raise FitError("no linear model could be fitted: " + "; ".join(reasons))
    return models


def free_run_errors(models: Mapping[str, Fitted], check: Dataset) -> dict[str, FloatArray]:
    """Mean squared free-run errors of blocks of the validation part, in variances of the outputs."""
    return _errors_of(run_trials(models, check, FREE_RUN))


def _bounded_errors(models: Mapping[str, Fitted], check: Dataset) -> dict[str, FloatArray]:
    """Those of the models that reach their limits nowhere in it; of all where none is left."""
    trials = run_trials(models, check, FREE_RUN)
    lost = {name for t in trials for name in t.diverged_s}
    return {name: e for name, e in _errors_of(trials).items() if name not in lost or lost >= models.keys()}


def _errors_of(trials: Sequence[Trial]) -> dict[str, FloatArray]:
    scale = np.std(np.concatenate([t.y for t in trials]), axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    return {name: block_means([_squares(t, name, scale) for t in trials]) for name in trials[0].yh}


def _squares(trial: Trial, name: str, scale: FloatArray) -> FloatArray:
    squares: FloatArray = np.mean(((trial.y - trial.yh[name]) / scale) ** 2, axis=1)
    return squares
