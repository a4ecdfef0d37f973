"""The linear side's best model of the same orders, as a start for the rules.

What ARX finds by orthogonal least squares and refines with its own parametrisation is where a TS model of
one rule should stand at least; starting there keeps the two sides comparable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.arx import ARX
from flysid.model.fuzzy.grow import Stage, unrefined
from flysid.model.fuzzy.layout import Layout, Orders
from flysid.model.fuzzy.problem import Body, Problem
from flysid.model.linear.model import FittedLinear


def chosen_by_arx(
    train: Dataset, validation: Dataset, nk_hint: Sequence[int] = ()
) -> tuple[Orders, FittedLinear] | None:
    """The orders, delays included, that ARX chooses by itself, with its model; None where it cannot."""
    try:
        fitted = ARX(refine=True, nk_hint=nk_hint).fit(train, validation)
    except FlysidError:
        return None
    a, b = fitted.system.a, fitted.system.b
    lags = [np.flatnonzero(np.abs(b[:, :, j]).max(axis=1) > 0) for j in range(b.shape[2])]
    nk = tuple(int(at[0]) if len(at) else 0 for at in lags)
    nb = tuple(int(at[-1] - at[0]) + 1 if len(at) else 0 for at in lags)
    return Orders(len(a) - 1, nb, nk), fitted


def as_stage(fitted: FittedLinear, problem: Problem) -> Stage:
    """A linear model as a stage of a problem with the same orders."""
    n_y, n_x = problem.layout.n_y, len(problem.layout.regressors)
    still = np.zeros((1, problem.z_range.shape[1]))
    body = Body(np.zeros((1, n_y, n_x)), still, np.ones_like(still))
    return unrefined(replace(problem, offset=consequents(fitted, problem.layout)), body)


def arx_start(problem: Problem, data: Dataset) -> tuple[Stage, ...]:
    """ARX of `problem`'s orders, refined, as a stage; none where it cannot be fitted."""
    orders = problem.layout.orders
    try:
        fitted = ARX(na=orders.na, nb=orders.nb, nk=orders.nk, refine=True).fit(data)
    except FlysidError:
        return ()
    return (as_stage(fitted, problem),)


def consequents(fitted: FittedLinear, layout: Layout) -> FloatArray:
    """(n_y, n_x) the linear model's equation over `layout`'s regressors, in its normalised units."""
    a, b = fitted.system.a, fitted.system.b
    theta = np.zeros((layout.n_y, len(layout.regressors)))
    rest = fitted.system.c + a.sum(axis=0) @ fitted.y_origin - b.sum(axis=0) @ fitted.u_origin
    for m, (column, lag) in enumerate(layout.regressors):
        if column < 0:
            continue
        if column < layout.n_y:
            gain = -a[lag][:, column] if lag < len(a) else np.zeros(layout.n_y)
        else:
            gain = b[lag][:, column - layout.n_y] if lag < len(b) else np.zeros(layout.n_y)
        theta[:, m] = gain * layout.scale[column]
        rest = rest + gain * layout.shift[column]
    constant = [column for column, _ in layout.regressors].index(-1)
    theta[:, constant] = rest - layout.shift[: layout.n_y]
    normalised: FloatArray = theta / layout.scale[: layout.n_y, None]
    return normalised
