"""A constant of every flight: mean wind, trim, the bias of a sensor.

Flights of one vehicle differ by constants that no input explains. Fitted as one plant they look like
dynamics: a pole of minutes, or a spurious integrator that carries the constant in the state. Here every
segment has a constant of its own at the input of a linear transfer, A(q) y = B(q) u + c, and both are found
together: the constant and the state at the start are linear unknowns, projected out of the simulation error
(variable projection; Golub & Pereyra, 1973, SIAM J. Numer. Anal. 10), so that only poles and gains are
searched for. An output that settles is off by a constant; one that integrates drifts.

Whether flights differ at all is asked of pieces of flights by an analysis of covariance: a constant of the
flight makes pieces of one flight agree and pieces of two flights differ, while a plant that is not linear,
slow noise or a gust makes pieces of the same flight differ as much, or as the inputs of these pieces do.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ParamSpec, TypeVar

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import FitError, UsageError
from flysid.filters import apply_filter
from flysid.model.linear.data import SEARCH_ROWS, Parts, Scaling, records
from flysid.model.own_constants import FlightOffsets, OwnConstants, shapes
from flysid.model.polynomials import ROUNDING
from flysid.model.selection import STRONG
from flysid.model.shared import digest, once
from flysid.model.simulation_error import (
    OutputError,
    OutputOrders,
    Transfer,
    find_start,
    free_space,
    to_transfer,
)
from flysid.showing import significant

PIECES = 4
"""Of a flight: how far they scatter says what a constant of the flight has to exceed."""
CHANCE = 1e-4
"""Of calling flights different that are not, at most, for one output."""
DEGREE = 3
"""Of the polynomial in the push: a plant's static curve that bends, and bends back."""
ORDERS = (1, 2, 3)
"""Of the transfer beside which the constants are looked for."""
_within: ContextVar[bool] = ContextVar("flight_offsets_are_known", default=False)


P = ParamSpec("P")
M = TypeVar("M")


@dataclass(frozen=True, eq=False)
class Beside:
    """A transfer of one output, in scaled deviations, beside which flights have constants.

    `gain`: of a constant at its input: on the output, or on its change from sample to sample.
    `drifts`: the output integrates.
    """

    transfer: Transfer
    gain: float
    drifts: bool


@dataclass(frozen=True, eq=False)
class Offsets:
    """What every flight's outputs have beside what the inputs do to them.

    `values`: by flight, (n_y,) in the outputs' units, or per second; 0 where flights do not differ.
    `common`: (n_y,) mean of the flights, which is none of theirs: the model has it.
    `beside`: per output, None where flights do not differ.
    `parts`: the scaling of the training data.
    """

    values: Mapping[str, FloatArray]
    common: FloatArray
    beside: tuple[Beside | None, ...]
    parts: Parts

    @property
    def drifting(self) -> tuple[bool, ...]:
        """Per output, whether it drifts."""
        return tuple(b is not None and b.drifts for b in self.beside)

    @property
    def constants(self) -> OwnConstants:
        """As a fitted model carries them."""
        return OwnConstants({k: tuple(map(float, v)) for k, v in self.values.items()}, self.drifting)

    def taken_out(self, data: Dataset) -> Dataset:
        """The data without them; those of flights that are not known are estimated from the data."""
        all_known = all(s.flight in self.values for s in data.segments)
        estimated = {} if all_known else _values(self.beside, self.parts.scaling, data)
        taken = []
        for name, segment in named_segments(data):
            known = self.values.get(segment.flight)  # a segment without a name is no flight of training
            own = estimated[name] - self.common if known is None else known
            shape = shapes(self.drifting, len(segment), data.dt_s)
            taken.append(replace(segment, y=segment.y - shape * own))
        return data.with_segments(taken)

    def words(self, data: Dataset) -> str:
        """The sentence that a model's notes hold."""
        columns = [
            f"{signal.name} {significant(low)} to {significant(high)} {unit}".rstrip()
            for signal, low, high, unit in self.constants.spans(data.outputs)
        ]
        return (
            f"Each of the {len(self.values)} flights has a constant of its own, as wind, trim or a sensor's "
            f"bias give: {', '.join(columns)}. The model leaves it out, and so do scores of its free run."
        )


def named_segments(data: Dataset, scaling: Scaling | None = None) -> list[tuple[str, Segment]]:
    """Every segment (scaled) with the name of its flight; one without a name is a flight of its own."""
    segments = data.segments if scaling is None else scaling.apply(data).segments
    return [
        (old.flight or f"#{k}", s) for k, (old, s) in enumerate(zip(data.segments, segments, strict=True))
    ]


