"""Prediction-error fit of one axis: a grid of lags and delays, then Levenberg-Marquardt; intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.model.noise import coloured_covariance, noise_model
from flysid.model.rotorcraft.rotor_axis import (
    CURVE,
    DAMPING,
    DELAY,
    DRIFT,
    FIRST,
    HOLD,
    LAG,
    TRIM,
    forgets,
    predictions,
    wandering_trim,
)

Record = tuple[FloatArray, FloatArray, FloatArray | None]
"""Commands over their largest (N, n), one output (N,) over its standard deviation, and where it is measured
the logarithm of the voltage over its mean (N,)."""

POWER = (-1.0, 4.0)
"""Of the battery's voltage in what a command does: 0 is governed speed, 1 a share of the voltage."""


@dataclass(frozen=True, eq=False)
class FittedAxis:
    """A fitted axis, in the units of its records.

    `theta`: parameters, see `rotor_axis`.
    `free`: which of them were estimated and stand away from the ends of their range.
    `covariance`: (P, P); 0 for what is not free.
    """

    theta: FloatArray
    free: tuple[int, ...]
    covariance: FloatArray


def fit_axis(records: Sequence[Record], dt: float, integrates: bool, curved: bool) -> FittedAxis:
    """The parameters that predict one step ahead best.

    `integrates`: the output is a rate; otherwise an acceleration.
    `curved`: the thrust curve is sought, too (commands of single motors, which are never negative).
    Raises FitError: no start predicts anything finite.
    """
    count = records[0][0].shape[1] + _sags(records)
    low, high = _range(dt, count, integrates)
    if _sags(records):
        low[-1], high[-1] = POWER
    wanted = [LAG, DELAY, *([CURVE] if curved else []), TRIM, HOLD]
    wanted += [DAMPING, DRIFT] if integrates else []
    wanted += list(range(FIRST, FIRST + count))
    free = np.array(sorted(wanted))
    starts = _starts(records, dt, integrates, curved, free)
    if not starts:
        raise FitError("no start of the physical model is finite", hint="check the units of the signals")
    best = min((_descend(records, s, dt, integrates, free, low, high) for s in starts), key=lambda f: f[0])
    return _judge(records, best[1], dt, integrates, free, low, high)


def _sags(records: Sequence[Record]) -> bool:
    """Whether the voltage is measured."""
    return records[0][2] is not None


def _range(dt: float, count: int, integrates: bool) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest value of every parameter."""
    low = np.full(FIRST + count, -np.inf)
    high = np.full(FIRST + count, np.inf)
    for index, (least, most) in {
        LAG: (0.05 * dt, 2.0),  # faster than rows show; slower than a motor is
        DELAY: (0.0, 0.3),
        CURVE: (-1.0, 2.0),  # a root, a square
        DAMPING: (0.0, 0.5 / dt),
        HOLD: (0.0, 1.5),
        DRIFT: (0.0, 0.9),
    }.items():
        low[index] = least
        high[index] = most
    if not integrates:
        high[HOLD] = 1.0
    return low, high


def _starts(
    records: Sequence[Record], dt: float, integrates: bool, curved: bool, free: FloatArray
) -> list[FloatArray]:
    """The best three of a grid of lags and delays, torques and trim by least squares: y is linear in them."""
    count = records[0][0].shape[1]
    linear = [TRIM, *(int(i) for i in free if FIRST <= i < FIRST + count)]
    found: list[tuple[float, FloatArray]] = []
    for lag, delay in product((0.7 * dt, 0.02, 0.06, 0.15), (0.0, 1.5 * dt, 0.015, 0.05)):
        theta = np.zeros(FIRST + count + _sags(records))
        theta[[LAG, DELAY, CURVE, HOLD]] = lag, delay, 0.5 if curved else 0.0, 0.3
        if integrates:
            theta[[DAMPING, DRIFT]] = 1.0, 0.01
        theta[linear], cost = _least_squares(records, theta, dt, integrates, linear)
        if np.isfinite(cost):
            found.append((cost, theta))
    found.sort(key=lambda pair: pair[0])
    return [theta for _, theta in found[:3]]


def _least_squares(
    records: Sequence[Record], theta: FloatArray, dt: float, integrates: bool, linear: list[int]
) -> tuple[FloatArray, float]:
    parts, slopes = _stack(records, theta, dt, integrates)
    errors = np.concatenate(parts)
    columns = np.concatenate(slopes)[:, linear]
    if not (np.isfinite(errors).all() and np.isfinite(columns).all()):
        return theta[linear], np.inf
    step = np.linalg.lstsq(columns, errors, rcond=1e-12)[0]
    left = errors - columns @ step
    return theta[linear] + step, float(left @ left)


def _stack(
    records: Sequence[Record], theta: FloatArray, dt: float, integrates: bool
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Innovations and derivatives of the predictions, without the rows that start them."""
    errors = []
    slopes = []
    for x, y, volts in records:
        ahead, slope = predictions(x, y, theta, dt, integrates, volts)
        errors.append(y[1:] - ahead[1:])
        slopes.append(slope[1:])
    return errors, slopes


