"""Free runs over windows of a flight: all numbers at once, every window from a start of its own.

Where nothing but the instruments is noisy this is the most accurate fit there is, and an error of torque that
regression cannot see shows as metres. Gusts that a controller answers bend it, so `vehicle` keeps it only if
windows that it was not fitted to are predicted better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.sixdof import layout, rotations
from flysid.sixdof.actuators import shares
from flysid.sixdof.descent import Block, Found, descend
from flysid.sixdof.rigid_body import STATES, WIND, run_with_slopes
from flysid.sixdof.thrust_fit import Stretch
from flysid.stretch import FloatArray

OWN = 5
"""Numbers that every flight has of its own: wind east and north, gyro bias about three axes."""
WIND_SD = 3.0
BIAS_SD = 0.05
STEPS = 9000
"""Samples of all windows together: more cost time and tell little."""
SIGNALS = 12
"""Position, velocity, attitude and body rate are compared."""
LEAD_S = 1.0
MOST_TURNS = 8
SETTLED = 1e-3
"""A start is found when another step moves predictions by less than this share of their spreads."""


@dataclass(frozen=True, eq=False)
class Window:
    """A piece of a stretch that is flown freely.

    Attributes
    ----------
    lead : samples before it, for motors to settle.
    measured : (n, 13) position, velocity, attitude and gyro.
    """

    flight: int
    dt_s: float
    commands: FloatArray
    log_voltage: FloatArray
    lead: int
    measured: FloatArray

    def halves(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Thrust shares at half samples, and their derivatives."""
        found, by = shares(self.commands, self.log_voltage, self.dt_s, theta)
        return found[2 * self.lead :], by[:, 2 * self.lead :]