def with_own_constants(fit: Callable[P, M]) -> Callable[P, M]:
    """`fit(settings, train, validation=None)` on data without the constants of flights, where these differ.

    The model then knows of them. With `flight_offsets=True` they are taken out even where they may be chance,
    with False never. What is fitted within a fit is fitted to data that are without them already.
    """
    given = inspect.signature(fit)

    @functools.wraps(fit)
    def fitted(*args: P.args, **kwargs: P.kwargs) -> M:
        bound = given.bind(*args, **kwargs)
        settings, train, *_ = bound.args
        wish: FlightOffsets = settings.flight_offsets
        if wish not in (True, False, "auto"):
            raise UsageError(f"flight_offsets is {wish!r}", hint="use 'auto', True or False")
        if not isinstance(train, Dataset) or wish is False or _within.get() or not len(train):
            return fit(*args, **kwargs)
        offsets = find_offsets(train, always=wish is True)
        token = _within.set(True)
        try:
            if offsets is None:
                return fit(*args, **kwargs)
            parts = {name: bound.arguments.get(name) for name in ("train", "validation")}
            bound.arguments |= {k: offsets.taken_out(d) for k, d in parts.items() if d is not None}
            model: Any = fit(*bound.args, **bound.kwargs)
        finally:
            _within.reset(token)
        notes = (*model.notes, offsets.words(train))
        noted: M = replace(model, flight_offsets=offsets.constants, notes=notes)
        return noted

    return fitted


@once(lambda train, *, always=False: (digest(train), always))
def find_offsets(train: Dataset, *, always: bool = False) -> Offsets | None:
    """The constants of the flights; None where these do not differ beyond chance, or there is one flight.

    `always`: without asking whether they differ.
    """
    if len({name for name, _ in named_segments(train)}) < 2:
        return None
    parts = Parts.of(train, None)
    beside = tuple(_differing(parts, i, always=always) for i in range(len(train.outputs)))
    if all(found is None for found in beside):
        return None
    values = _values(beside, parts.scaling, train)
    common = np.mean(list(values.values()), axis=0)
    return Offsets({name: value - common for name, value in values.items()}, common, beside, parts)


def _differing(parts: Parts, output: int, *, always: bool) -> Beside | None:
    """The transfer of an output whose flights differ; None where they do not."""
    beside = _transfer(parts, output)
    if beside is None or always:
        return beside
    pieces = pieces_of(beside, named_segments(parts.train, parts.scaling), output)
    return beside if differ(pieces) else None


@dataclass(frozen=True)
class Piece:
    """A piece of a flight: its constant at the input, the inputs' mean push there, and the output's mean."""

    flight: str
    constant: float
    push: float
    level: float


