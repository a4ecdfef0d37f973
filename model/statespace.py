"""State space: one linear system for all inputs and outputs, found by subspace methods.

    x(k+1) = A x(k) + B u(k) + K e(k),    y(k) = C x(k) + D u(k) + e(k)        (Ljung, 1999, 4.3)

No search can get stuck, outputs share their states, and one pass over the data gives every order. Methods and
horizons differ in what they assume; the validation free run chooses among them.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FitError, UsageError
from flysid.model.arguments import check_inputs
from flysid.model.detrend import Trend, check_trend, detrend
from flysid.model.flight_offsets import with_own_constants
from flysid.model.linear.data import CHOICE_ROWS, Parts, as_tuple, judging_window
from flysid.model.linear.output_error import find_delays
from flysid.model.linear.settings import check_hint
from flysid.model.linear.stability import unstable_words
from flysid.model.own_constants import FlightOffsets
from flysid.model.selection import block_errors
from flysid.model.settings import Settings
from flysid.model.shared import fit_key, once
from flysid.model.simulation_error import OutputOrders
from flysid.model.stream import Late, OnDisk, Source, delayed_inputs
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.subspace.order_search import (
    ORDER_WORTH,
    Choice,
    Projections,
    already_scaled,
    built,
    mean_of,
    search,
)
from flysid.model.subspace.refinement import SystemFit, mirror
from flysid.model.subspace.triangle import Method, window
from flysid.model.threads import on_one_thread

Auto: TypeAlias = Literal["auto"]
ITERATIONS = 30
MOST_WORK = 1e8
"""Samples times states times parameters up to which "auto" tries a refinement: some seconds."""


@dataclass(frozen=True)
class StateSpace(Settings):
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
    trend : "remove" takes a straight line out of every segment's signals first; see `detrend`.
    stable : an unstable estimate has its poles mirrored into the unit circle, and all matrices are fitted
        again to the simulation error from there.
    flight_offsets : a constant of every flight beside the model, see `flysid.model.flight_offsets`: "auto"
        where flights differ beyond chance, True or False to force.

    Source: Chiuso (2007), Automatica 43 (PBSID); Van Overschee & De Moor (1996) for the others.

    Examples
    --------
    >>> model = flysid.StateSpace(order=1, refine=False).fit(train)  # train: see `flysid.Dataset`
    >>> model.poles.real.round(2)
    array([0.9])
    """

    order: int | Auto = "auto"
    method: Method | Auto = "auto"
    past: int | Auto = "auto"
    feedthrough: bool | Auto = "auto"
    refine: bool | Auto = "auto"
    nk: int | Sequence[int] | Auto = "auto"
    n_init: int | None = None
    nk_hint: Sequence[int] = ()
    trend: Trend = "none"
    stable: bool = False
    flight_offsets: FlightOffsets = "auto"

    def check_values(self) -> None:
        """Raise UsageError for settings that cannot be."""
        self.at_least(1, "order", "past", "n_init")
        check_trend(self.trend, ("none", "remove"))

    @on_one_thread
    @once(fit_key)
    @with_own_constants
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
        _check_delays(self, len(train.inputs))
        if isinstance(train, OnDisk):
            return _from_disk(self, train, validation)
        train = detrend(train, self.trend)
        plan = _best_plan(self, train, None if validation is None else detrend(validation, self.trend))
        model = _final(self, plan.parts.train, plan.parts, plan.choice, plan.note)
        if self.refine is not False:
            model = _refine(self, plan.parts, plan.choice, model)
        return delayed_model(_settle(self, plan.parts, model), plan.late)


def _plan_key(settings: StateSpace, train: Dataset, validation: Dataset | None) -> Hashable:
    return fit_key(replace(settings, refine="auto", n_init=None, stable=False), train, validation)


