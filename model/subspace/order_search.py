"""Orders, methods and horizons of a state-space model: from one pass, judged by the validation free run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, TypeAlias

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError
from flysid.model.linear.data import Parts, judging_window
from flysid.model.selection import block_errors, simplest
from flysid.model.start import most_start_rows, settled_start_rows
from flysid.model.stream import Source
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.subspace.kalman import gains_of, start_gains
from flysid.model.subspace.triangle import (
    Columns,
    Method,
    Projection,
    Realisation,
    default_past,
    project,
    triangle_for,
    window,
)

Auto: TypeAlias = Literal["auto"]
HIGHEST_ORDER = 10
TRIED_METHODS: tuple[Method, ...] = ("pbsid", "cva", "moesp")
TRIED_PASTS = (5, 10, 20, 40)
ROWS_PER_UNKNOWN = 5
GROWTH = 1.1
"""Over the longest segment, of the fastest growing state: more than an integrator's rounding is refused."""
ORDER_WORTH = 0.04
"""Relative decrease of the validation mean square that a higher order must bring."""


class SubspaceSettings(Protocol):
    """What the search needs to know; `StateSpace` is such settings."""

    @property
    def order(self) -> int | Auto: ...
    @property
    def method(self) -> Method | Auto: ...
    @property
    def past(self) -> int | Auto: ...
    @property
    def feedthrough(self) -> bool | Auto: ...


@dataclass(frozen=True)
class Choice:
    method: Method
    past: int
    order: int

    def __str__(self) -> str:
        return f"order {self.order} by {self.method.upper()} from {self.past} samples of past"


class Projections:
    """Decompositions of one part of the data, all from one pass."""

    def __init__(self, settings: SubspaceSettings, parts: Parts, data: Source, deepest: int) -> None:
        self.settings = settings
        self.signals = (len(data.outputs), len(data.inputs))
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
        with_u = r[at:, at:]
        without = r[at - n_u :, at:]
        gain = np.linalg.slogdet(without.T @ without)[1] - np.linalg.slogdet(with_u.T @ with_u)[1]
        return bool(gain * columns.rows > n_y * n_u * np.log(columns.rows))


def _pasts(settings: SubspaceSettings, data: Dataset) -> list[int]:
    """Horizons that the data afford."""
    n_y = len(data.outputs)
    n_u = len(data.inputs)
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


def search(settings: SubspaceSettings, parts: Parts) -> tuple[Choice, str, float]:
    """The best of methods, horizons and orders by the validation free run.

    Raises FitError: none could be fitted.
    """
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
    return best[index][0], note, mean_of(best[index][1])


def _best_per_order(
    settings: SubspaceSettings, parts: Parts, ways: Sequence[tuple[Method, int]], orders: Sequence[int]
) -> list[tuple[Choice, FloatArray]]:
    """For every order the method and horizon of the best validation free run, with its errors in blocks."""
    folds = [_try_all(settings, fold, ways, orders) for fold in parts.folds]
    found: dict[int, tuple[Choice, FloatArray]] = {}
    for choice in folds[0]:
        if not all(choice in fold for fold in folds):
            continue
        errors = np.concatenate([fold[choice] for fold in folds])
        if choice.order not in found or mean_of(errors) < mean_of(found[choice.order][1]):
            found[choice.order] = choice, errors
    return [found[order] for order in orders if order in found]


def _try_all(
    settings: SubspaceSettings, parts: Parts, ways: Sequence[tuple[Method, int]], orders: Sequence[int]
) -> dict[Choice, FloatArray]:
    """The validation errors, in blocks, of everything that can be fitted and does not blow up."""
    shared = Projections(settings, already_scaled(parts), parts.fit, max(window(p, m) for m, p in ways))
    skip = judging_window(parts, max(orders))
    longest = max(len(s) for s in parts.train.segments)
    found: dict[Choice, FloatArray] = {}
    for method, past in ways:
        try:
            projection = shared.of(method, past)
        except DataError:
            continue
        for order in orders:
            if order > projection.most:
                break
            model = built(parts, projection.realise(order), skip)
            if np.abs(model.poles).max() ** longest < GROWTH:
                errors = block_errors(model, parts.check, skip, parts.scaling.y_scale)
                found[Choice(method, past, order)] = errors
    return found


def mean_of(errors: FloatArray) -> float:
    """Mean of block errors; inf where there are none."""
    return float(errors.mean()) if len(errors) else np.inf


def already_scaled(parts: Parts) -> Parts:
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


def built(
    parts: Parts, realisation: Realisation, n_init: int | None = None, feedthrough: bool = True
) -> FittedStateSpace:
    """The model of a realisation in scaled deviations; its start long enough to know the state."""
    train = parts.train
    n = realisation.order
    n_y = len(train.outputs)
    n_u = len(train.inputs)
    if n_init:
        gains = gains_of(realisation, n_init)
        rows = n_init
    else:
        gains, spread = start_gains(realisation, most_init(parts, n))
        most = len(spread) - 1
        rows = settled_start_rows(lambda rows: float(spread[rows]), min(n, most), most)
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
    return most_start_rows(order, parts.train.dt_s, min(len(s) for s in parts.train.segments))