def windows_of(stretches: Sequence[Stretch], length_s: float, most: int = STEPS) -> list[Window]:
    """Windows one after another through all stretches, evenly thinned to `most` samples."""
    found = []
    for stretch in stretches:
        record = stretch.record
        if record.position is None or record.velocity is None or record.attitude is None:
            continue
        length = round(length_s / record.dt_s)
        whole = np.hstack([record.position, record.velocity, record.attitude, record.gyro])
        for first in range(stretch.first, stretch.last - length, length):
            begin = max(first - round(LEAD_S / record.dt_s), 0)
            part = slice(begin, first + length + 1)
            found.append(
                Window(
                    stretch.flight,
                    record.dt_s,
                    record.commands[part],
                    stretch.log_voltage[part],
                    first - begin,
                    whole[first : first + length + 1],
                )
            )
    total = sum(len(window.measured) for window in found)
    if total <= most or not found:
        return found
    chosen = np.linspace(0, len(found) - 1, max(len(found) * most // total, 1))
    return [found[int(i)] for i in np.unique(np.round(chosen))]


def errors(states: FloatArray, measured: FloatArray) -> FloatArray:
    """(n, 12) measured less predicted: m, m/s, rad about body axes, rad/s."""
    turn = rotations.product(rotations.inverse(states[:, 6:10]), measured[:, 6:10])
    return np.hstack(
        [
            measured[:, :6] - states[:, :6],
            rotations.to_vector(turn),
            measured[:, 10:13] - states[:, 10:13],
        ]
    )


def _attitude_by(states: FloatArray, slopes: FloatArray) -> FloatArray:
    """(n, 3, C) derivatives of the predicted attitude as a turn about body axes."""
    w, x, y, z = states[:, 6:10].T
    back = np.stack(
        [np.stack([-x, w, z, -y], -1), np.stack([-y, -z, w, x], -1), np.stack([-z, y, -x, w], -1)], axis=1
    )
    return np.asarray(2.0 * np.einsum("nij,njc->nic", back, slopes[:, 6:10]))


class Shooter:
    """Residuals of windows at any numbers, their starts taken out.

    Attributes
    ----------
    sizes : (12,) spreads of the instruments, which residuals are measured in.
    """

    def __init__(self, windows: Sequence[Window], count: int, stride_s: float = 0.02) -> None:
        self._windows = windows
        self._count = count
        self._stride = max(round(stride_s / windows[0].dt_s), 1)
        self._starts = [window.measured[0].copy() for window in windows]
        self.sizes = np.repeat([0.01, 0.02, 0.01, 0.05], 3)

    def blocks_at(self, theta: FloatArray) -> list[Block]:
        """One block a window; its start is found and projected out. A run that diverges leaves infinity."""
        return [self._block(i, theta) for i in range(len(self._windows))]

    def left_at(self, theta: FloatArray) -> FloatArray:
        """(12,) spread of what is left of every signal."""
        rows = []
        for i in range(len(self._windows)):
            residuals, _, _ = self._linear(i, theta)
            rows.append(residuals)
        return np.asarray(np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0)))

    def _block(self, i: int, theta: FloatArray) -> Block:
        for _ in range(MOST_TURNS):
            residuals, by_theta, by_start = self._linear(i, theta)
            if not (np.isfinite(residuals).all() and np.isfinite(by_start).all()):
                self._starts[i] = self._windows[i].measured[0].copy()
                return np.full(residuals.size, np.inf), np.zeros((residuals.size, len(theta)))
            scaled = (by_start / self.sizes[:, None]).reshape(-1, SIGNALS)
            left = (residuals / self.sizes).ravel()
            step = np.linalg.lstsq(scaled, left, rcond=None)[0]
            self._starts[i] = _moved(self._starts[i], step)
            if float(np.linalg.norm(scaled @ step)) < SETTLED * np.sqrt(len(left)):
                break
        basis, _ = np.linalg.qr(scaled)
        slopes = (by_theta / self.sizes[:, None]).reshape(len(left), -1)
        return left - basis @ (basis.T @ left), slopes - basis @ (basis.T @ slopes)

    def _linear(self, i: int, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(k, 12) errors, and derivatives by all numbers and by the window's start."""
        window = self._windows[i]
        place = self._count + OWN * window.flight
        wind = np.array([theta[place], theta[place + 1], 0.0])
        halves, by = window.halves(theta[: self._count])
        states, slopes = run_with_slopes(
            self._starts[i], _start_by(self._starts[i]), halves, by, window.dt_s, theta[: self._count], wind
        )
        rows = slice(None, None, self._stride)
        states, slopes = states[rows], slopes[rows]
        left = errors(states, window.measured[rows])
        left[:, 9:12] -= theta[place + 2 : place + 5]
        told = np.concatenate([slopes[:, :6], _attitude_by(states, slopes), slopes[:, 10:13]], axis=1)
        by_theta = np.zeros((len(left), SIGNALS, len(theta)))
        by_theta[:, :, : self._count] = told[:, :, : self._count]
        by_theta[:, :, place : place + 2] = told[:, :, self._count : self._count + 2]
        for k in range(3):
            by_theta[:, 9 + k, place + 2 + k] = 1.0
        return left, by_theta, told[:, :, self._count + WIND :]


def _start_by(start: FloatArray) -> FloatArray:
    """(13, 12) of a start by position, velocity, a turn about body axes and the rate."""
    w, x, y, z = start[6:10]
    found = np.zeros((STATES, SIGNALS))
    found[:6, :6] = np.eye(6)
    found[6:10, 6:9] = 0.5 * np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])
    found[10:, 9:] = np.eye(3)
    return found


def _moved(start: FloatArray, step: FloatArray) -> FloatArray:
    turned = rotations.product(start[6:10], rotations.from_vector(step[6:9]))
    return np.concatenate([start[:6] + step[:6], rotations.unit(turned), start[10:] + step[9:]])


def fit_windows(
    windows: Sequence[Window], theta: FloatArray, free: Sequence[int], flights: int, calm: bool
) -> tuple[Found, FloatArray]:
    """All `free` numbers and, behind them, `OWN` a flight; and the spreads of what is left."""
    count = len(theta)
    low, high = layout.limits((count - layout.EFFECTS) // 3)
    beyond = np.full(OWN * flights, np.inf)
    limits = np.concatenate([low, -beyond]), np.concatenate([high, beyond])
    start = np.concatenate([theta, np.zeros(OWN * flights)])
    own = range(2, OWN) if calm else range(OWN)
    wanted = [*free, *(count + OWN * flight + i for flight in range(flights) for i in own)]
    prior = np.zeros(len(start))
    prior[count:] = np.tile([WIND_SD**-2] * 2 + [BIAS_SD**-2] * 3, flights)
    shooter = Shooter(windows, count)
    found = descend(shooter.blocks_at, start, wanted, limits, prior, steps=15, enough=1e-4)
    for _ in range(2):
        shooter.sizes = np.maximum(shooter.left_at(found.theta), 1e-9)
        found = descend(shooter.blocks_at, found.theta, wanted, limits, prior, steps=15, enough=1e-6)
    return found, shooter.sizes
