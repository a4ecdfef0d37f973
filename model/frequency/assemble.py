"""Refined transfer functions in s into one linear model: sampling, noise, start, covariance, units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.model.freerun import Difference
from flysid.model.frequency.continuous_error import STEP, ContinuousError
from flysid.model.frequency.continuous_transfer import ContinuousTransfer
from flysid.model.frequency.rational import is_determined
from flysid.model.frequency.sampling import sample
from flysid.model.linear.data import Parts, records
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.free_runner import free_runner
from flysid.model.linear.initial_state import start_gains
from flysid.model.noise import coloured_covariance, noise_model


@dataclass(frozen=True, eq=False)
class OneTransfer:
    """The transfer functions of one output in scaled deviations.

    `covariance`: of theta where it does not come from the simulation error (fits to the frequency response
        alone), else None.
    """

    problem: ContinuousError
    theta: FloatArray
    covariance: FloatArray | None = None

    @property
    def poles(self) -> int:
        """Number of poles."""
        return self.problem.coordinates.form.poles

    @property
    def count(self) -> int:
        """Number of estimated parameters."""
        return self.problem.count

    @property
    def depth(self) -> int:
        """Deepest lag once sampled."""
        a, b = self.polynomials(self.theta)
        return max(len(a), *(len(x) for x in b)) - 1

    def polynomials(self, theta: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """a and b of the sampled transfer functions."""
        return sample(self.problem.rational(theta), self.problem.dt_s, self.problem.hold)

    def is_determined(self, lowest: float) -> bool:
        """The data determine every pole; see `rational.is_determined`."""
        covariance = self.theta_covariance()
        n = self.poles
        units = self.problem.coordinates.units
        physical = (covariance[:n, :n] * np.outer(units[:n], units[:n]))[::-1, ::-1]
        seen = lowest, np.pi / self.problem.dt_s
        return is_determined(self.problem.rational(self.theta), physical, seen)

    def theta_covariance(self) -> FloatArray:
        """Of theta, from the simulation error and its colour unless it came with the fit."""
        if self.covariance is not None:
            return self.covariance
        errors = self.problem.errors(self.theta)
        d, variance = noise_model(errors) if errors else (np.ones(1), 1.0)
        return coloured_covariance(self.problem.jacobians(self.theta), d, variance)

    @property
    def offset(self) -> float:
        """Of the output."""
        return float(self.theta[-1]) if self.problem.has_offset else 0.0

    def refit(self, parts: Parts, *, refine: bool) -> OneTransfer:
        """Refined on all training data from here."""
        problem = replace(self.problem, records=records(parts.whole, 0))
        if not refine or self.covariance is not None:
            return replace(self, problem=problem)
        try:
            return OneTransfer(problem, problem.refine(self.theta).theta)
        except FitError:
            return replace(self, problem=problem)


def runner(parts: Parts, fits: Sequence[OneTransfer], n_init: int | None) -> FittedLinear:
    """A model good for free runs only: its noise is white, its covariance unknown."""
    system = _system(fits, len(parts.train.inputs))
    starts = start_gains(system, parts, n_init) if _stable(system) else None
    return free_runner("tf", parts, system, starts, _free(fits, system))


def assemble(
    parts: Parts, fits: Sequence[OneTransfer], n_init: int | None
) -> tuple[FittedLinear, tuple[ContinuousTransfer, ...]]:
    """The model with noise and covariance, and its transfer functions, outputs outermost."""
    model = runner(parts, fits, n_init)
    noises = []
    blocks = []
    transfers = []
    for i, fit in enumerate(fits):
        errors = fit.problem.errors(fit.theta)
        noises.append(noise_model(errors)[0] if errors else np.ones(1))
        theta_covariance = fit.theta_covariance()
        blocks.append(_sampled_covariance(parts, fit, i, theta_covariance))
        transfers += [_transfer(parts, fit, (i, j), theta_covariance) for j in range(len(parts.train.inputs))]
    noise = np.zeros((max(len(d) for d in noises), len(noises)))
    for i, d in enumerate(noises):
        noise[: len(d), i] = d
    covariance = np.zeros((len(model.free),) * 2)
    at = 0
    for block in blocks:
        covariance[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return replace(model, noise=noise, covariance=covariance), tuple(transfers)


def _stable(system: Difference) -> bool:
    radii = [np.abs(np.roots(system.a[:, i, i])).max(initial=0.0) for i in range(len(system.c))]
    return bool(max(radii) < 1.0)


def _system(fits: Sequence[OneTransfer], n_u: int) -> Difference:
    """All outputs' difference equation in scaled deviations; the offset of an output enters as A(1) c."""
    sampled_all = [f.polynomials(f.theta) for f in fits]
    n_y = len(fits)
    a = np.zeros((max(len(x) for x, _ in sampled_all), n_y, n_y))
    b = np.zeros((max(len(t) for _, taps in sampled_all for t in taps), n_y, n_u))
    c = np.zeros(n_y)
    for i, (own, taps) in enumerate(sampled_all):
        a[: len(own), i, i] = own
        c[i] = own.sum() * fits[i].offset
        for j, t in enumerate(taps):
            b[: len(t), i, j] = t
    return Difference(a, b, c)


