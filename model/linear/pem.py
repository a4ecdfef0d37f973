"""Prediction-error fit of one output with a noise model: ARMAX and Box-Jenkins (Ljung, 1999, 4.2, 7.2, 10.2).

ARMAX:        A y = sum_j B_j u_j + c + C e
Box-Jenkins:  y = sum_j B_j / A u_j + c / A + C / D e

Parameters: [alpha, beta_1.., c] in difference coordinates as in `simulation_error`, then c1.. and d1.. as
they are. Unknown states at a segment's start are nuisance, as there: residual and Jacobian are projected
onto the complement of the free responses. Starts: the output-error (or least-squares) fit for the dynamics,
and for the noise a long autoregression with its innovations as regressors (Hannan & Rissanen, 1982,
Biometrika 69). Search: Levenberg-Marquardt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flysid.dataset import FloatArray
from flysid.filters import ONE, apply_filter
from flysid.model.compiled_filters import differences, is_stable
from flysid.model.noise import burg
from flysid.model.polynomials import stabilise
from flysid.model.refine import Refinement, levenberg_marquardt
from flysid.model.simulation_error import OutputOrders, Record, Transfer, delayed, free_space, to_transfer

Kind = Literal["armax", "bj"]
LONG_ORDER = 30


@dataclass(frozen=True, eq=False)
class Noise:
    """C and D, monic; D is A itself for ARMAX and then left at one here."""

    c: FloatArray
    d: FloatArray


@dataclass(frozen=True, eq=False)
class PredictionError:
    """The least-squares problem: records, orders of the dynamics, orders of C and D."""

    kind: Kind
    records: tuple[Record, ...]
    orders: OutputOrders
    nc: int
    nd: int

    def start_row(self) -> int:
        """First row of a record whose error counts."""
        return self.orders.depth if self.kind == "armax" else self.orders.input_depth

    def usable(self) -> list[Record]:
        """Records long enough to tell more than their own start."""
        need = self.start_row() + 2 * (self.orders.na + self.nc + self.nd) + 1
        return [r for r in self.records if len(r.y) >= need]

    def parts(self, theta: FloatArray) -> tuple[Transfer, Noise]:
        """The polynomials of a parameter vector."""
        n = self.orders.count
        c = np.concatenate([[1.0], theta[n : n + self.nc]])
        return to_transfer(theta[:n], self.orders), Noise(c, np.concatenate([[1.0], theta[n + self.nc :]]))

    def is_admissible(self, theta: FloatArray) -> bool:
        """C and D, and for Box-Jenkins A, have their roots inside the unit circle."""
        transfer, noise = self.parts(theta)
        checked = [noise.c, noise.d] + ([transfer.a] if self.kind == "bj" else [])
        return all(is_stable(p) for p in checked)

    def cost(self, theta: FloatArray) -> float:
        """Sum of squared one-step prediction errors; inf where the predictor is unstable."""
        if not self.is_admissible(theta):
            return np.inf
        return float(sum(e @ e for e in self.errors(theta)))

    def errors(self, theta: FloatArray) -> list[FloatArray]:
        """One-step prediction errors of every usable record, initial states fitted."""
        transfer, noise = self.parts(theta)
        found = []
        for record in self.usable():
            error, basis, _ = self._unprojected(transfer, noise, record)
            found.append(error - basis @ (basis.T @ error))
        return found

    def residuals_and_jacobian(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(M,) errors and their (M, n) Jacobian."""
        both = [self.record_jacobian(theta, r) for r in self.usable()]
        return np.concatenate([r for r, _ in both]), np.concatenate([j for _, j in both])

    def record_jacobian(self, theta: FloatArray, record: Record) -> tuple[FloatArray, FloatArray]:
        """Errors and Jacobian of one record."""
        transfer, noise = self.parts(theta)
        error, basis, (states, mixing) = self._unprojected(transfer, noise, record)
        weights = basis.T @ error
        rest = error - basis @ weights
        dynamics = self._armax_columns if self.kind == "armax" else self._bj_columns
        jacobian = np.hstack(dynamics(transfer, noise, record, rest, states @ (mixing @ weights)))
        return rest, jacobian - basis @ (basis.T @ jacobian)

    def refine(self, theta: FloatArray) -> Refinement:
        """Levenberg-Marquardt from an admissible start."""
        return levenberg_marquardt(
            self.residuals_and_jacobian,
            theta,
            cost=self.cost,
            max_iterations=60,
        )

    def _unprojected(
        self, transfer: Transfer, noise: Noise, record: Record
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
        """Errors from zero states, an orthonormal basis of what states add, and that basis before D / C.

        The last serves the Jacobian, as two factors: (D / C) of their product is the basis for Box-Jenkins
        states of A, zero for others.
        """
        first = self.start_row()
        if self.kind == "armax":
            equation = apply_filter(transfer.a, ONE, record.y) - transfer.driven(record.u)
            error = apply_filter(ONE, noise.c, equation[first:])
            basis = _pad(free_space(noise.c, len(error)), len(error))
            return error, basis, (np.zeros((len(error), 0)), np.zeros((0, basis.shape[1])))
        miss = (record.y - transfer.forced(record.u))[first:]
        error = apply_filter(noise.d, noise.c, miss)
        states = _pad(free_space(transfer.a, len(miss)), len(miss))
        seen = apply_filter(noise.d, noise.c, states)
        own = _pad(free_space(noise.c, len(miss)), len(miss))
        tail = np.eye(len(miss), self.nd) if self.nc < self.nd else np.zeros((len(miss), 0))
        q, r = np.linalg.qr(np.hstack([seen, own, tail]))
        kept = np.abs(np.diag(r)) > 1e-10 * np.abs(np.diag(r)).max(initial=1e-300)
        mixing = np.linalg.pinv(r, rcond=1e-10)[: states.shape[1], kept]
        return error, q[:, kept], (states, mixing)

    def _armax_columns(
        self, transfer: Transfer, noise: Noise, record: Record, rest: FloatArray, free: FloatArray
    ) -> list[FloatArray]:
        del transfer, free
        orders = self.orders
        first = self.start_row()
        rows = slice(first, len(record.y))
        columns = [_apply_filter(differences(record.y, orders.na, 0, rows, monic=True), noise.c)]
        columns += [-_apply_filter(x, noise.c) for x in _input_columns(record.u, orders, rows)]
        if orders.offset:
            columns.append(-apply_filter(ONE, noise.c, np.ones(len(rest)))[:, None])
        shifted = apply_filter(ONE, noise.c, rest)
        return [*columns, *(-delayed(shifted, i)[:, None] for i in range(1, self.nc + 1))]

    def _bj_columns(
        self, transfer: Transfer, noise: Noise, record: Record, rest: FloatArray, free: FloatArray
    ) -> list[FloatArray]:
        orders = self.orders
        first = self.start_row()
        rows = slice(first, len(record.y))
        response = transfer.forced(record.u)
        response[first:] += free
        response[:first] = 0.0
        inner = apply_filter(ONE, transfer.a, response)
        columns = [_apply_filter(differences(inner, orders.na, 0, rows, monic=True), noise.c, noise.d)]
        through = apply_filter(ONE, transfer.a, record.u)
        columns += [-_apply_filter(x, noise.c, noise.d) for x in _input_columns(through, orders, rows)]
        if orders.offset:
            ramp = apply_filter(ONE, transfer.a, np.ones(len(record.y)))[first:]
            columns.append(-apply_filter(noise.d, noise.c, ramp)[:, None])
        shifted = apply_filter(ONE, noise.c, rest)
        columns += [-delayed(shifted, i)[:, None] for i in range(1, self.nc + 1)]
        miss = apply_filter(ONE, noise.c, record.y[first:] - response[first:])
        return [*columns, *(delayed(miss, i)[:, None] for i in range(1, self.nd + 1))]


def _apply_filter(columns: FloatArray, c: FloatArray, d: FloatArray | None = None) -> FloatArray:
    return apply_filter(ONE if d is None else d, c, columns)


def _input_columns(u: FloatArray, orders: OutputOrders, rows: slice) -> list[FloatArray]:
    return [
        differences(u[:, j], count, delay, rows, monic=False)
        for j, (count, delay) in enumerate(zip(orders.nb, orders.nk, strict=True))
        if count
    ]


def _pad(space: FloatArray, rows: int) -> FloatArray:
    """A basis that lives on the first rows, as one on all rows."""
    out = np.zeros((rows, space.shape[1]))
    out[: len(space)] = space[:rows]
    return out


def innovations_start(errors: Sequence[FloatArray], nc: int, nd: int) -> tuple[FloatArray, FloatArray]:
    """C and D of D v = C e, by regression on v's past and on the innovations of a long autoregression.

    Returns
    -------
    c (nc + 1,), d (nd + 1,), both monic and stable.
    """
    nothing = np.eye(1, nc + 1)[0], np.eye(1, nd + 1)[0]
    if nc + nd == 0:
        return nothing
    samples = sum(len(e) for e in errors)
    long, _ = burg(errors, min(LONG_ORDER, max(samples // 20, nc + nd + 1)))[-1]
    rows = []
    goals = []
    deepest = max(nc, nd)
    for v in errors:
        if len(v) <= len(long) + deepest:
            continue
        e = apply_filter(long, ONE, v)
        keep = slice(len(long) + deepest, len(v))
        past = [-delayed(v, i)[keep] for i in range(1, nd + 1)]
        past += [delayed(e, i)[keep] for i in range(1, nc + 1)]
        rows.append(np.stack(past, axis=1))
        goals.append((v - e)[keep])
    if not rows:
        return nothing
    theta = np.linalg.lstsq(np.concatenate(rows), np.concatenate(goals), rcond=None)[0]
    c = np.concatenate([[1.0], theta[nd:]])
    d = np.concatenate([[1.0], theta[:nd]])
    return stabilise(c, 0.98), stabilise(d, 0.98)
