"""Where a model of rules comes to rest, its tangent there, and the polytope of its rules.

About a place at rest a model is its tangent: the blend of its consequents and, where its conditions speak of
what moves, the slopes of its memberships. A rule by itself is neither: what tells it from the others may
stand in its constant, which no gain shows (Johansen, Shorten and Murray-Smith 2000). Places are found at
given outputs, not at given inputs: of several places at rest for one input each has an output of its own.

A TS model is a polytopic (LPV) system, too: its one-step map is a convex combination of the rules' affine
maps, weighted by the firing strengths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.kernel import Lags, Parameters, strengths
from flysid.model.rules.recursion import Recursion
from flysid.model.rules.regressor_layout import Layout
from flysid.model.rules.rule_model import RuleModel

_NEWTON = 30  # steps to a place at rest


@dataclass(frozen=True, eq=False)
class Place:
    """Constant signals, and what a model does about them, normalised.

    Attributes
    ----------
    w : (n + n_u,) where every column stands.
    tangent : the model's derivative there; its constant is (n,) what the model steps to from there.
    shares : (R,) how loudly each rule speaks.
    """

    w: FloatArray
    tangent: Recursion
    shares: FloatArray

    @property
    def gap(self) -> FloatArray:
        """(n,) how far the next step leads from here; 0 at rest."""
        return self.tangent.c - self.w[: len(self.tangent.c)]


def all_terms(lags: Lags) -> Lags:
    """Everything that a step looks back to: regressors, antecedents, what is subtracted from these."""
    minus = lags.z_minus >= 0
    return lags._replace(
        column=np.concatenate([lags.column, lags.z_column, lags.z_column[minus]]),
        lag=np.concatenate([lags.lag, lags.z_lag, lags.z_minus[minus]]),
    )


def derivatives(
    lags: Lags, par: Parameters, x: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N, n) what steps lead to, (N, n, all terms) their slopes, memberships included, (N, R) shares.

    Parameters
    ----------
    x, z : (N, n_x) regressors and (N, n_z) antecedents, normalised.
    """
    moves = (z > par.z_range[0]) & (z < par.z_range[1])
    lean = (np.clip(z, *par.z_range)[:, None] - par.centre) / par.width
    shares = strengths(z, par)
    part = np.einsum("rim,km->kri", par.theta, x)
    value = np.einsum("kr,kri->ki", shares, part)
    blend = np.einsum("kr,rim->kim", shares, par.theta)
    apart = shares[:, :, None] * (part - value[:, None])
    bend = -np.einsum("kri,krj->kij", apart, lean / par.width) * moves[:, None]
    return value, np.concatenate([blend, bend, -bend[:, :, lags.z_minus >= 0]], axis=2), shares


@dataclass(frozen=True, eq=False)
class SteadyMap:
    """Places of a model."""

    layout: Layout
    parameters: Parameters

    @property
    def n(self) -> int:
        """Simulated columns."""
        return self.layout.n

    @cached_property
    def _terms(self) -> Lags:
        return all_terms(self.layout.lags)

    def at(self, w: FloatArray) -> Place:
        """The place where every signal has stood at w for long."""
        lags = self.layout.lags
        x = np.where(lags.column >= 0, w[lags.column], 1.0)
        z = np.where(lags.z_minus >= 0, 0.0, w[lags.z_column])
        value, slopes, shares = (one[0] for one in derivatives(lags, self.parameters, x[None], z[None]))
        return Place(w, Recursion.of(self._terms, slopes, len(w))._replace(c=value), shares)

    def resting(self, start: FloatArray, output: int, moved: int) -> Place | None:
        """Where the model rests while an output stands where `start` has it; None where none is found.

        Parameters
        ----------
        start : (n + n_u,) all other columns of outputs and states are searched from here, inputs stay,
        moved : but this one, which holds the output there.
        """
        free = [*(c for c in range(self.n) if c != output), self.n + moved]
        return self.solved(start, free, range(self.n))

    def solved(self, start: FloatArray, free: Sequence[int], rows: Sequence[int]) -> Place | None:
        """Where the columns `rows` step to themselves, found by moving the columns `free` (Newton)."""
        free, rows = list(free), list(rows)
        place = self.at(start)
        for _ in range(_NEWTON):
            gap = place.gap[rows]
            size = float(np.abs(gap).max(initial=0.0))
            if size < ROUNDING:
                return place
            A, B, _ = place.tangent
            slopes = np.hstack([A.sum(axis=0) - np.eye(self.n), B.sum(axis=0)])
            step = np.linalg.lstsq(slopes[np.ix_(rows, free)], -gap, rcond=None)[0]
            for shorter in 0.5 ** np.arange(8):
                w = place.w.copy()
                w[free] += shorter * step
                tried = self.at(w)
                if np.abs(tried.gap[rows]).max() < size:
                    break
            else:
                return None
            place = tried
        return None


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