@once(_plan_key)
def _best_plan(settings: StateSpace, train: Dataset, validation: Dataset | None) -> _Plan:
    """Of the delays that the inputs may have, those of the best validation free run."""
    return min(
        (_plan(settings, train, validation, late) for late in _delays(settings, train, validation)),
        key=lambda plan: plan.loss,
    )


def _check_delays(settings: StateSpace, n_u: int) -> None:
    check_inputs(n_u)
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


def _plan(settings: StateSpace, train: Dataset, validation: Dataset | None, late: tuple[int, ...]) -> _Plan:
    held = None if validation is None else delayed_inputs(validation, late)
    parts = Parts.of(delayed_inputs(train, late), held)
    choice, note, loss = _chosen(settings, parts)
    # no delay is the simpler choice
    return _Plan(late, parts, choice, note, loss if not any(late) else loss / (1.0 - ORDER_WORTH))


def _chosen(settings: StateSpace, parts: Parts) -> tuple[Choice, str, float]:
    if settings.order != "auto" and settings.past != "auto" and settings.method != "auto":
        return Choice(settings.method, settings.past, settings.order), "Settings as given", 0.0
    return search(settings, parts)


def _from_disk(settings: StateSpace, train: OnDisk, validation: Dataset | None) -> FittedStateSpace:
    """Choices on the head, matrices from all blocks.

    Raises UsageError: a refinement or a trend was asked for.
    """
    if settings.refine is True or settings.trend != "none":
        raise UsageError(
            "a refinement or a trend needs its data in memory", hint="fit data.read(), or data.head(rows)"
        )
    plan = _best_plan(settings, train.head(CHOICE_ROWS), validation)
    data = Late(train, plan.late) if any(plan.late) else train
    parts = Parts.on_disk(data)
    model = _final(settings, data, parts, plan.choice, plan.note)
    return delayed_model(_stable(settings, parts, model), plan.late)


def _delays(settings: StateSpace, train: Dataset, validation: Dataset | None) -> list[tuple[int, ...]]:
    """By how many samples the inputs may be late: what was given, or nothing and what the data say."""
    n_u = len(train.inputs)
    none = (0,) * n_u
    if settings.nk != "auto":
        return [tuple(max(k - 1, 0) for k in as_tuple(settings.nk, n_u))]
    if settings.order != "auto" and settings.past != "auto" and settings.method != "auto":
        return [none]
    data = Parts.of(train, validation).fit
    probe = OutputOrders(2, (2,) * n_u, tuple(settings.nk_hint) or (1,) * n_u, offset=True)
    found = [find_delays(data, output, probe) for output in range(len(train.outputs))]
    late = tuple(max(min(nk[j] for nk in found) - 1, 0) for j in range(n_u))
    shortest = min(len(s) for s in train.segments)
    return [none, late] if any(late) and max(late) < shortest // 4 else [none]


def delayed_model(model: FittedStateSpace, late: tuple[int, ...]) -> FittedStateSpace:
    """The model for inputs as they are sent; the start waits until they enter."""
    if not any(late):
        return model
    wait = np.zeros((max(late), *model.gains.shape[1:]))
    words = ", ".join(f"{s.name} {k}" for s, k in zip(model.inputs, late, strict=True))
    return replace(
        model,
        delays=late,
        gains=np.concatenate([wait, model.gains]),
        notes=(*model.notes, f"Inputs enter late, in samples: {words}."),
    )


def _refine(settings: StateSpace, parts: Parts, choice: Choice, plain: FittedStateSpace) -> FittedStateSpace:
    """The model refined on the simulation error, or the plain one with the reason why not."""
    if settings.refine == "auto" and _work(parts, choice.order) > MOST_WORK:
        return plain
    skip = judging_window(parts, choice.order)
    if settings.refine == "auto":
        before, after = (
            mean_of(np.concatenate([_judge(settings, f, choice, skip, refine=r) for f in parts.folds]))
            for r in (False, True)
        )
        figures = f"validation free run RMSE {np.sqrt(after):.3g} refined against {np.sqrt(before):.3g}"
        if not after < before:
            note = f"Refinement on the simulation error was tried and not kept: {figures}."
            return replace(plain, notes=(*plain.notes, note))
        note = f"Refined on the simulation error: {figures} (standard deviations of the output)."
    else:
        note = "Refined on the simulation error."
    problem = _problem(parts, plain)
    model = _simulate(settings, parts, problem, plain)
    return replace(model, notes=(*plain.notes, note))


