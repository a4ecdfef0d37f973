"""State space: one linear system for all inputs and outputs, found by subspace methods.

    x(k+1) = A x(k) + B u(k) + K e(k),    y(k) = C x(k) + D u(k) + e(k)        (Ljung, 1999, 4.3)

No search can get stuck, outputs share their states, and one pass over the data gives every order. Methods and
horizons differ in what they assume; the validation free run chooses among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.base import Structure
from flysid.model.linear.data import CHOICE_ROWS, Parts, as_tuple
from flysid.model.linear.oe_search import check_hint
from flysid.model.linear.output_error import find_delays
from flysid.model.selection import block_errors, judging_window
from flysid.model.simulation_error import Orders
from flysid.model.stream import OnDisk, Source
from flysid.model.subspace.model import FittedStateSpace, from_dict
from flysid.model.subspace.refine import SimulationError
from flysid.model.subspace.search import (
    ORDER_WORTH,
    Choice,
    Projections,
    already_scaled,
    built,
    mean_of,
    searched,
)
from flysid.model.subspace.triangle import (
    METHODS,
    Method,
    window,
)
from flysid.model.threads import on_one_thread

Auto: TypeAlias = Literal["auto"]
ITERATIONS = 30
MOST_WORK = 1e8
"""Samples times states times parameters up to which "auto" tries a refinement: some seconds."""


@dataclass(frozen=True)
class StateSpace:
    """Settings of a state-space model; the defaults choose by themselves.

    Parameters
    ----------
    order : number of states, or "auto": the simplest within one standard error of the best free run on
        validation data.
    method : "pbsid", "n4sid", "moesp", "cva" (see `subspace`), or "auto": by the same free run.
    past : samples that the state is estimated from, or "auto".
    feedthrough : the input reaches the output in the same sample (D is estimated), or "auto": where a long
        regression says so (BIC).
    refine : fit the simulation error with all matrices, from the subspace estimate: "auto" where the
        validation free run is better for it and the data are short enough, True or False to force. A refined
        model has a covariance, and a model of its noise instead of K.
    nk : delay in samples, one number or one per input, or "auto": by the simulation error, where the
        validation free run is better for it. 1 or less is no delay here (see `feedthrough`).
    n_init : measured samples that start a simulation; None chooses.
    nk_hint : delays that "auto" tries besides its own, one per input.
    """

    order: int | Auto = "auto"
    method: Method | Auto = "auto"
    past: int | Auto = "auto"
    feedthrough: bool | Auto = "auto"
    refine: bool | Auto = "auto"
    nk: int | Sequence[int] | Auto = "auto"
    n_init: int | None = None
    nk_hint: Sequence[int] = ()

    @on_one_thread
    def fit(self, train: Source, validation: Dataset | None = None) -> FittedStateSpace:
        """Choose, fit.

        From disk (`flysid.datasetfile.open_dataset`) in bounded memory; choices are made on the first 200,000
        samples.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : no or too few samples, a signal that never changes.
        FitError : the order exceeds what the data show.
        """
        _check(self)
        _check_delays(self, len(train.inputs))
        if isinstance(train, OnDisk):
            return _from_disk(self, train, validation)
        plan = _best_plan(self, train, validation)
        model = _final(self, plan.parts.train, plan.parts, plan.choice, plan.note)
        if self.refine is not False:
            model = _refined(self, plan.parts, plan.choice, model)
        return _delayed_model(model, plan.late) if any(plan.late) else model


def with_choices_made(settings: StateSpace, train: Dataset, validation: Dataset | None = None) -> StateSpace:
    """The same settings with order, method, past and delays as `fit` would choose them."""
    plan = _best_plan(settings, train, validation)
    choice, nk = plan.choice, tuple(late + 1 for late in plan.late)
    return replace(settings, order=choice.order, method=choice.method, past=choice.past, nk=nk)


def _best_plan(settings: StateSpace, train: Dataset, validation: Dataset | None) -> _Plan:
    return min(
        (_planned(settings, train, validation, late) for late in _delays(settings, train, validation)),
        key=lambda plan: plan.loss,
    )


def _check_delays(settings: StateSpace, n_u: int) -> None:
    check_hint(settings.nk_hint, n_u)
    if settings.nk == "auto":
        return
    values = as_tuple(settings.nk, n_u)
    if len(values) != n_u or min(values) < 0:
        raise UsageError(
            f"nk={settings.nk!r}", hint=f"give 'auto', or whole numbers of at least 0, one per input ({n_u})"
        )


@dataclass(frozen=True, eq=False)
class _Plan:
    """What was chosen for inputs that are `late` by so many samples, and the validation mean square."""

    late: tuple[int, ...]
    parts: Parts
    choice: Choice
    note: str
    loss: float


def _planned(
    settings: StateSpace, train: Dataset, validation: Dataset | None, late: tuple[int, ...]
) -> _Plan:
    held = None if validation is None else _delayed(validation, late)
    parts = Parts.of(_delayed(train, late), held)
    choice, note, loss = _chosen(settings, parts)
    # no delay is the simpler choice
    return _Plan(late, parts, choice, note, loss if not any(late) else loss / (1.0 - ORDER_WORTH))


def _chosen(settings: StateSpace, parts: Parts) -> tuple[Choice, str, float]:
    if settings.order != "auto" and settings.past != "auto" and settings.method != "auto":
        return Choice(settings.method, settings.past, settings.order), "Settings as given", 0.0
    return searched(settings, parts)


def _from_disk(settings: StateSpace, train: OnDisk, validation: Dataset | None) -> FittedStateSpace:
    """Choices on the head, matrices from all blocks.

    Raises
    ------
    UsageError : a refinement or a delay was asked for.
    """
    n_u = len(train.inputs)
    if settings.refine is True or (settings.nk != "auto" and max(as_tuple(settings.nk, n_u)) > 1):
        raise UsageError(
            "a refinement or a delay needs its data in memory", hint="fit data.read(), or data.head(rows)"
        )
    choice, note, _ = _chosen(settings, Parts.of(train.head(CHOICE_ROWS), validation))
    return _final(settings, train, Parts.on_disk(train), choice, note)


def _delays(settings: StateSpace, train: Dataset, validation: Dataset | None) -> list[tuple[int, ...]]:
    """By how many samples the inputs may be late: what was given, or nothing and what the data say."""
    n_u = len(train.inputs)
    none = (0,) * n_u
    if settings.nk != "auto":
        return [tuple(max(k - 1, 0) for k in as_tuple(settings.nk, n_u))]
    if settings.order != "auto" and settings.past != "auto" and settings.method != "auto":
        return [none]
    data = Parts.of(train, validation).fit
    probe = Orders(2, (2,) * n_u, tuple(settings.nk_hint) or (1,) * n_u, offset=True)
    found = [find_delays(data, output, probe) for output in range(len(train.outputs))]
    late = tuple(max(min(nk[j] for nk in found) - 1, 0) for j in range(n_u))
    shortest = min(len(s) for s in train.segments)
    return [none, late] if any(late) and max(late) < shortest // 4 else [none]


def _delayed(data: Dataset, late: tuple[int, ...]) -> Dataset:
    """The inputs as they enter, the rows before the first of them left out."""
    most = max(late)
    if most == 0:
        return data
    segments = []
    for s in data.segments:
        if len(s) > most:
            u = np.stack([s.u[most - k : len(s) - k, j] for j, k in enumerate(late)], axis=1)
            segments.append(replace(s.slice(most, len(s), data.dt_s), u=u))
    if not segments:
        raise DataError(
            f"no segment is longer than the delay of {most} samples", hint="bring longer segments"
        )
    return data.with_segments(segments)


def _delayed_model(model: FittedStateSpace, late: tuple[int, ...]) -> FittedStateSpace:
    """The model for inputs as they are sent; the start waits until they enter."""
    wait = np.zeros((max(late), *model.gains.shape[1:]))
    words = ", ".join(f"{s.name} {k}" for s, k in zip(model.inputs, late, strict=True))
    return replace(
        model,
        delays=late,
        gains=np.concatenate([wait, model.gains]),
        notes=(*model.notes, f"Inputs enter late, in samples: {words}."),
    )


def _check(settings: StateSpace) -> None:
    for name in ("order", "past", "n_init"):
        value = getattr(settings, name)
        if value not in ("auto", None) and not (isinstance(value, (int, np.integer)) and value >= 1):
            raise UsageError(f"{name} must be a whole number of at least 1, not {value!r}")
    if settings.method not in ("auto", *METHODS):
        raise UsageError(
            f"there is no subspace method {settings.method!r}", hint=f"one of {', '.join(METHODS)}, or 'auto'"
        )
    for name in ("feedthrough", "refine"):
        if getattr(settings, name) not in (True, False, "auto"):
            raise UsageError(f"{name} is {getattr(settings, name)!r}", hint="use 'auto', True or False")


def _refined(settings: StateSpace, parts: Parts, choice: Choice, plain: FittedStateSpace) -> FittedStateSpace:
    """The model refined on the simulation error, or the plain one with the reason why not."""
    n, p = choice.order, choice.order * (choice.order + 3 * len(parts.train.outputs + parts.train.inputs))
    if settings.refine == "auto" and len(parts.train) * n * p > MOST_WORK:
        return plain
    skip = judging_window(parts, n)
    if settings.refine == "auto":
        before, after = (
            mean_of(np.concatenate([_judged(settings, f, choice, skip, refine=r) for f in parts.folds]))
            for r in (False, True)
        )
        figures = f"validation free run RMSE {np.sqrt(after):.3g} refined against {np.sqrt(before):.3g}"
        if not after < before:
            note = f"Refinement on the simulation error was tried and not kept: {figures}."
            return replace(plain, notes=(*plain.notes, note))
        note = f"Refined on the simulation error: {figures} (standard deviations of the output)."
    else:
        note = "Refined on the simulation error."
    feedthrough = _feeds_through(plain)
    start = Projections(settings, already_scaled(parts), parts.whole, window(choice.past, choice.method))
    problem = SimulationError(
        parts.whole.segments, start.of(choice.method, choice.past).realise(n), feedthrough
    )
    theta = problem.refine(ITERATIONS).theta
    model = built(parts, problem.settled(theta), settings.n_init, feedthrough)
    factor = _units(parts, n, feedthrough)
    return replace(
        model,
        free=model.free - n * len(model.outputs),
        singular_values=plain.singular_values,
        noise=problem.noise(theta),
        covariance=problem.covariance(theta) * np.outer(factor, factor),
        notes=(*plain.notes, note),
    )


def _judged(settings: StateSpace, parts: Parts, choice: Choice, skip: int, *, refine: bool) -> FloatArray:
    """Validation errors in blocks of the choice, fitted to the fitting part; inf where it blows up."""
    shared = Projections(settings, already_scaled(parts), parts.fit, window(choice.past, choice.method))
    projection = shared.of(choice.method, choice.past)
    found = projection.realise(choice.order)
    if refine:
        problem = SimulationError(parts.fit.segments, found, projection.columns.feedthrough)
        try:
            found = problem.settled(problem.refine(ITERATIONS).theta)
        except FitError:
            return np.array([np.inf])
    return block_errors(built(parts, found, skip), parts.check, skip, parts.scaling.y_scale)


def _feeds_through(model: FittedStateSpace) -> bool:
    return bool(model.realisation.d.any())


def _units(parts: Parts, n: int, feedthrough: bool) -> FloatArray:
    """What turns A, B, C, drift, level (and D) of scaled deviations into physical units."""
    y, u = parts.scaling.y_scale, parts.scaling.u_scale
    pieces = [np.ones(n * n), np.tile(1.0 / u, n), np.repeat(y, n), np.ones(n), y]
    return np.concatenate([*pieces, *([np.outer(y, 1.0 / u).ravel()] if feedthrough else [])])


def _final(settings: StateSpace, data: Source, parts: Parts, choice: Choice, note: str) -> FittedStateSpace:
    """The choice on all training data, which `parts` measured."""
    all_data = Projections(settings, parts, data, window(choice.past, choice.method))
    projection = all_data.of(choice.method, choice.past)
    realisation = projection.realise(choice.order)
    model = built(parts, realisation, settings.n_init, projection.columns.feedthrough)
    words = "" if choice.past != settings.past or choice.order != settings.order else f": {choice}"
    return replace(model, singular_values=projection.singular_values[:50], notes=(f"{note}{words}.",))


MODEL = Structure("statespace", from_dict)