def _places(fit: OneTransfer, i: int, system: Difference) -> list[int]:
    """Where one output's coefficients stand in the flat order: a, every input's taps, c."""
    n_y, n_u = system.b.shape[1:]
    a_size = system.a[1:].size
    own, taps = fit.polynomials(fit.theta)
    places = [lag * n_y * n_y + i * n_y + i for lag in range(len(own) - 1)]
    for j, t in enumerate(taps):
        places += [a_size + int(lag) * n_y * n_u + i * n_u + j for lag in np.flatnonzero(t)]
    if fit.problem.has_offset:
        places.append(a_size + system.b.size + i)
    return places


def _free(fits: Sequence[OneTransfer], system: Difference) -> tuple[int, ...]:
    return tuple(p for i, f in enumerate(fits) for p in _places(f, i, system))


def _sampled_covariance(parts: Parts, fit: OneTransfer, i: int, covariance: FloatArray) -> FloatArray:
    """Of one output's sampled coefficients in physical units, from that of theta (delta method)."""
    own, taps = fit.polynomials(fit.theta)
    where = [np.flatnonzero(t) for t in taps]

    def coefficients(theta: FloatArray) -> FloatArray:
        a, b = fit.polynomials(theta)
        values = [a[1:]]
        for at, t in zip(where, b, strict=True):
            padded = np.zeros(max(len(t), int(at.max(initial=0)) + 1))
            padded[: len(t)] = t
            values.append(padded[at])
        if fit.problem.has_offset:
            values.append(np.array([a.sum() * theta[-1]]))
        return np.concatenate(values)

    columns = []
    for p in range(fit.count):
        step = STEP * max(abs(float(fit.theta[p])), 1e-3)
        up = fit.theta.copy()
        down = fit.theta.copy()
        up[p] += step
        down[p] -= step
        if (fit.problem.rational(down).dead_time_s < 0.0).any():
            down = fit.theta
        columns.append((coefficients(up) - coefficients(down)) / (up[p] - down[p]))
    slopes = np.stack(columns, axis=1)
    scale = parts.scaling
    factors = [np.ones(len(own) - 1)]
    factors += [np.full(len(at), scale.y_scale[i] / u) for at, u in zip(where, scale.u_scale, strict=True)]
    factors += [np.full(int(fit.problem.has_offset), scale.y_scale[i])]
    unit = np.concatenate(factors)
    return np.asarray((slopes @ covariance @ slopes.T) * np.outer(unit, unit))


def _transfer(
    parts: Parts, fit: OneTransfer, channel: tuple[int, int], covariance: FloatArray
) -> ContinuousTransfer:
    """One input to one output, in physical units."""
    i, j = channel
    coordinates = fit.problem.coordinates
    form = coordinates.form
    rational = fit.problem.rational(fit.theta)
    gain = float(parts.scaling.y_scale[i] / parts.scaling.u_scale[j])
    n = form.poles
    first = form.poles + sum(m + 1 for m in form.zeros[:j])
    top = list(range(first, first + form.zeros[j] + 1))[::-1]
    bottom = list(range(n))[::-1]
    free = [k for k, t in enumerate(form.dead_time_s) if t is None]
    delay = [form.poles + sum(m + 1 for m in form.zeros) + free.index(j)] if j in free else []
    picked = [*top, *bottom, *delay]
    unit = coordinates.units[picked] * np.append(np.full(len(top), gain), np.ones(n + len(delay)))
    size = len(top) + n + 1
    whole = np.zeros((size, size))
    whole[: len(picked), : len(picked)] = covariance[np.ix_(picked, picked)] * np.outer(unit, unit)
    return ContinuousTransfer(
        numerator=rational.numerators[j] * gain,
        denominator=rational.denominator,
        covariance=whole,
        dead_time_s=float(rational.dead_time_s[j]),
        input=parts.train.inputs[j].name,
        output=parts.train.outputs[i].name,
    )
