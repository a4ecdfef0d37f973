"""Fitted linear models as one rule, over lags and over states: where rules start from.

What ARX and subspace identification find with their own parametrisations, delays and orders is written as one
rule over lags, and judged on the very data the rules are judged on. A state space of order n is a difference
equation of order n (Cayley and Hamilton), so that nothing is lost on the way.

A difference equation is realised in states of which the first are the outputs. What the hidden ones mean is a
choice; the linear model is the same in all of them, but rules look along single states. Offered are the rates
("how fast the output is about to change": C(A-I), C(A-I)^2, ...) and, for every real pole, the mode that
drives the others without being driven by them (in a cascade of tanks the upper one, in a vehicle the
actuator).
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
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.free_run_error import Body, Problem
from flysid.model.rules.growth import skip_refining
from flysid.model.rules.recursion import Recursion
from flysid.model.rules.regressor_layout import Layout, Orders
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.stages import Stage
from flysid.model.statespace import StateSpace
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.subspace.order_search import HIGHEST_ORDER

_MOST_CHOICES = 3  # of coordinates, each of which is grown from
PLAIN = "plain"
"""The coordinates that a realisation comes in; hidden states are then made uncorrelated."""
PLAIN_WORDS = "uncorrelated with the outputs and with each other"


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
    if fitted.order > HIGHEST_ORDER:
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
    elif isinstance(model, FittedStateSpace) and model.order <= HIGHEST_ORDER:
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
    return skip_refining(replace(problem, offset=consequents(found, problem.layout)), body)


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


@dataclass(frozen=True, eq=False)
class StateRealisation:
    """x(k) = A x(k-1) + sum_lag B[lag] u(k-lag) + c, y = the first n_y states; in normalised units.

    Attributes
    ----------
    law : A, one of them, B and c.
    orders : at which lags the inputs enter.
    words : what the hidden states are.
    title : what the system is.
    """

    law: Recursion
    orders: Orders
    words: str = "as the difference equation has them"
    title: str = ""

    def __len__(self) -> int:
        """States."""
        return len(self.law.c)

    def transformed(self, T: FloatArray, shift: FloatArray, words: str = "") -> StateRealisation:
        """The same system in the states T x - shift; T and shift must keep the outputs."""
        (A,), B, c = self.law
        A = T @ A @ np.linalg.inv(T)
        law = Recursion(A[None], T @ B, T @ c + A @ shift - shift)
        return replace(self, law=law, words=words or self.words)

    @classmethod
    def of(cls, layout: Layout, theta: FloatArray) -> StateRealisation:
        """The system that a consequent (n, n_x), in the order of `layout.regressors`, stands for."""
        return cls(Recursion.of(layout.lags, theta, len(layout.scale)), layout.orders)

    def consequent(self, layout: Layout) -> FloatArray:
        """(n, n_x) A, B and c in the order of `layout.regressors`."""
        (A,), B, c = self.law
        n = len(A)
        columns = [
            c if column < 0 else A[:, column] if column < n else B[lag][:, column - n]
            for column, lag in layout.regressors
        ]
        return np.stack(columns, axis=1)


def realise(fitted: FittedLinear, shift: FloatArray, scale: FloatArray) -> StateRealisation:
    """A difference equation in states (observer form), normalised by (n_y + n_u,) shift and scale.

    Delays common to all outputs become the inputs' lags. What is deeper than the order is dropped: the
    refinement that follows makes up for it.
    """
    n_y = len(fitted.outputs)
    a = fitted.system.a
    b = fitted.system.b
    rest = fitted.system.c + a.sum(axis=0) @ (fitted.y_origin - shift[:n_y])
    rest = (rest - b.sum(axis=0) @ (fitted.u_origin - shift[n_y:])) / scale[:n_y]
    order = max(len(a) - 1, 1)
    n = order * n_y
    A = np.eye(n, k=n_y)
    c = np.concatenate([rest, np.zeros(n - n_y)])
    for lag in range(1, len(a)):
        A[(lag - 1) * n_y : lag * n_y, :n_y] -= a[lag] * scale[None, :n_y] / scale[:n_y, None]
    delays = [_first_lag(b[:, :, j]) for j in range(b.shape[2])]
    orders = Orders.of_states([(0, 1) if delay == 0 else (delay,) for delay in delays])
    B = np.zeros((orders.depth + 1, n, len(delays)))
    for j, delay in enumerate(delays):
        taps = b[max(delay - 1, 0) :, :, j] * scale[n_y + j] / scale[:n_y]  # taps[1] is the delay's gain
        for lag in range(1, min(order + 1, len(taps))):
            B[max(delay, 1)][(lag - 1) * n_y : lag * n_y, j] = taps[lag]
        if delay == 0:
            B[0][:n_y, j] = taps[0]
    return StateRealisation(Recursion(A[None], B, c), orders)


def _first_lag(taps: FloatArray) -> int:
    moving = np.flatnonzero(np.abs(taps).max(axis=1) > 0)
    return int(moving[0]) if len(moving) else 1


def coordinates(plain: StateRealisation, n_y: int) -> dict[str, StateRealisation]:
    """The same system with its hidden states chosen in different ways, most readable first, by name."""
    n = len(plain)
    if n == n_y:
        return {PLAIN: plain}
    C = np.eye(n_y, n)
    rates = [C]
    while len(rates) * n_y < n:
        rates.append(rates[-1] @ (plain.law.A[0] - np.eye(n)))
    rate_rows = np.vstack(rates)[n_y:n]
    choices = [("rates", rate_rows, "rates of change of the outputs to come")]
    modes = driving_modes(plain.law.A[0], n_y)
    for i, mode in enumerate(modes):
        rows = np.vstack([mode[None], rate_rows])[: n - n_y]
        choices.append((f"mode {i + 1}", rows, "a mode of its own that drives the outputs"))
    if n - n_y >= 2 and len(modes) >= n - n_y:
        choices.append(("modes", np.stack(modes[: n - n_y]), "modes of their own that drive the outputs"))
    found: dict[str, StateRealisation] = {}
    for name, rows, words in choices:
        size = np.linalg.norm(rows, axis=1, keepdims=True)
        T = np.vstack([C, rows / np.where(size > 0, size, 1.0)])
        if np.linalg.cond(T) < 1.0 / ROUNDING and len(found) < _MOST_CHOICES:
            found[name] = plain.transformed(T, np.zeros(n), words)
    return found or {PLAIN: plain}


def uncorrelated(covariance: FloatArray, n_y: int) -> FloatArray:
    """(n, n) T that keeps the outputs and makes the other states uncorrelated, of spread one."""
    n = len(covariance)
    T = np.eye(n)
    if n == n_y:
        return T
    seen = covariance[:n_y, :n_y]
    cross = covariance[n_y:, :n_y]
    R = np.linalg.lstsq(seen, cross.T, rcond=1e-12)[0].T
    left = covariance[n_y:, n_y:] - R @ cross.T
    size = np.sqrt(np.maximum(np.diag(covariance)[n_y:], 1e-300))
    values, vectors = np.linalg.eigh(left / np.outer(size, size))
    still = values < 1e-12  # a state that the outputs say already
    root = vectors.T / np.where(still, 1.0, np.sqrt(np.maximum(values, 1e-12)))[:, None] / size
    T[n_y:] = np.hstack([-root @ R, root])
    return T


def driving_modes(A: FloatArray, n_y: int) -> list[FloatArray]:
    """Left eigenvectors, fastest pole first: l'x(k) = p l'x(k-1) + inputs, driven by no other state.

    Of a complex pair, for which no such state exists, the real part: the state least driven by others.
    """
    values, vectors = np.linalg.eig(A.T)
    found = []
    for i in np.argsort(np.abs(values), kind="stable"):
        hidden = vectors[n_y:, i]
        largest = hidden[np.argmax(np.abs(hidden))]
        if values[i].imag >= 0 and abs(largest) > 1e-6 * np.abs(vectors[:, i]).max():
            found.append(np.ascontiguousarray((vectors[:, i] / largest).real))
    return found
