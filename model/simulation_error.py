"""Simulation error of a linear transfer from several inputs to one output, with exact sensitivities.

A(q) y(k) = sum_j B_j(q) u_j(k) + c, fitted so that the free run, not the next sample, is right (output error;
Ljung, 1999, System Identification, 4.2 and 10.2).

Nuisance: the state of every segment at its start is unknown. Its response is a combination of na known
signals; residual and Jacobian are projected onto their orthogonal complement, so it is estimated along
without being searched for (variable projection, Kaufman, 1975, BIT 15). So are, on request, an offset and a
drift of every segment's output. Samples whose inputs would reach
back before the segment (max nk + nb - 1) are left out of the cost.

Search: refined instrumental variables (Young & Jakeman, 1979, Int. J. Control 29) from state-variable
filters of several bandwidths, then Levenberg-Marquardt; all in difference coordinates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import blake2b

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.filters import ONE, apply_filter
from flysid.model.compiled_filters import differences, free_responses, is_stable, lengths
from flysid.model.polynomials import free_basis, monic_basis, stabilise
from flysid.model.refine import Refinement, levenberg_marquardt


@dataclass(frozen=True, eq=False)
class Record:
    """One segment of one output, as deviations: u (N, n_u), y (N,)."""

    u: FloatArray
    y: FloatArray
    _last: dict[tuple[float | bytes, ...], FloatArray] = field(default_factory=dict, init=False, repr=False)

    def forced(self, transfer: Transfer) -> FloatArray:
        """(N,) `Transfer.forced` along it; the last is kept, as instruments and derivatives follow a cost."""
        key = transfer.key
        if key not in self._last:
            self._last.clear()
            self._last[key] = transfer.forced(self.u)
        return self._last[key]


@dataclass(frozen=True)
class OutputOrders:
    """Orders of one output: na, and per input nb coefficients from lag nk on.

    `drift`: every segment has an offset and a drift of its own, instead of one offset for all; `level`: a
    constant of its own at the input.
    """

    na: int
    nb: tuple[int, ...]
    nk: tuple[int, ...]
    offset: bool = True
    drift: bool = False
    level: bool = False

    @property
    def own_lines(self) -> int:
        """How many columns every segment has of its own: none, a constant's, a constant's and a drift's."""
        return 2 if self.drift else int(self.level)

    @property
    def depth(self) -> int:
        """Deepest lag."""
        return max(self.na, self.input_depth)

    @property
    def input_depth(self) -> int:
        """Deepest lag of an input."""
        return max((k + n - 1 for n, k in zip(self.nb, self.nk, strict=True) if n), default=0)

    @property
    def count(self) -> int:
        """Number of parameters."""
        return self.na + sum(self.nb) + self.offset


@dataclass(frozen=True)
class Transfer:
    """A(q) y = sum_j B_j(q) u_j + c: a (na + 1,) monic; b one (nk + nb,) per input, zeros up to nk."""

    a: FloatArray
    b: tuple[FloatArray, ...]
    c: float

    @property
    def key(self) -> tuple[float | bytes, ...]:
        """What tells it from any other."""
        return self.a.tobytes(), *(b.tobytes() for b in self.b), self.c

    def forced(self, u: FloatArray) -> FloatArray:
        """(N,) response from zero state to inputs that were zero before."""
        return apply_filter(ONE, self.a, self.driven(u))

    def driven(self, u: FloatArray) -> FloatArray:
        """(N,) what the inputs and the constant put in."""
        drive = np.full(len(u), self.c)
        for j, b in enumerate(self.b):
            if len(b):
                drive += apply_filter(b, ONE, u[:, j])
        return drive

    @property
    def is_stable(self) -> bool:
        """Every pole lies inside the unit circle."""
        return is_stable(self.a)


def to_transfer(theta: FloatArray, orders: OutputOrders) -> Transfer:
    """Coefficients from difference coordinates [alpha, beta_1.., c]."""
    base, matrix = monic_basis(orders.na)
    a = np.concatenate([[1.0], base + matrix @ theta[: orders.na]])
    b = []
    position = orders.na
    for count, delay in zip(orders.nb, orders.nk, strict=True):
        values = free_basis(count) @ theta[position : position + count]
        b.append(np.concatenate([np.zeros(delay), values]) if count else np.zeros(0))
        position += count
    return Transfer(a, tuple(b), float(theta[position]) if orders.offset else 0.0)


