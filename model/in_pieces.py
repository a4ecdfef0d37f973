"""One-step predictions of a record that comes in pieces, equal to `predict(u, y, 1)` along the whole of it.

A watch is fed a few samples many times a second. What `predict` computes from the record's beginning on (a
free run, filtered errors) is carried on here instead, by the function that the structure's row names
(`flysid.model.structures.Structure.pieces`). Any other structure is predicted from its latest seconds again
and again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.model.base import Fitted
from flysid.model.ensemble import FittedEnsemble
from flysid.model.freerun import saturate
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.own_constants import shapes
from flysid.model.rules.kernel import free_run
from flysid.model.rules.likely_start import LikelyStart
from flysid.model.rules.rule_model import RuleModel
from flysid.model.start import drifting_of, estimate_start
from flysid.model.structures import row_of
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.subspace.kalman import filtered_states, free_states, output_of
from flysid.offers import import_name


class InPieces(Protocol):
    """Predictions of a record from its first sample on."""

    def feed(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(n, n_y) predictions of the next samples u (n, n_u), y (n, n_y); NaN where there is none."""
        ...


_KNOWN_S, _STARTS = 5.0, 5
"""Seconds, and starts of a free run in samples, after which a constant is known beside coloured noise."""
FreeRun = Callable[[FloatArray], FloatArray]
"""A free run that goes on: (n, n_y) outputs for the next inputs (n, n_u)."""


def in_pieces(model: Fitted, *, remembered_s: float = 10.0) -> InPieces:
    """What predicts a record that comes in pieces.

    `remembered_s`: of a structure whose row names no function for it.

    >>> ahead = in_pieces(model)  # doctest: +SKIP
    >>> ahead.feed(u[:10], y[:10]); ahead.feed(u[10:], y[10:])  # doctest: +SKIP
    """
    row = row_of(model.structure)
    own: InPieces | None = import_name(row.pieces)(model) if row.pieces else None
    return own or _Again(model, round(remembered_s / model.dt_s))


def members_in_pieces(model: Fitted) -> InPieces | None:
    """The mean of the members' predictions; as all of these None where another class bears the name."""
    return _Averaged(model) if isinstance(model, FittedEnsemble) else None


def rules_in_pieces(model: Fitted) -> InPieces | None:
    """Rules, over lags or over hidden states, with or without a noise model."""
    if not isinstance(model, RuleModel):
        return None
    if model.noise is None and not model.layout.hidden:
        return from_the_newest(model)
    measured = model.start.settled(model.dt_s)
    return _OutputError(model, measured, model.noise, None, lambda u, y: _rules(model, u, y, measured))


def states_in_pieces(model: Fitted) -> InPieces | None:
    """A state space with a noise model; without one its filter remembers all that it has seen."""
    if not isinstance(model, FittedStateSpace) or model.noise is None:
        return None
    return _OutputError(model, model.n_init, model.noise, None, lambda u, y: _states(model, u, y))


def equation_in_pieces(model: Fitted) -> InPieces | None:
    """A difference equation, with or without a noise model."""
    if not isinstance(model, FittedLinear):
        return None
    if model.noise is not None:
        return _OutputError(model, model.n_init, model.noise, model.ma, lambda u, y: _difference(model, u, y))
    return from_the_newest(model) if model.ma is None else None


def from_the_newest(model: Fitted) -> InPieces:
    """A model that predicts from its newest `n_init` samples alone."""
    return _Again(model, model.n_init)


class _Again:
    """Predicts from the latest samples again."""

    def __init__(self, model: Fitted, samples: int) -> None:
        self._model = model
        self._samples = max(1, model.n_init, samples)
        self._u = np.empty((0, len(model.inputs)))
        self._y = np.empty((0, len(model.outputs)))

    def feed(self, u: FloatArray, y: FloatArray) -> FloatArray:
        kept_u = np.concatenate([self._u, u])
        kept_y = np.concatenate([self._y, y])
        self._u = kept_u[-self._samples :]
        self._y = kept_y[-self._samples :]
        return self._model.predict(kept_u, kept_y, 1)[len(kept_u) - len(u) :]


class _Averaged:
    """The mean of an ensemble's members."""

    def __init__(self, model: FittedEnsemble) -> None:
        self._members = [in_pieces(member) for member in model.members]
        self._blank = model.n_init

    def feed(self, u: FloatArray, y: FloatArray) -> FloatArray:
        mean = np.mean([member.feed(u, y) for member in self._members], axis=0)
        mean[: self._blank] = np.nan
        self._blank = max(0, self._blank - len(u))
        return np.asarray(mean)


