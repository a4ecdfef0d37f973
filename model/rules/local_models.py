"""Local linear models of rules: their tangent at constant signals, and the polytope of the rules.

A TS model is a polytopic (LPV) system: its one-step map is a convex combination of the rules' affine maps,
weighted by the firing strengths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.recursion import Recursion
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.steady_map import SteadyMap


@dataclass(frozen=True, eq=False)
class LocalStateSpace:
    """s(k+1) = A s(k) + B u(k) + f,  y(k) = C s(k) + D u(k) + g, physical units.

    s holds past outputs and hidden states x(k-1), ..., x(k-n), then past inputs u(k-1), ..., u(k-m); A, B and
    f are exact companion matrices of the lags, shared by every rule but for the first block of rows.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    f: FloatArray
    g: FloatArray
    dt_s: float


def polytope(model: RuleModel) -> tuple[LocalStateSpace, ...]:
    """The rules as local state spaces over one common state, ready for parallel distributed compensation."""
    return tuple(_state_space(model, rule) for rule in model.recursions())


def _state_space(model: RuleModel, recursion: Recursion) -> LocalStateSpace:
    A, B, c = recursion
    n_y = model.layout.n_y
    past, n, _ = A.shape
    later, _, n_u = B[1:].shape
    own = past * n
    size = own + later * n_u
    newest = np.hstack([np.zeros((n, 0)), *A, *B[1:]])
    shift = np.eye(size, k=-n)  # of outputs by one sample, and of inputs
    shift[own:] = np.eye(size, k=-n_u)[own:]
    shift[own : own + n_u] = 0.0
    drive = np.zeros((size, n_u))
    drive[own : own + n_u] = np.eye(n_u)[: size - own]
    offset = np.zeros(size)
    if past:
        shift[:n], drive[:n], offset[:n] = newest, B[0], c
    return LocalStateSpace(shift, drive, newest[:n_y], B[0, :n_y].copy(), offset, c[:n_y].copy(), model.dt_s)


def linearise(model: RuleModel, at: Mapping[str, float]) -> LocalStateSpace:
    """The model's derivative while every signal stands at a value, memberships included.

    Hidden states stand where they rest beside the others.

    Parameters
    ----------
    at : signal's name -> value; signals left out stand at their mean in training.

    Raises
    ------
    UsageError : a name that is no signal of the model, a value that is no number, hidden states that come
        to no rest, a place at which the model is at its limit.
    """
    layout = model.layout
    n = layout.n
    shift, scale = layout.shift, layout.scale
    names = [s.name for s in layout.signals]
    own = [s.name for s in (*model.outputs, *model.inputs)]
    w = np.zeros(len(scale))
    for name, value in at.items():
        if name not in own:
            raise UsageError(f"the model has no signal {name!r}", hint=f"one of {', '.join(own)}")
        if not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise UsageError(f"{name}={value!r} is not an operating point", hint="give a finite number")
        column = names.index(name)
        w[column] = (value - shift[column]) / scale[column]
    hidden = range(layout.n_y, n)
    place = SteadyMap(layout, model.free).solved(w, hidden, hidden)
    if place is None:
        raise UsageError(
            "the model has no equilibrium at this operating point",
            hint="choose one inside the training range; an integrating process rests at one input only",
        )
    _refuse_limit(model, place.tangent.c)
    A, B, steps_to = place.tangent
    ratio = scale[:n, None] / scale
    A = A * ratio[:, :n]
    B = B * ratio[:, n:]
    stands = place.w * scale + shift
    c = steps_to * scale[:n] + shift[:n] - A.sum(axis=0) @ stands[:n] - B.sum(axis=0) @ stands[n:]
    return _state_space(model, Recursion(A, B, c))


def _refuse_limit(model: RuleModel, x: FloatArray) -> None:
    """Raise UsageError where an output or state (n,) stands at its limits: nothing moves it there."""
    for i, (value, low, high) in enumerate(zip(x, *model.free.limits, strict=True)):
        rounding = ROUNDING * (high - low)
        if not low + rounding < value < high - rounding:
            at = np.clip(value, low, high) * model.layout.scale[i] + model.layout.shift[i]
            raise UsageError(
                f"the model is saturated there, at {at:.4g}, and has no linear model",
                hint="choose a place inside the training range",
            )