def _descend(
    records: Sequence[Record],
    theta: FloatArray,
    dt: float,
    integrates: bool,
    free: FloatArray,
    low: FloatArray,
    high: FloatArray,
    *,
    steps: int = 60,
    enough: float = 1e-12,
) -> tuple[float, FloatArray]:
    """Levenberg-Marquardt, steps cut at the ends of every range.

    `enough`: share of the sum of squares that a step must win for another one.
    """
    errors, slopes = _stack(records, theta, dt, integrates)
    left = np.concatenate(errors)
    cost = float(left @ left)
    damp = 1e-3
    for _ in range(steps):
        gram, back = _normal(np.concatenate(slopes), left, free, theta, low, high)
        sizes = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
        scaled = gram / np.outer(sizes, sizes)
        better = False
        while damp < 1e8:
            step = np.linalg.solve(scaled + damp * np.eye(len(free)), back / sizes) / sizes
            other = theta.copy()
            other[free] = np.clip(theta[free] + step, low[free], high[free])
            if forgets(other, dt, integrates):
                new_errors, new_slopes = _stack(records, other, dt, integrates)
                new_left = np.concatenate(new_errors)
                new_cost = float(new_left @ new_left)
                if new_cost < cost:
                    better = cost - new_cost > enough * cost
                    theta = other
                    left = new_left
                    slopes = new_slopes
                    cost = new_cost
                    damp = max(damp / 10.0, 1e-12)
                    break
            damp *= 4.0
        if not better:
            break
    return cost, theta


def _normal(
    slopes: FloatArray,
    left: FloatArray,
    free: FloatArray,
    theta: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Normal equations; a parameter at an end that the step would leave stays there."""
    columns = slopes[:, free]
    back = columns.T @ left
    stuck = ((theta[free] <= low[free]) & (back < 0.0)) | ((theta[free] >= high[free]) & (back > 0.0))
    columns = np.where(stuck, 0.0, columns)
    return columns.T @ columns, np.where(stuck, 0.0, back)


def _judge(
    records: Sequence[Record],
    theta: FloatArray,
    dt: float,
    integrates: bool,
    free: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> FittedAxis:
    """The axis with the covariance of what is away from the ends of its range."""
    inside = [int(i) for i in free if low[i] < theta[i] < high[i]]
    errors, slopes = _stack(records, theta, dt, integrates)
    covariance = np.zeros((len(theta), len(theta)))
    own = coloured_covariance([s[:, inside] for s in slopes], *noise_model(errors))
    covariance[np.ix_(inside, inside)] = own
    if TRIM in inside:
        theta, covariance = _settle_trim(records, theta, dt, integrates, covariance)
    return FittedAxis(theta, tuple(inside), covariance)


def _settle_trim(
    records: Sequence[Record], theta: FloatArray, dt: float, integrates: bool, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Parameters and covariance with the mean of the trim as it wanders; unchanged where it does not.

    Its value at the first row is what wind and motors happened to do then. The mean misses the vehicle's own
    by what wanders on average over the flights, and by what the errors of the torques make of it.
    """

    def paths(at: FloatArray) -> list[FloatArray]:
        return [wandering_trim(x, y, at, dt, integrates, volts) for x, y, volts in records]

    def mean(at: FloatArray) -> float:
        return float(np.concatenate(paths(at)).mean())

    wandering = paths(theta)
    rows = sum(map(len, wandering))
    level = mean(theta)
    if not np.ptp(np.concatenate(wandering)) > 0.0:
        return theta, covariance
    d, variance = noise_model([path - level for path in wandering])
    slope = np.zeros(len(theta))
    for i in np.flatnonzero(np.diag(covariance) > 0.0):
        moved = theta.copy()
        moved[i] += np.sqrt(covariance[i, i])
        slope[i] = (mean(moved) - level) / (moved[i] - theta[i])
    slope[[TRIM, HOLD, DRIFT]] = 0.0
    settled, known = theta.copy(), covariance.copy()
    settled[TRIM] = level
    known[TRIM] = known[:, TRIM] = 0.0
    known[TRIM, TRIM] = slope @ covariance @ slope + variance / (d.sum() ** 2 * rows)
    return settled, known
