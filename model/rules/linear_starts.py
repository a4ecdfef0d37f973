"""The linear side's best models: where the rules start from, and what one rule must be as good as.

What ARX and subspace identification find with their own parametrisations, delays and orders is written as one
rule over lags, and judged on the very data the rules are judged on. A state space of order n is a difference
equation of order n (Cayley and Hamilton), so that nothing is lost on the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.armax import ARMAX
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.bj import BJ
from flysid.model.freerun import Difference
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.oe import OE
from flysid.model.rules.free_run_error import Body, Problem
from flysid.model.rules.growth import unrefined
from flysid.model.rules.regressor_layout import Layout, Orders
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.stages import Stage
from flysid.model.statespace import StateSpace
from flysid.model.subspace.fitted_model import FittedStateSpace

_MOST_STATES = 10  # as difference equations, higher orders lose their poles to rounding


@dataclass(frozen=True, eq=False)
class LinearStart:
    """A linear difference equation in physical units, around its origins, and how it is fitted again.

    Attributes
    ----------
    name : of the structure.
    again : its settings with the orders fixed.
    """

    name: str
    orders: Orders
    system: Difference
    u_origin: FloatArray
    y_origin: FloatArray
    again: Estimator

    @property
    def refined(self) -> bool:
        """It was refined on the simulation error, as one rule is."""
        return isinstance(self.again, ARX) and bool(self.again.refine)

    def refitted(self, data: Dataset) -> LinearStart | None:
        """The same orders on other data; None where they cannot be fitted."""
        return _fit(self.name, self.again, data, None)


def linear_models(train: Dataset, validation: Dataset, nk_hint: Sequence[int] = ()) -> list[LinearStart]:
    """What the linear side finds on `train` by itself, each structure once; fewer where one cannot."""
    settings: dict[str, ARX | StateSpace] = {
        "ARX": ARX(nk_hint=nk_hint),
        "state space": StateSpace(refine=False, nk=1),
    }
    found = [_fit(name, kind, train, validation) for name, kind in settings.items()]
    return [model for model in found if model is not None]


def _fit(name: str, settings: Estimator, train: Dataset, validation: Dataset | None) -> LinearStart | None:
    try:
        fitted = settings.fit(train, validation)
    except FlysidError:
        return None
    assert isinstance(fitted, FittedLinear | FittedStateSpace)
    again = same_orders(fitted)
    if isinstance(fitted, FittedLinear):
        return LinearStart(
            name, orders_of(fitted.system), fitted.system, fitted.u_origin, fitted.y_origin, again
        )
    if fitted.order > _MOST_STATES:
        return None
    system = as_difference(fitted)
    return LinearStart(name, orders_of(system), system, fitted.u_origin, fitted.y_origin, again)


def same_orders(model: FittedLinear | FittedStateSpace) -> Estimator:
    """Settings that fit a linear model again with the orders and delays it has, refined where it is."""
    if isinstance(model, FittedStateSpace):
        late = tuple(k + 1 for k in model.delays) or 1
        return StateSpace(order=model.order, refine=model.noise is not None, nk=late)
    orders = orders_of(model.system)
    if model.structure == "arx":
        return ARX(na=orders.na, nb=orders.nb, nk=orders.nk, refine=model.noise is not None)
    kinds: dict[str, type[OE | ARMAX | BJ]] = {"oe": OE, "armax": ARMAX, "bj": BJ}
    return kinds[model.structure](na=orders.na, nb=orders.nb, nk=orders.nk)


def orders_of(system: Difference) -> Orders:
    lags = [np.flatnonzero(np.abs(system.b[:, :, j]).max(axis=1) > 0) for j in range(system.b.shape[2])]
    nk = tuple(int(at[0]) if len(at) else 0 for at in lags)
    nb = tuple(int(at[-1] - at[0]) + 1 if len(at) else 0 for at in lags)
    return Orders(len(system.a) - 1, nb, nk)


def as_difference(model: FittedStateSpace) -> Difference:
    """The state space as a difference equation with its characteristic polynomial."""
    r = model.realisation
    n = r.order
    n_y = len(r.c)
    a = np.real(np.poly(r.a)) if n else np.ones(1)
    states = np.column_stack([r.b, r.drift])
    response = [np.column_stack([r.d, np.zeros(n_y)])]
    for _ in range(n):
        response.append(r.c @ states)
        states = r.a @ states
    b = np.stack(
        [
            sum((a[j] * response[k - j] for j in range(k + 1)), np.zeros_like(response[0]))
            for k in range(n + 1)
        ]
    )
    late = np.zeros((n + 1 + max(model.delays, default=0), n_y, r.b.shape[1]))
    for j, delay in enumerate(model.delays or (0,) * late.shape[2]):
        late[delay : delay + n + 1, :, j] = b[:, :, j]
    return Difference(a[:, None, None] * np.eye(n_y), late, b[:, :, -1].sum(axis=0) + a.sum() * r.level)


def as_linear(model: Fitted) -> LinearStart | None:
    """A fitted linear model as a difference equation; None where its order is too high for one."""
    if isinstance(model, FittedLinear):
        system = model.system
    elif isinstance(model, FittedStateSpace) and model.order <= _MOST_STATES:
        system = as_difference(model)
    elif isinstance(model, RuleModel) and model.structure == "ts" and len(model.parameters.theta) == 1:
        system = model.local_polynomials()[0].difference
        still = np.zeros(len(model.inputs)), np.zeros(len(model.outputs))
        return LinearStart(model.structure, orders_of(system), system, *still, ARX())
    else:
        return None
    return LinearStart(model.structure, orders_of(system), system, model.u_origin, model.y_origin, ARX())


def as_stage(found: LinearStart, problem: Problem) -> Stage:
    """A linear model as a stage of a problem with the same orders."""
    still = np.zeros((1, problem.z_range.shape[1]))
    body = Body(np.zeros((1, problem.layout.n_y, len(problem.basis))), still, np.ones_like(still))
    return unrefined(replace(problem, offset=consequents(found, problem.layout)), body)


def arx_start(problem: Problem, data: Dataset) -> tuple[Stage, ...]:
    """ARX of `problem`'s orders, refined, as a stage; none where it cannot be fitted."""
    orders = problem.layout.orders
    found = _fit("ARX", ARX(na=orders.na, nb=orders.nb, nk=orders.nk, refine=True), data, None)
    return () if found is None else (as_stage(found, problem),)


def consequents(found: LinearStart, layout: Layout) -> FloatArray:
    """(n_y, n_x) the linear model's equation over `layout`'s regressors, in its normalised units."""
    a = found.system.a
    b = found.system.b
    theta = np.zeros((layout.n_y, len(layout.regressors)))
    rest = found.system.c + a.sum(axis=0) @ found.y_origin - b.sum(axis=0) @ found.u_origin
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