def from_transfer(transfer: Transfer, orders: OutputOrders) -> FloatArray:
    """Difference coordinates of a transfer of these orders."""
    base, matrix = monic_basis(orders.na)
    parts = [np.linalg.solve(matrix, transfer.a[1:] - base)]
    for b, count, delay in zip(transfer.b, orders.nb, orders.nk, strict=True):
        parts.append(np.linalg.solve(free_basis(count), b[delay:]))
    if orders.offset:
        parts.append(np.array([transfer.c]))
    return np.concatenate(parts)


def delayed(signal: FloatArray, lag: int) -> FloatArray:
    """(N,) the signal `lag` samples later, zero before."""
    if lag == 0:
        return signal
    return np.concatenate([np.zeros(min(lag, len(signal))), signal[: max(len(signal) - lag, 0)]])


def free_space(a: FloatArray, rows: int) -> FloatArray:
    """(M, na) orthonormal basis of all responses of 1/A to a state at the start; M <= rows: then decayed."""
    return _free_space(a.tobytes(), rows)


@lru_cache(maxsize=4)  # a cost, then the derivatives at the same place, over records of the same length
def _free_space(denominator: bytes, rows: int) -> FloatArray:
    a = np.frombuffer(denominator).copy()
    if len(a) == 1:
        return np.zeros((0, 0))
    basis = free_responses(a, rows)
    q = np.linalg.qr(basis)[0] if np.isfinite(basis).all() else np.full(basis.shape, np.nan)
    q.flags.writeable = False
    return q


def without(space: FloatArray, columns: FloatArray) -> FloatArray:
    """The columns minus their projection on `space`, which lives on the first rows."""
    out = columns.copy()
    _take_out(space, columns, out)
    return out


def _take_out(space: FloatArray, columns: FloatArray, out: FloatArray) -> None:
    """Their projection on `space` out of a copy of the columns, or of themselves."""
    rows = len(space)
    out[:rows] -= space @ (space.T @ columns[:rows])


