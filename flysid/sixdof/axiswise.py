"""The axis-wise models: each rate by its own axis's command, thrust by the mean command, drag linear.

Axes know nothing of one another. This is what a fit channel by channel predicts of the whole vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.sixdof import layout, rotations
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.horizons import Ahead, Starts
from flysid.sixdof.rigid_body import GRAVITY
from flysid.stretch import FloatArray

PAST_S = 0.1
"""Commands act on a rate for so long, as a finite impulse response."""


@dataclass(frozen=True, eq=False)
class AxisWise:
    """One linear model an axis.

    Attributes
    ----------
    mix : (3, motors) signs of motors about each axis.
    turn : (3, 2 + taps) of the rate a sample later: constant, rate, commands.
    push : (3, 3) of the body's specific force: constant, air speed, mean command.
    """

    mix: FloatArray
    taps: int
    turn: FloatArray
    push: FloatArray

    def predict(self, starts: Starts) -> Ahead:
        """All steps."""
        at = starts.at
        dt = starts.dt_s
        commands = starts.record.commands
        mixed = commands @ self.mix.T
        mean = commands.mean(axis=1)
        rate = starts.record.gyro[at]
        attitude = starts.attitude[at]
        position = starts.position[at]
        velocity = starts.velocity[at]
        rows: list[tuple[FloatArray, ...]] = []
        for step in range(starts.steps):
            now = at + step
            late = np.stack([mixed[now - lag] for lag in range(self.taps)], axis=2)
            after = self.turn[:, 0] + self.turn[:, 1] * rate + np.einsum("sat,at->sa", late, self.turn[:, 2:])
            air = rotations.to_body(attitude, velocity)
            force = self.push[:, 0] + self.push[:, 1] * air + self.push[:, 2] * mean[now][:, None]
            moved = rotations.to_world(attitude, force) - [0.0, 0.0, GRAVITY]
            attitude = rotations.product(attitude, rotations.from_vector(0.5 * dt * (rate + after)))
            position = position + dt * velocity + 0.5 * dt * dt * moved
            velocity = velocity + dt * moved
            rate = after
            rows.append((position, velocity, attitude, rate))
        return Ahead(*(np.array(part) for part in zip(*rows, strict=True)))


def fit_axis_wise(flights: Sequence[Starts], vehicle: FittedVehicle) -> AxisWise:
    """Least squares, a sample ahead; the vehicle says which motors turn which way."""
    mix = np.sign(layout.effects(vehicle.theta)) / vehicle.motors
    taps = max(round(PAST_S / flights[0].dt_s), 1)
    turns: list[list[FloatArray]] = [[], [], []]
    pushes: list[list[FloatArray]] = [[], [], []]
    for starts in flights:
        record = starts.record
        now = np.flatnonzero(record.flying[:-1] & record.flying[1:])
        now = now[now >= taps]
        mixed = record.commands @ mix.T
        air = rotations.to_body(starts.attitude[now], starts.velocity[now])
        seen = (starts.velocity[now + 1] - starts.velocity[now]) / starts.dt_s + [0.0, 0.0, GRAVITY]
        force = rotations.to_body(starts.attitude[now], seen)
        one = np.ones(len(now))
        mean = record.commands[now].mean(axis=1)
        for k in range(3):
            late = [mixed[now - lag, k] for lag in range(taps)]
            turns[k].append(np.column_stack([one, record.gyro[now, k], *late, record.gyro[now + 1, k]]))
            pushes[k].append(np.column_stack([one, air[:, k], mean, force[:, k]]))
    return AxisWise(mix, taps, *(np.array([_solve(rows) for rows in both]) for both in (turns, pushes)))


def _solve(parts: Sequence[FloatArray]) -> FloatArray:
    """Least squares of the last column on the others."""
    rows = np.concatenate(parts)
    return np.asarray(np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0])
