"""The linear side's choice: which structures compete, and which of them a fuzzy model has to beat.

Every candidate is fitted to the same part of the training data and judged by its free run over the rest. ARX
stays unless another is better by more than noise there, and no worse over all of the training data once both
are fitted to them. Where rules do not pay, this model is what one rule says.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError
from flysid.model.base import Estimator, Fitted
from flysid.model.selection import clearly_better, free_run_errors, judge_free_runs, parts_to_choose_on
from flysid.model.shared import fit_key, once
from flysid.progress import tell

FIRST = "arx"


@dataclass(frozen=True)
class BaselineChoice:
    """The baseline, and why.

    `label`: of the linear model chosen.
    `rmse`: validation free-run RMSE in standard deviations of the output, by label; empty where the training
        part is too short to hold anything out.
    `words`: one sentence.
    """

    label: str
    rmse: Mapping[str, float] = field(default_factory=dict)
    words: str = ""


def best_linear(
    train: Dataset, validation: Dataset | None, candidates: Mapping[str, Estimator]
) -> tuple[BaselineChoice, Fitted]:
    """The candidate that `flysid fit` takes as the baseline, fitted to all training data.

    `validation`: judges the candidates; where it is None, a part of the training data does.
    Raises FitError: no candidate could be fitted.
    """
    if validation is not None:
        fitted = _fit(candidates, train, validation)
        choice = _chosen(_of_the_bounded(fitted, validation))
        return choice, fitted[choice.label]
    choice = choose_baseline(train, candidates)
    models: dict[str, Fitted] = {}
    for label in dict.fromkeys((FIRST, choice.label)):
        try:
            models[label] = candidates[label].fit(train)
        except (DataError, FitError) as error:
            words = f"{choice.words}; {label.upper()} could not be fitted: {error.message}"
            choice = replace(choice, words=words)
    if not models:
        raise FitError(choice.words)
    choice = confirm(choice, models, train)
    return choice, models[choice.label]


def _ask(train: Dataset, candidates: Mapping[str, Estimator]) -> Hashable | None:
    return fit_key(tuple(candidates.items()), train)


@once(_ask)
def choose_baseline(train: Dataset, candidates: Mapping[str, Estimator]) -> BaselineChoice:
    """Fit every candidate to a part of `train`, judge it by its free run over the rest.

    Raises FitError: no candidate could be fitted.
    """
    try:
        fit, check = parts_to_choose_on(train)
        errors = _of_the_bounded(_fit(candidates, fit, check), check)
    except DataError:
        return BaselineChoice(_first(candidates), words="the training part is too short to choose on")
    return _chosen(errors)


def best_fitted(models: Mapping[str, Fitted], data: Dataset) -> BaselineChoice:
    """Of fitted models the one whose free run follows `data` best; ARX unless another is clearly better.

    Raises DataError: no segment is long enough.
    """
    over = f"free-run RMSE over {len(data):,} training samples"
    return _chosen(_of_the_bounded(models, data), over)


def _chosen(errors: Mapping[str, FloatArray], over: str = "validation free-run RMSE") -> BaselineChoice:
    """`over`: what the errors are, in words."""
    label = _first(errors)
    for name, e in errors.items():
        if clearly_better(e, errors[label]):
            label = name
    rmse = {name: float(np.sqrt(e.mean())) for name, e in errors.items()}
    said = ", ".join(f"{name.upper()} {value:.3g}" for name, value in rmse.items())
    if rmse[label] > min(rmse.values()):
        said += f"; none is clearly better than {label.upper()}"
    return BaselineChoice(label, rmse, f"{over}, in standard deviations of the output: {said}")


def confirm(choice: BaselineChoice, models: Mapping[str, Fitted], train: Dataset) -> BaselineChoice:
    """The choice, unless ARX follows all of the training data better once both are fitted to them.

    Validation is one flight or a few: what wins there and then fits the whole worse has won by luck.

    `models`: the linear models fitted to all training data, by label.
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


def _fit(candidates: Mapping[str, Estimator], fit: Dataset, check: Dataset) -> dict[str, Fitted]:
    models: dict[str, Fitted] = {}
    reasons: list[str] = []
    lacking: MemoryError | None = None
    for i, (name, estimator) in enumerate(candidates.items()):
        tell("choosing the best linear model", model=name, share=i / len(candidates))
        try:
            models[name] = estimator.fit(fit, check)
            tell("free run on the validation part", model=name, validation=_rmse(models[name], check))
        except (DataError, FitError) as error:
            reasons.append(f"{name}: {error}")
        except MemoryError as error:
            lacking = error
            reasons.append(f"{name}: out of memory" + (f": {error}" if str(error) else ""))
    if not models:
        raise FitError("no linear model could be fitted: " + "; ".join(reasons)) from lacking
    return models


def _rmse(model: Fitted, check: Dataset) -> float | None:
    """What is told of a model as soon as there is one; None where no segment is long enough."""
    with suppress(DataError):
        return float(np.sqrt(free_run_errors({"": model}, check)[""].mean()))
    return None


def _of_the_bounded(models: Mapping[str, Fitted], check: Dataset) -> dict[str, FloatArray]:
    """The errors of the models that reach their limits nowhere; of all where none is left."""
    found = judge_free_runs(models, check)
    kept = [name for name, (_, lost) in found.items() if not lost] or list(found)
    return {name: found[name][0] for name in kept}