@dataclass(frozen=True)
class OutputError:
    """The least-squares problem: records and orders."""

    records: tuple[Record, ...]
    orders: OutputOrders

    @property
    def key(self) -> tuple[OutputOrders, bytes]:
        """What tells it from any other."""
        found = blake2b(digest_size=16)
        for record in self.records:
            found.update(repr(record.u.shape).encode())
            found.update(np.ascontiguousarray(record.u).data)
            found.update(np.ascontiguousarray(record.y).data)
        return self.orders, found.digest()

    def start_row(self) -> int:
        """First row of a record whose error counts."""
        return self.orders.input_depth

    def usable(self) -> Iterator[Record]:
        """Records long enough to tell more than their own start."""
        need = self.start_row() + 2 * self.orders.na + 1
        return (r for r in self.records if len(r.y) >= need)

    def thinned(self, rows: int, *, pieces: int = 4, least: float = 4.0) -> OutputError:
        """The same problem on about so many rows from all over the records.

        `pieces`: about so many in all, shared out by length, and at least one of every record.
        `least`: the problem stays as it is where it has no more than so many times the rows.
        """
        known = list(self.usable())
        total = sum(len(r.y) for r in known)
        if total <= least * rows:
            return self
        found: list[Record] = []
        for record in known:
            width = len(record.y) // max(1, round(pieces * len(record.y) / total))
            size = width * rows // total
            begins = range((width - size) // 2, len(record.y) - size, width)
            found += (Record(record.u[b : b + size], record.y[b : b + size]) for b in begins)
        thin = replace(self, records=tuple(found))
        return thin if len(list(thin.usable())) == len(found) else self

    def errors(self, theta: FloatArray) -> list[FloatArray]:
        """Simulation errors of every usable record, initial states fitted."""
        transfer = to_transfer(theta, self.orders)
        first = self.start_row()
        parts = []
        for record in self.usable():
            error = (record.forced(transfer) - record.y)[first:]
            parts.append(without(self._nuisance(transfer.a, len(error)), error))
        return parts

    def _nuisance(self, a: FloatArray, rows: int) -> FloatArray:
        """Orthonormal basis of what every record may hold besides the forced response."""
        space = free_space(a, rows)
        count = self.orders.own_lines
        if not count:
            return space
        both = np.zeros((rows, space.shape[1] + count))
        both[: len(space), count:] = space
        both[:, :count] = self._own_columns(a, rows)
        if not np.isfinite(both).all():
            return np.full_like(both, np.nan)
        q, r = np.linalg.qr(both)
        kept: FloatArray = q[:, np.abs(np.diag(r)) > 1e-9]
        return kept

    def _own_columns(self, a: FloatArray, rows: int) -> FloatArray:
        """(rows, count) of length one: a constant and a line, or what a constant at the input does."""
        if self.orders.drift:
            return lines(rows)
        driven = apply_filter(ONE, a, np.ones(rows))
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray((driven / np.linalg.norm(driven))[:, None])

    def _drift(self, a: FloatArray, error: FloatArray) -> FloatArray:
        """The lines' part of what is projected out of an error."""
        space = free_space(a, len(error))
        own = self._own_columns(a, len(error))
        weights = np.linalg.lstsq(without(space, own), error, rcond=1e-9)[0]
        found: FloatArray = own @ weights
        return found

    def cost(self, theta: FloatArray) -> float:
        """Sum of squared simulation errors; inf for an unstable model."""
        if not to_transfer(theta, self.orders).is_stable:
            return np.inf
        return float(sum(e @ e for e in self.errors(theta)))

    def residuals_and_jacobian(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(M,) errors and their (M, count) Jacobian in difference coordinates."""
        transfer = to_transfer(theta, self.orders)
        parts = [self._record_jacobian(transfer, record) for record in self.usable()]
        residual, jacobian = parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
        return residual, jacobian

    def jacobians(self, theta: FloatArray) -> list[FloatArray]:
        """Jacobian of every usable record."""
        transfer = to_transfer(theta, self.orders)
        return [np.ascontiguousarray(self._record_jacobian(transfer, r)[1]) for r in self.usable()]

    def _record_jacobian(self, transfer: Transfer, record: Record) -> tuple[FloatArray, FloatArray]:
        orders = self.orders
        first = self.start_row()
        forced = record.forced(transfer)
        error = (forced - record.y)[first:]
        space = self._nuisance(transfer.a, len(error))
        residual = without(space, error)
        # the free run from the best state: what the residual is measured against
        response = np.zeros_like(forced)
        response[first:] = residual + record.y[first:]
        if orders.own_lines:  # they are none of the model's doing
            response[first:] += self._drift(transfer.a, error)
        rows = slice(first, len(forced))
        through = apply_filter(ONE, transfer.a, response)
        past = -differences(through, orders.na, 0, rows, monic=True)
        jacobian = np.hstack([past, *self._driven_columns(record.u, transfer.a, rows)])
        _take_out(space, jacobian, jacobian)
        return residual, jacobian

    def refine(self, theta: FloatArray, *, max_iterations: int) -> Refinement:
        """Levenberg-Marquardt from a stable start."""
        return levenberg_marquardt(
            self.residuals_and_jacobian,
            theta,
            cost=self.cost,
            max_iterations=max_iterations,
            tolerance=1e-6,
        )

    # -- starts ------------------------------------------------------------------------------------------

    def filtered_least_squares(self, a_filter: FloatArray, model: Transfer | None) -> FloatArray:
        """A y = B u + c on signals filtered with 1/a_filter; with a model, its free run is the instrument."""
        parts = [self._filtered_rows(record, a_filter, model) for record in self.usable()]
        phi, z, goal = parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
        return _instrumental(phi, phi if model is None else z, goal)

    def _filtered_rows(
        self, record: Record, a_filter: FloatArray, model: Transfer | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Regressors, instruments and target; without a model the regressors are their own instruments."""
        orders = self.orders
        rows = slice(orders.depth, len(record.y))
        target = apply_filter(ONE, a_filter, record.y)
        driven = self._driven_columns(record.u, a_filter, rows)
        phi = np.hstack([-differences(target, orders.na, 0, rows, monic=True), *driven])
        for _ in range(orders.na):
            target = np.diff(target, prepend=0.0)
        space = self._nuisance(a_filter, len(phi))
        known = without(space, phi)
        goal = without(space, target[rows])
        if model is None:
            return known, known, goal
        run = apply_filter(ONE, a_filter, record.forced(model))
        z = np.hstack([-differences(run, orders.na, 0, rows, monic=True), *driven])
        return known, without(space, z), goal

    def _driven_columns(self, u: FloatArray, a: FloatArray, rows: slice) -> list[FloatArray]:
        """What B and the constant multiply: differences of the inputs behind 1/A, and its step response."""
        orders = self.orders
        columns = [
            differences(apply_filter(ONE, a, u[:, j]), count, delay, rows, monic=False)
            for j, (count, delay) in enumerate(zip(orders.nb, orders.nk, strict=True))
            if count
        ]
        if orders.offset:
            columns.append(apply_filter(ONE, a, np.ones(len(u)))[rows, None])
        return columns


def lines(rows: int) -> FloatArray:
    """(rows, 2) orthonormal: a constant and a line."""
    t = np.arange(rows) - (rows - 1) / 2.0
    both = np.stack([np.ones(rows), t], axis=1)
    size = np.linalg.norm(both, axis=0)
    found: FloatArray = both / np.where(size > 0.0, size, 1.0)
    return found


def _instrumental(phi: FloatArray, z: FloatArray, y: FloatArray) -> FloatArray:
    """Solve Zᵀ Phi theta = Zᵀ y with columns scaled to length one."""
    scale = lengths(phi)
    zs = z / (scale if z is phi else lengths(z))
    return np.linalg.lstsq(zs.T @ (phi / scale), zs.T @ y, rcond=1e-14)[0] / scale


def filter_polynomial(n: int, pole: float) -> FloatArray:
    """(1 - pole q⁻¹)ⁿ."""
    return np.asarray(np.poly(np.full(n, pole))) if n else np.ones(1)


BANDWIDTHS = (0.005, 0.05, 0.5)
"""Of the first state-variable filter, omega dt in radians."""


@dataclass(frozen=True)
class Start:
    """A point from which to refine: difference coordinates and their cost."""

    theta: FloatArray
    cost: float


def find_start(problem: OutputError, *, tries: int = 2, polish: int = 3) -> Start:
    """The start of lowest simulation error: refined instrumental variables from several bandwidths.

    Every bandwidth gets `tries` iterations, the best of them `polish` more. Raises FitError: every attempt
    diverges.
    """
    attempts = []
    for bandwidth in BANDWIDTHS:
        a_filter = filter_polynomial(problem.orders.na, float(np.exp(-bandwidth)))
        attempts.append(_instrumental_search(problem, a_filter, None, tries))
    attempts.sort(key=lambda s: s.cost)
    best = attempts[0]
    if np.isfinite(best.cost) and polish:
        model = to_transfer(best.theta, problem.orders)
        best = min(best, _instrumental_search(problem, model.a, model, polish), key=lambda s: s.cost)
    if not np.isfinite(best.cost):
        raise FitError("no stable start was found for the simulation-error fit", hint="give other orders")
    return best


def _lower(best: Start, problem: OutputError, theta: FloatArray) -> Start:
    cost = problem.cost(theta) if np.isfinite(theta).all() else np.inf
    return Start(theta, cost) if cost < best.cost else best


def _instrumental_search(
    problem: OutputError, a_filter: FloatArray, model: Transfer | None, iterations: int
) -> Start:
    best = Start(np.zeros(problem.orders.count), np.inf)
    for _ in range(iterations):
        theta = problem.filtered_least_squares(a_filter, model)
        if not np.isfinite(theta).all():
            break
        model = to_transfer(theta, problem.orders)
        if not is_stable(model.a, 0.99999):
            model = replace(model, a=stabilise(model.a, 0.99999))
            theta = from_transfer(model, problem.orders)
        best = _lower(best, problem, theta)
        a_filter = model.a
    return best