class _OutputError:
    """A free run, and what the noise model foresees of its error.

    `measured`: samples that the free run is started from; until more have come, `predict` answers.
    `noise`, `ma`: (p + 1, n_y) and (q + 1, n_y) monic, or None.
    `begun`: the free run from the first samples on: its outputs along them, and what carries it on.
    """

    def __init__(
        self,
        model: Fitted,
        measured: int,
        noise: FloatArray | None,
        ma: FloatArray | None,
        begun: Callable[[FloatArray, FloatArray], tuple[FloatArray, FreeRun]],
    ) -> None:
        self._model = model
        self._measured = measured
        self._begun = begun
        self._u = np.empty((0, len(model.inputs)))
        self._y = np.empty((0, len(model.outputs)))
        self._run: FreeRun | None = None
        self._foreseen = None if noise is None else _Foreseen(noise, ma, model.n_init)
        drifting = drifting_of([model])
        enough = max(round(_KNOWN_S / model.dt_s), _STARTS * model.n_init)
        self._own = None if drifting is None else _OwnPart(drifting, model.dt_s, enough, begun)

    def feed(self, u: FloatArray, y: FloatArray) -> FloatArray:
        if self._run is not None:
            free = self._beside(self._run(u), u, y)
            return free if self._foreseen is None else np.asarray(free + self._foresee(y - free))
        self._u = np.concatenate([self._u, u])
        self._y = np.concatenate([self._y, y])
        predicted = self._model.predict(self._u, self._y, 1)[len(self._u) - len(u) :]
        if len(self._u) > self._measured:
            free, self._run = self._begun(self._u, self._y)
            if self._own is not None:
                free = self._own.begin(free, self._u, self._y)
            self._foresee(self._y - free)
        return predicted if self._own is None else np.full_like(predicted, np.nan)

    def _foresee(self, errors: FloatArray) -> FloatArray:
        """What the noise model foresees of errors; those that are not known count as none."""
        return errors if self._foreseen is None else self._foreseen.feed(np.nan_to_num(errors))

    def _beside(self, free: FloatArray, u: FloatArray, y: FloatArray) -> FloatArray:
        """The free run, and what the flight has had of its own beside it."""
        return free if self._own is None or not len(u) else self._own.feed(free, u, y)


class _OwnPart:
    """What a flight has of its own beside a model (`flysid.model.own_constants`), as far as it has come.

    By least squares over all errors of the free run so far: a wind that is there from the start is soon
    known, and a change later on stands out for the longer the more has been flown before. What one unit
    does is the difference of two free runs: from outputs that have it, and from outputs without it. Until
    it has been seen in `enough` samples nothing is predicted.
    """

    def __init__(
        self,
        drifting: tuple[bool, ...],
        dt_s: float,
        enough: int,
        begun: Callable[[FloatArray, FloatArray], tuple[FloatArray, FreeRun]],
    ) -> None:
        self._drifting = drifting
        self._dt_s = dt_s
        self._enough = enough
        self._begun = begun
        self._runs: list[FreeRun] = []
        self._rows = 0
        self._moved = np.zeros(len(drifting))
        self._weight = np.zeros(len(drifting))

    def begin(self, free: FloatArray, u: FloatArray, y: FloatArray) -> FloatArray:
        """`feed` of the first samples."""
        unit = shapes(self._drifting, len(u), self._dt_s)
        others = [self._begun(u, y - unit * one) for one in np.eye(y.shape[1])]
        self._runs = [run for _, run in others]
        return self._take(free, [other for other, _ in others], y)

    def feed(self, free: FloatArray, u: FloatArray, y: FloatArray) -> FloatArray:
        """(n, n_y) the free run, and beside it what is known before each of the samples."""
        return self._take(free, [run(u) for run in self._runs], y)

    def _take(self, free: FloatArray, others: list[FloatArray], y: FloatArray) -> FloatArray:
        unit = shapes(self._drifting, self._rows + len(y), self._dt_s)[self._rows :]
        shape = np.stack([other[:, j] for j, other in enumerate(others)], axis=1) + unit - free
        moved = self._moved + np.cumsum(shape * (y - free), axis=0)
        weight = self._weight + np.cumsum(shape**2, axis=0)
        known = np.vstack([self._moved, moved[:-1]]) / np.maximum(
            np.vstack([self._weight, weight[:-1]]), np.finfo(float).tiny
        )
        self._rows += len(y)
        self._moved, self._weight = moved[-1], weight[-1]
        seen = np.all(weight >= self._enough * shape**2, axis=1)
        return np.where(seen[:, None], free + shape * known, np.nan)


class _Foreseen:
    """The next error of a free run, by its autoregression and, where there is one, its moving average."""

    def __init__(self, noise: FloatArray, ma: FloatArray | None, blank: int) -> None:
        n_y = noise.shape[1]
        self._noise = np.ascontiguousarray(noise)
        self._ma = np.ones((1, n_y)) if ma is None else np.ascontiguousarray(ma)
        self._blank = blank  # rows whose innovation is taken as zero
        self._errors = np.zeros((len(noise) - 1, n_y))
        self._innovations = np.zeros((len(self._ma) - 1, n_y))

    def feed(self, errors: FloatArray) -> FloatArray:
        """(n, n_y) foreseen, of the next errors (n, n_y)."""
        foreseen: FloatArray = _foresee(
            errors, self._noise, self._ma, self._errors, self._innovations, self._blank
        )
        self._blank = max(0, self._blank - len(errors))
        return foreseen