def _problem(parts: Parts, model: FittedStateSpace) -> SystemFit:
    """The simulation error over the training data, from a model of them on."""
    scaling = parts.scaling
    inverse = replace(scaling, u_scale=1.0 / scaling.u_scale, y_scale=1.0 / scaling.y_scale)
    return SystemFit(
        parts.whole.segments, model.realisation.in_units(inverse), bool(model.realisation.d.any())
    )


def _simulate(
    settings: StateSpace, parts: Parts, problem: SystemFit, plain: FittedStateSpace
) -> FittedStateSpace:
    """The model of least simulation error from the problem's start, with its noise and its covariance."""
    theta = problem.refine(ITERATIONS).theta
    model = built(parts, problem.settled(theta), settings.n_init, problem.feedthrough)
    factor = _units(parts, model.order, problem.feedthrough)
    return replace(
        model,
        free=model.free - model.order * len(model.outputs),
        singular_values=plain.singular_values,
        noise=problem.noise(theta),
        covariance=problem.covariance(theta) * np.outer(factor, factor),
    )


def _settle(settings: StateSpace, parts: Parts, model: FittedStateSpace) -> FittedStateSpace:
    """A stable model, with intervals where they can be had; an unstable one with what that means."""
    model = _stable(settings, parts, model)
    if not model.is_stable or len(model.covariance) or _work(parts, model.order) > MOST_WORK:
        return model
    problem = _problem(parts, model)
    factor = _units(parts, model.order, problem.feedthrough)
    covariance = problem.spread(problem.theta0) * np.outer(factor, factor)
    return replace(model, covariance=covariance) if np.isfinite(covariance).all() else model


def _stable(settings: StateSpace, parts: Parts, model: FittedStateSpace) -> FittedStateSpace:
    """An unstable model made stable where the settings ask for it, or with what that means."""
    if model.is_stable:
        return model
    radius = float(np.abs(model.poles).max())
    if not settings.stable:
        return replace(model, notes=(*model.notes, unstable_words(radius, model.dt_s)))
    problem = _problem(parts, model)
    inside = _simulate(settings, parts, replace(problem, start=mirror(problem.start)), model)
    words = (
        f"Made stable: the largest pole radius was {radius:.5f} and is {np.abs(inside.poles).max():.5f}; "
        "all matrices were fitted again to the simulation error."
    )
    return replace(inside, notes=(*model.notes, words))


def _work(parts: Parts, order: int) -> float:
    """Samples times states times parameters."""
    return len(parts.train) * order * order * (order + 3 * len(parts.train.outputs + parts.train.inputs))


def _judge(settings: StateSpace, parts: Parts, choice: Choice, skip: int, *, refine: bool) -> FloatArray:
    """Validation errors in blocks of the choice, fitted to the fitting part; inf where it blows up."""
    shared = Projections(settings, already_scaled(parts), parts.fit, window(choice.past, choice.method))
    projection = shared.of(choice.method, choice.past)
    found = projection.realise(choice.order)
    if refine:
        problem = SystemFit(parts.fit.segments, found, projection.columns.feedthrough)
        try:
            found = problem.settled(problem.refine(ITERATIONS).theta)
        except FitError:
            return np.array([np.inf])
    return block_errors(built(parts, found, skip), parts.check, skip, parts.scaling.y_scale)


def _units(parts: Parts, n: int, feedthrough: bool) -> FloatArray:
    """What turns A, B, C, drift, level (and D) of scaled deviations into physical units."""
    y = parts.scaling.y_scale
    u = parts.scaling.u_scale
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