def differ(pieces: Sequence[Piece]) -> bool:
    """Flights differ by more than pieces of one do, and by more than where they were flown explains.

    An analysis of covariance (Fisher, 1932): beyond `CHANCE` flights differ beside a polynomial in the push
    of the inputs, or beside one in the level of the output, and it leaves most of what differs between them.
    A plant that is not linear gives flights at different speeds different constants, too, but as a function
    of both: wind leaves the push as it is, and a controller that holds against it the level.
    """

    flights = sorted({piece.flight for piece in pieces})
    degree = min(DEGREE, (len(pieces) - len(flights)) // 2)
    if len(flights) < 2 or degree < 1:
        return False
    constant = np.array([piece.constant for piece in pieces])
    own = np.array([[piece.flight == flight for flight in flights] for piece in pieces], dtype=float)
    places = np.array([[piece.push, piece.level] for piece in pieces]).T
    between = _left(np.ones((len(pieces), 1)), constant) - _left(own, constant)
    return any(_beyond(own, _curve(place, degree), constant, between) for place in places)


def _curve(place: FloatArray, degree: int) -> FloatArray:
    """(N, degree + 1) powers of a place in standard deviations, the constant last."""
    spread = float(place.std())
    return np.vander((place - place.mean()) / spread if spread > 0.0 else 0.0 * place, degree + 1)


def _beyond(own: FloatArray, curve: FloatArray, constant: FloatArray, between: float) -> bool:
    """Flights differ beside a curve, which leaves most of what is between them."""
    from scipy.special import fdtrc

    along = _left(curve, constant)
    both = _left(np.hstack([own, curve[:, :-1]]), constant)
    if along - both <= between / 2.0:
        return False
    if both <= ROUNDING * between:
        return True
    free = (own.shape[1] - 1, len(constant) - own.shape[1] - curve.shape[1] + 1)
    ratio = (along - both) / free[0] / (both / free[1])
    return bool(fdtrc(*free, ratio) < CHANCE)


def _left(columns: FloatArray, values: FloatArray) -> float:
    """Sum of squares that a regression on the columns leaves."""
    miss = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(miss @ miss)


def _transfer(parts: Parts, output: int) -> Beside | None:
    """The simplest transfer of one output, beside constants of the segments, that BIC supports strongly.

    One that integrates could carry the constant of a plant that does not, and bend with a plant that is not
    linear: it has to halve the squares that are left.
    """
    most = max(SEARCH_ROWS // max(len(parts.whole.segments), 1), 1)
    short = parts.whole.with_segments(
        [s.slice(0, min(len(s), most), parts.whole.dt_s) for s in parts.whole.segments]
    )
    n_u = len(parts.train.inputs)
    rows = max(len(short), 2)
    best: dict[bool, tuple[float, Beside]] = {}
    for order in ORDERS:
        orders = OutputOrders(order, (order,) * n_u, (1,) * n_u, offset=False, level=True)
        problem = OutputError(records(short, output), orders)
        if not any(True for _ in problem.usable()):
            break
        try:
            found = problem.refine(find_start(problem).theta, max_iterations=30)
        except FitError:
            continue
        beside = _beside(to_transfer(found.theta, orders), max(len(s) for s in short.segments))
        bic = rows * np.log(max(found.cost, np.finfo(float).tiny)) + np.log(rows) * orders.count
        if beside is None:
            continue
        known = best.get(beside.drifts)
        if known is None or bic < known[0] - STRONG:
            best[beside.drifts] = bic, beside
    settled, drifting = best.get(False), best.get(True)
    if settled is None or (drifting is not None and drifting[0] < settled[0] - rows * np.log(2.0)):
        settled = drifting
    return None if settled is None else settled[1]


def _beside(transfer: Transfer, longest: int) -> Beside | None:
    """What a constant at a transfer's input does; None where it cannot be told from the state at the start.

    It can where every pole dies out within a piece of the longest flight, and where one of them is so slow
    that it integrates over all of it.
    """
    poles = np.roots(transfer.a)
    slow = np.abs(poles) >= np.exp(-PIECES / longest)
    if not slow.any():
        return Beside(transfer, 1.0 / float(transfer.a.sum()), drifts=False)
    pole = poles[slow][0]
    if slow.sum() > 1 or pole.imag != 0.0 or not pole.real >= np.exp(-1.0 / (PIECES * longest)):
        return None
    rest = np.polydiv(transfer.a, [1.0, -pole.real])[0]
    return Beside(transfer, 1.0 / float(rest.sum()), drifts=True)


def pieces_of(beside: Beside, named: Sequence[tuple[str, Segment]], output: int) -> list[Piece]:
    """About `PIECES` of every flight, each beside the state at its segment's start."""
    rows: dict[str, int] = {}
    for name, segment in named:
        rows[name] = rows.get(name, 0) + len(segment)
    found: list[Piece] = []
    for name, segment in named:
        count = max(round(PIECES * len(segment) / rows[name]), 1)
        constants = _constants(beside.transfer, segment, output, count)
        both = np.column_stack([beside.transfer.driven(segment.u), segment.y[:, output]])
        for constant, place in zip(constants, np.array_split(both, max(len(constants), 1)), strict=False):
            found.append(Piece(name, constant, *map(float, place.mean(axis=0))))
    return found


def _values(beside: Sequence[Beside | None], scaling: Scaling, data: Dataset) -> dict[str, FloatArray]:
    """By flight, (n_y,) in the outputs' units, or per second: of its segments by their lengths."""
    named = named_segments(data, scaling)
    found = {name: np.zeros(len(data.outputs)) for name, _ in named}
    for i, own in enumerate(beside):
        if own is None:
            continue
        unit = scaling.y_scale[i] * own.gain / (data.dt_s if own.drifts else 1.0)
        sums: dict[str, FloatArray] = {}
        for name, segment in named:
            for value in _constants(own.transfer, segment, i, 1):
                sums[name] = sums.get(name, np.zeros(2)) + len(segment) * np.array([value, 1.0])
        for name, (total, weight) in sums.items():
            found[name][i] = unit * total / weight
    return found


def _constants(transfer: Transfer, segment: Segment, output: int, pieces: int) -> list[float]:
    """(pieces,) constants at the input over a segment's pieces; () where it is too short for them."""
    first = max(len(b) for b in (*transfer.b, transfer.a)) - 1
    miss = (segment.y[:, output] - transfer.forced(segment.u))[first:]
    free = free_space(transfer.a, len(miss))
    if len(miss) < 2 * (free.shape[1] + pieces):
        return []
    edges = np.linspace(0, len(miss), pieces + 1).astype(int)
    columns = np.zeros((len(miss), pieces + free.shape[1]))
    for k, (low, high) in enumerate(pairwise(edges)):
        driven = np.zeros(len(miss))
        driven[low:high] = 1.0
        columns[:, k] = apply_filter(np.ones(1), transfer.a, driven)
    columns[: len(free), pieces:] = free
    size = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    found = np.linalg.lstsq(columns / size, miss, rcond=None)[0] / size
    return [float(value) for value in found[:pieces]]