@njit(cache=True)
def _foresee(  # type: ignore[no-untyped-def]
    errors, noise, ma, past_errors, past_innovations, blank
):
    """`_Foreseen.feed`; the past (latest first) is written anew."""
    found = np.zeros_like(errors)
    p = len(past_errors)
    q = len(past_innovations)
    for j in range(errors.shape[1]):
        for k in range(len(errors)):
            value = 0.0
            for lag in range(p):
                value -= noise[lag + 1, j] * past_errors[lag, j]
            for lag in range(q):
                value += ma[lag + 1, j] * past_innovations[lag, j]
            found[k, j] = value
            for lag in range(p - 1, 0, -1):
                past_errors[lag, j] = past_errors[lag - 1, j]
            for lag in range(q - 1, 0, -1):
                past_innovations[lag, j] = past_innovations[lag - 1, j]
            if p:
                past_errors[0, j] = errors[k, j]
            if q:
                past_innovations[0, j] = 0.0 if k < blank else errors[k, j] - value
    return found


def _difference(model: FittedLinear, u: FloatArray, y: FloatArray) -> tuple[FloatArray, FreeRun]:
    """The free run of a difference equation."""
    system = model.system
    n = model.n_init
    before = len(system.b) - 1
    du = u - model.u_origin
    first, state = model.begin(du, y[:n] - model.y_origin)
    past = np.zeros((before, du.shape[1]))
    a = np.zeros((system.depth + 1, *system.a.shape[1:]))
    a[: len(system.a)] = system.a

    def run_on(more: FloatArray) -> FloatArray:
        out = _respond(a, system.b, system.c, more, past, state)
        return saturate(out + model.y_origin, model.output_limits)

    def go_on(more: FloatArray) -> FloatArray:
        return run_on(more - model.u_origin)

    free = np.concatenate([y[:n], run_on(du[first:])[n - first :]])
    return free, go_on


@njit(cache=True)
def _respond(a, b, c, u, past, z):  # type: ignore[no-untyped-def]
    """(n, n_y) free run of a difference equation; past inputs (oldest first) and state are written anew."""
    n_y = len(c)
    before = len(past)
    out = np.empty((len(u), n_y))
    for k in range(len(u)):
        for i in range(n_y):
            value = c[i]
            for lag in range(len(b)):
                for j in range(u.shape[1]):
                    value += b[lag, i, j] * (u[k - lag, j] if lag <= k else past[before + k - lag, j])
            out[k, i] = value + z[0, i] if len(z) else value
        for lag in range(1, len(z) + 1):
            for i in range(n_y):
                value = z[lag, i] if lag < len(z) else 0.0
                for j in range(n_y):
                    value -= a[lag, i, j] * out[k, j]
                z[lag - 1, i] = value
    for k in range(before):
        at = len(u) + k - before
        for j in range(u.shape[1]):
            past[k, j] = u[at, j] if at >= 0 else past[k + len(u), j]
    return out


def _states(model: FittedStateSpace, u: FloatArray, y: FloatArray) -> tuple[FloatArray, FreeRun]:
    """The free run of a state-space model."""
    system = model.realisation
    n = model.n_init
    longest = max(model.delays, default=0)
    du = u - model.u_origin
    late = model.late(du)
    start = filtered_states(system, late[:n], y[:n] - model.y_origin, model.gains)[-1]
    state = _next_state(model, free_states(system, late[n:], start)[-1], late[-1])
    past = np.concatenate([np.zeros((longest, du.shape[1])), du])[len(du) :]

    def go_on(more: FloatArray) -> FloatArray:
        nonlocal state, past
        every = np.concatenate([past, more - model.u_origin])
        entered = model.late(every)[longest:]
        past = every[len(every) - longest :]
        states = free_states(system, entered, state)
        state = _next_state(model, states[-1], entered[-1])
        return model.limited(output_of(system, states, entered))

    return model.simulate(u, y[:n]), go_on


def _next_state(model: FittedStateSpace, state: FloatArray, du: FloatArray) -> FloatArray:
    """The state after one more sample."""
    following: FloatArray = free_states(model.realisation, np.stack([du, du]), state)[1]
    return following


def _rules(model: RuleModel, u: FloatArray, y: FloatArray, measured: int) -> tuple[FloatArray, FreeRun]:
    """The free run of rules."""
    layout = model.layout
    depth = layout.depth
    given = y[:measured]
    if not isinstance(model.start, LikelyStart):
        given = estimate_start(model, u[:measured], given)
    run = model.run(u, given)
    tail = run[-depth:] if depth else run[:0]

    def go_on(more: FloatArray) -> FloatArray:
        nonlocal tail
        W = np.concatenate([tail, layout.stack(more, np.empty((0, layout.n_y)))])
        free_run(W, depth, layout.lags, model.free)
        tail = W[len(W) - depth :]
        simulated: FloatArray = model.outputs_of(W[depth:])
        return simulated

    return model.outputs_of(run), go_on
