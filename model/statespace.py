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
from flysid.model.kalman import start_gains
from flysid.model.linear_data import CHOICE_ROWS, Parts
from flysid.model.linear_start import START_SHARE
from flysid.model.selection import block_errors, judging_window, simplest
from flysid.model.start import WINDOW_LAGS, WINDOW_S
from flysid.model.statespace_model import FittedStateSpace, from_dict
from flysid.model.statespace_refine import SimulationError
from flysid.model.stream import OnDisk, Source
from flysid.model.subspace import (
    METHODS,
    Columns,
    Method,
    Projection,
    Realisation,
    default_past,
    project,
    triangle_for,
    window,
)
from flysid.model.threads import on_one_thread

Auto: TypeAlias = Literal["auto"]
HIGHEST_ORDER = 10
TRIED_METHODS: tuple[Method, ...] = ("pbsid", "cva", "moesp")
TRIED_PASTS = (5, 10, 20, 40)
ROWS_PER_UNKNOWN = 5
GROWTH = 1.1
"""Over the longest segment, of the fastest growing state: more than an integrator's rounding is refused."""
ITERATIONS = 30
MOST_WORK = 1e8
"""Samples times states times parameters up to which "auto" tries a refinement: some seconds."""
ORDER_WORTH = 0.04
"""Relative decrease of the validation mean square that a higher order must bring."""


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
    n_init : measured samples that start a simulation; None chooses.
    """

    order: int | Auto = "auto"
    method: Method | Auto = "auto"
    past: int | Auto = "auto"
    feedthrough: bool | Auto = "auto"
    refine: bool | Auto = "auto"
    n_init: int | None = None

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
        small = train.head(CHOICE_ROWS) if isinstance(train, OnDisk) else train
        parts = Parts.of(small, validation)
        if self.order != "auto" and self.past != "auto" and self.method != "auto":
            choice, note = _Choice(self.method, self.past, self.order), "Settings as given"
        else:
            choice, note = _searched(self, parts)
        if isinstance(train, OnDisk):
            if self.refine is True:
                raise UsageError("a refinement needs its data in memory", hint="fit data.read(), or a part")
            return _final(self, train, Parts.on_disk(train), choice, note)
        plain = _final(self, train, parts, choice, note)
        return plain if self.refine is False else _refined(self, parts, choice, plain)


@dataclass(frozen=True)
class _Choice:
    method: Method
    past: int
    order: int

    def __str__(self) -> str:
        return f"order {self.order} by {self.method.upper()} from {self.past} samples of past"


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


class _Projections:
    """Decompositions of one part of the data, all from one pass."""

    def __init__(self, settings: StateSpace, parts: Parts, data: Source, deepest: int) -> None:
        self.settings, self.signals = settings, (len(data.outputs), len(data.inputs))
        self.triangle = triangle_for(data, parts.scaling, deepest)

    def of(self, method: Method, past: int) -> Projection:
        """Raises DataError where the samples are too few."""
        columns = Columns.of(self.triangle, self.signals, past, method, feedthrough=True)
        return project(replace(columns, feedthrough=self._feedthrough(columns)), method)

    def _feedthrough(self, columns: Columns) -> bool:
        """Whether the present input explains more of the output than chance would (BIC)."""
        if self.settings.feedthrough != "auto":
            return self.settings.feedthrough
        r = np.asarray(
            np.linalg.qr(np.hstack([columns.one, columns.before, columns.inputs, columns.outputs]), mode="r")
        )
        n_y, n_u = self.signals
        at = len(r.T) - n_y
        with_u, without = r[at:, at:], r[at - n_u :, at:]
        gain = np.linalg.slogdet(without.T @ without)[1] - np.linalg.slogdet(with_u.T @ with_u)[1]
        return bool(gain * columns.rows > n_y * n_u * np.log(columns.rows))


def _pasts(settings: StateSpace, data: Dataset) -> list[int]:
    """Horizons that the data afford."""
    n_y, n_u = len(data.outputs), len(data.inputs)
    lengths = [len(s) for s in data.segments]
    if settings.past != "auto":
        return [settings.past]
    order = 2 if settings.order == "auto" else settings.order
    found = []
    for past in TRIED_PASTS:
        rows = sum(max(n - 2 * past, 0) for n in lengths)
        unknowns = past * (n_y + 2 * n_u)
        if past * n_y > order and 2 * rows > sum(lengths) and rows > ROWS_PER_UNKNOWN * unknowns:
            found.append(past)
    return found or [default_past(order, n_y, n_u, lengths)]


def _searched(settings: StateSpace, parts: Parts) -> tuple[_Choice, str]:
    """The best of methods, horizons and orders by the validation free run."""
    methods = TRIED_METHODS if settings.method == "auto" else (settings.method,)
    pasts = _pasts(settings, parts.fit)
    orders = range(1, HIGHEST_ORDER + 1) if settings.order == "auto" else [settings.order]
    best = _best_per_order(settings, parts, [(m, p) for m in methods for p in pasts], list(orders))
    if not best:
        raise FitError(
            "no state-space model of these settings could be fitted",
            hint="lower the order, look back on fewer samples, or bring longer segments",
        )
    index = simplest([errors for _, errors in best], ORDER_WORTH, ORDER_WORTH)
    table = ", ".join(f"order {c.order}: {np.sqrt(e.mean()) if len(e) else np.nan:.3g}" for c, e in best)
    note = (
        f"{best[index][0]} is the simplest within one standard error of the best validation free run"
        f" (RMSE in standard deviations of the output: {table})"
    )
    return best[index][0], note


def _best_per_order(
    settings: StateSpace, parts: Parts, ways: Sequence[tuple[Method, int]], orders: Sequence[int]
) -> list[tuple[_Choice, FloatArray]]:
    """For every order the method and horizon of the best validation free run, with its errors in blocks."""
    folds = [_tried(settings, fold, ways, orders) for fold in parts.folds]
    found: dict[int, tuple[_Choice, FloatArray]] = {}
    for choice in folds[0]:
        if not all(choice in fold for fold in folds):
            continue
        errors = np.concatenate([fold[choice] for fold in folds])
        if choice.order not in found or _mean(errors) < _mean(found[choice.order][1]):
            found[choice.order] = choice, errors
    return [found[order] for order in orders if order in found]


def _tried(
    settings: StateSpace, parts: Parts, ways: Sequence[tuple[Method, int]], orders: Sequence[int]
) -> dict[_Choice, FloatArray]:
    """The validation errors, in blocks, of everything that can be fitted and does not blow up."""
    shared = _Projections(settings, _scaled(parts), parts.fit, max(window(p, m) for m, p in ways))
    skip = judging_window(parts, max(orders))
    longest = max(len(s) for s in parts.train.segments)
    found: dict[_Choice, FloatArray] = {}
    for method, past in ways:
        try:
            projection = shared.of(method, past)
        except DataError:
            continue
        for order in orders:
            if order > projection.most:
                break
            model = _model(parts, projection.realise(order), skip)
            if np.abs(model.poles).max() ** longest < GROWTH:
                errors = block_errors(model, parts.check, skip, parts.scaling.y_scale)
                found[_Choice(method, past, order)] = errors
    return found


def _mean(errors: FloatArray) -> float:
    return float(errors.mean()) if len(errors) else np.inf


def _refined(
    settings: StateSpace, parts: Parts, choice: _Choice, plain: FittedStateSpace
) -> FittedStateSpace:
    """The model refined on the simulation error, or the plain one with the reason why not."""
    n, p = choice.order, choice.order * (choice.order + 3 * len(parts.train.outputs + parts.train.inputs))
    if settings.refine == "auto" and len(parts.train) * n * p > MOST_WORK:
        return plain
    skip = judging_window(parts, n)
    if settings.refine == "auto":
        before, after = (
            _mean(np.concatenate([_judged(settings, f, choice, skip, refine=r) for f in parts.folds]))
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
    start = _Projections(settings, _scaled(parts), parts.whole, window(choice.past, choice.method))
    problem = SimulationError(
        parts.whole.segments, start.of(choice.method, choice.past).realise(n), feedthrough
    )
    theta = problem.refine(ITERATIONS).theta
    model = _model(parts, problem.settled(theta), settings.n_init, feedthrough)
    factor = _units(parts, n, feedthrough)
    return replace(
        model,
        free=model.free - n * len(model.outputs),
        singular_values=plain.singular_values,
        noise=problem.noise(theta),
        covariance=problem.covariance(theta) * np.outer(factor, factor),
        notes=(*plain.notes, note),
    )


def _judged(settings: StateSpace, parts: Parts, choice: _Choice, skip: int, *, refine: bool) -> FloatArray:
    """Validation errors in blocks of the choice, fitted to the fitting part; inf where it blows up."""
    shared = _Projections(settings, _scaled(parts), parts.fit, window(choice.past, choice.method))
    projection = shared.of(choice.method, choice.past)
    found = projection.realise(choice.order)
    if refine:
        problem = SimulationError(parts.fit.segments, found, projection.columns.feedthrough)
        try:
            found = problem.settled(problem.refine(ITERATIONS).theta)
        except FitError:
            return np.array([np.inf])
    return block_errors(_model(parts, found, skip), parts.check, skip, parts.scaling.y_scale)


def _feeds_through(model: FittedStateSpace) -> bool:
    return bool(model.realisation.d.any())


def _units(parts: Parts, n: int, feedthrough: bool) -> FloatArray:
    """What turns A, B, C, drift, level (and D) of scaled deviations into physical units."""
    y, u = parts.scaling.y_scale, parts.scaling.u_scale
    pieces = [np.ones(n * n), np.tile(1.0 / u, n), np.repeat(y, n), np.ones(n), y]
    return np.concatenate([*pieces, *([np.outer(y, 1.0 / u).ravel()] if feedthrough else [])])


def _scaled(parts: Parts) -> Parts:
    """`parts.fit` is in scaled deviations already."""
    s = parts.scaling
    unit = replace(
        s,
        u_origin=np.zeros_like(s.u_origin),
        y_origin=np.zeros_like(s.y_origin),
        u_scale=np.ones_like(s.u_scale),
        y_scale=np.ones_like(s.y_scale),
    )
    return replace(parts, scaling=unit)


def _final(settings: StateSpace, data: Source, parts: Parts, choice: _Choice, note: str) -> FittedStateSpace:
    """The choice on all training data, which `parts` measured."""
    all_data = _Projections(settings, parts, data, window(choice.past, choice.method))
    projection = all_data.of(choice.method, choice.past)
    realisation = projection.realise(choice.order)
    model = _model(parts, realisation, settings.n_init, projection.columns.feedthrough)
    words = "" if choice.past != settings.past or choice.order != settings.order else f": {choice}"
    return replace(model, singular_values=projection.singular_values[:50], notes=(f"{note}{words}.",))


def _model(
    parts: Parts, realisation: Realisation, n_init: int | None = None, feedthrough: bool = True
) -> FittedStateSpace:
    """The model of a realisation in scaled deviations; its start long enough to know the state."""
    train = parts.train
    n, n_y, n_u = realisation.order, len(train.outputs), len(train.inputs)
    most = n_init or most_init(parts, n)
    gains, spread = start_gains(realisation, most)
    rows = n_init or enough(spread, n)
    physical = realisation.in_units(parts.scaling)
    return FittedStateSpace(
        dt_s=train.dt_s,
        inputs=train.inputs,
        outputs=train.outputs,
        output_limits=parts.limits,
        realisation=physical,
        u_origin=parts.scaling.u_origin,
        y_origin=parts.scaling.y_origin,
        gains=gains[:rows] / parts.scaling.y_scale,
        free=n * (n_u + 2 * n_y) + n_y * n_u * feedthrough + n_y,
        singular_values=np.zeros(0),
    )


def most_init(parts: Parts, order: int) -> int:
    """Samples that a start may take."""
    wanted = max(round(WINDOW_S / parts.train.dt_s), WINDOW_LAGS * order)
    shortest = min(len(s) for s in parts.train.segments)
    return max(order, min(wanted, int(START_SHARE * shortest)), 1)


def enough(spread: FloatArray, order: int) -> int:
    """Samples after which more of them help the free run little."""
    most = len(spread) - 1
    rows = min(order, most)
    while rows < most:
        wider = min(2 * rows, most)
        if spread[rows] < 0.3 or spread[wider] > 0.8 * spread[rows]:
            break
        rows = wider
    return rows


MODEL = Structure("statespace", from_dict)
