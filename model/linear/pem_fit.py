"""ARMAX and Box-Jenkins from settings and data: orders, starts, refinement, one model of all outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.filters import apply_filter
from flysid.model.freerun import Difference
from flysid.model.linear.data import Parts, records
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.initial_state import equation_starts
from flysid.model.linear.oe_search import search
from flysid.model.linear.output_error import OneOutput, runner
from flysid.model.linear.pem import Kind, PredictionError, innovations_start
from flysid.model.linear.settings import PolynomialSettings
from flysid.model.linear.stability import keep_stable
from flysid.model.simulation_error import OutputError, OutputOrders, to_transfer

BJ_NOISES = ((0, 0), (0, 1), (0, 2), (1, 1), (2, 2), (0, 4))
ARMAX_NOISES = (1, 2, 3, 4)


@dataclass(frozen=True, eq=False)
class NoisyFit:
    """A prediction-error fit of one output."""

    problem: PredictionError
    theta: FloatArray
    cost: float

    @property
    def rows(self) -> int:
        """Number of errors that count."""
        return sum(len(r.y) - self.problem.start_row() for r in self.problem.usable())

    @property
    def bic(self) -> float:
        """Bayesian information criterion of the one-step errors."""
        floor = max(self.cost, np.finfo(float).tiny)
        return self.rows * float(np.log(floor / self.rows)) + len(self.theta) * float(np.log(self.rows))


def fit_prediction_error(
    kind: Kind,
    settings: PolynomialSettings,
    data: tuple[Dataset, Dataset | None],
    noises: Sequence[tuple[int, int]],
) -> FittedLinear:
    """Dynamics' orders by the simulation error, noise orders by BIC, all parameters by prediction error.

    `data`: training part, and validation part or None.
    `noises`: (nc, nd) to try.
    Raises UsageError: settings that cannot be. Raises DataError: too few samples for these orders.
    Raises FitError: no stable start was found.
    """
    settings.check(data[0])
    train, validation = settings.detrended(*data)
    parts = Parts.of(train, validation, centred=settings.offset)
    found = search(kind, settings, parts)
    fits = []
    for i, start in enumerate(found.fits):
        tried = [_fit(kind, parts, i, start, n) for n in noises]
        fits.append(min(tried, key=lambda f: f.bic))
    names = ", ".join(
        f"{o.name} nc = {f.problem.nc}" + (f", nd = {f.problem.nd}" if kind == "bj" else "")
        for o, f in zip(parts.train.outputs, fits, strict=True)
    )
    how = "of lowest BIC" if len(noises) > 1 else "as given"
    notes = found.note, f"Noise model {how}: {names}."
    model = _assemble(kind, parts, fits, notes, settings.n_init)
    return keep_stable(model, train, stable=settings.stable)


def _fit(kind: Kind, parts: Parts, output: int, start: OneOutput, noise: tuple[int, int]) -> NoisyFit:
    problem = PredictionError(kind, records(parts.whole, output), start.problem.orders, *noise)
    if not problem.usable():
        raise DataError(
            "no segment is long enough for these orders",
            hint="choose smaller orders or delays, or bring longer segments",
        )
    errors = replace(start.problem, records=problem.records).errors(start.theta)
    if kind == "armax":
        errors = [apply_filter(start.transfer.a, np.ones(1), e)[problem.orders.na :] for e in errors]
    c, d = innovations_start(errors, *noise)
    theta = np.concatenate([start.theta, c[1:], d[1:]])
    best = problem.refine(theta)
    if kind == "armax":  # least squares is the better start where the noise enters through 1/A
        other = problem.refine(np.concatenate([_least_squares(problem), np.zeros(noise[0])]))
        best = min(best, other, key=lambda r: r.cost)
    return NoisyFit(problem, best.theta, best.cost)


def _least_squares(problem: PredictionError) -> FloatArray:
    """The ARX estimate in difference coordinates."""
    plain = replace(problem, nc=0)
    zero = np.zeros(problem.orders.count)
    residual, jacobian = plain.residuals_and_jacobian(zero)
    lengths = np.linalg.norm(jacobian, axis=0)
    scale = np.where(lengths > 0, lengths, 1.0)
    return np.asarray(zero - np.linalg.lstsq(jacobian / scale, residual, rcond=1e-14)[0] / scale)


def _assemble(
    kind: Kind, parts: Parts, fits: Sequence[NoisyFit], notes: Sequence[str], n_init: int | None
) -> FittedLinear:
    dynamics = [
        OneOutput(OutputError(f.problem.records, f.problem.orders), f.theta[: f.problem.orders.count], f.cost)
        for f in fits
    ]
    base = runner(kind, parts, dynamics, n_init)
    noises = [f.problem.parts(f.theta)[1] for f in fits]
    system: Difference = base.system
    if kind == "armax":
        starts = equation_starts(_scale(parts, system), parts, base.n_init)
        base = replace(base, starts=starts, n_init=max(base.n_init, system.depth))
    return replace(
        base,
        noise=None if kind == "armax" else _columns([n.d for n in noises]),
        ma=_columns([n.c for n in noises]),
        noise_parameters=sum(f.problem.nc + f.problem.nd for f in fits),
        covariance=_covariance(fits, parts),
        notes=tuple(notes),
    )


def _scale(parts: Parts, system: Difference) -> Difference:
    ratio = parts.scaling.y_scale[:, None] / parts.scaling.y_scale
    gain = parts.scaling.y_scale[:, None] / parts.scaling.u_scale
    return Difference(system.a / ratio, system.b / gain, system.c / parts.scaling.y_scale)


def _columns(polynomials: Sequence[FloatArray]) -> FloatArray:
    out = np.zeros((max(len(p) for p in polynomials), len(polynomials)))
    for i, p in enumerate(polynomials):
        out[: len(p), i] = p
    return out


def _covariance(fits: Sequence[NoisyFit], parts: Parts) -> FloatArray:
    """Of the dynamics' coefficients, in physical units: residual variance times (JᵀJ)⁻¹."""
    blocks = []
    for i, fit in enumerate(fits):
        orders = fit.problem.orders
        _, jacobian = fit.problem.residuals_and_jacobian(fit.theta)
        lengths = np.linalg.norm(jacobian, axis=0)
        scale = np.where(lengths > 0, lengths, 1.0)
        inner = np.linalg.pinv((jacobian / scale).T @ (jacobian / scale), rcond=1e-14) / np.outer(
            scale, scale
        )
        variance = fit.cost / max(fit.rows - len(fit.theta), 1)
        n = orders.count
        outer = _to_coefficients(orders)
        y_scale = float(parts.scaling.y_scale[i])
        factors = [1.0] * orders.na
        for count, source in zip(orders.nb, parts.scaling.u_scale, strict=True):
            factors += [y_scale / float(source)] * count
        factors += [y_scale] * orders.offset
        blocks.append(variance * (outer @ inner[:n, :n] @ outer.T) * np.outer(factors, factors))
    size = sum(len(b) for b in blocks)
    joint = np.zeros((size, size))
    position = 0
    for block in blocks:
        joint[position : position + len(block), position : position + len(block)] = block
        position += len(block)
    return joint


def _to_coefficients(orders: OutputOrders) -> FloatArray:
    """The matrix from difference coordinates to coefficients."""
    zero = np.zeros(orders.count)
    flat = _flat(zero, orders)
    return np.stack([_flat(row, orders) - flat for row in np.eye(orders.count)], axis=1)


def _flat(theta: FloatArray, orders: OutputOrders) -> FloatArray:
    transfer = to_transfer(theta, orders)
    taps = [b[k:] for b, k in zip(transfer.b, orders.nk, strict=True)]
    return np.concatenate([transfer.a[1:], *taps, [transfer.c] if orders.offset else []])
