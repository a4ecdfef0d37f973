"""Predictions straight to one horizon: a ridge on what a start shows, with or without motors and physics.

Nothing of this is a vehicle. It shows what can be predicted without one: by habit alone (no inputs), by the
commands without physics (a black box), and by the vehicle and the habits of its controller together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from flysid.sixdof import rotations
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.horizons import Ahead, Starts, fly_ahead
from flysid.sixdof.in_loop import WEIGHTS, Ridge, fit_ridge
from flysid.stretch import FloatArray

RATES_S = (0.03, 0.1, 0.2)
SPEEDS_S = (0.1, 0.2)
PAST_S = 0.2
PIECES = 4
"""Of commands from a start to its horizon."""
USUAL = (0.01, 0.99)
"""Quantiles of features in training that those of a test are cut to: a free run may diverge."""

Features = Callable[[Starts], FloatArray]


def habits(starts: Starts) -> FloatArray:
    """(S, F) what instruments show at a start and before it, in body axes."""
    at = starts.at
    rate = starts.record.gyro
    air = rotations.to_body(starts.attitude, starts.velocity)
    up = rotations.matrices(starts.attitude[at])[:, 2]
    parts = [rate[at], up, air[at], air[at] ** 2]
    parts += [rate[at] - rate[at - _back(starts, t)] for t in RATES_S]
    parts += [air[at] - air[at - _back(starts, t)] for t in SPEEDS_S]
    return np.hstack(parts)


def with_commands(starts: Starts) -> FloatArray:
    """(S, F) and the commands, averaged over pieces before the start and up to the horizon."""
    sums = np.concatenate(
        [np.zeros((1, starts.record.commands.shape[1])), starts.record.commands.cumsum(axis=0)]
    )
    edges = np.round(np.linspace(0, starts.steps, min(PIECES, starts.steps) + 1)).astype(int)
    edges = np.concatenate([[-_back(starts, PAST_S)], edges])
    pieces = [(sums[starts.at + b] - sums[starts.at + a]) / (b - a) for a, b in pairwise(edges)]
    return np.hstack([habits(starts), *pieces])


def with_vehicle(vehicle: FittedVehicle) -> Features:
    """Features with what the vehicle alone predicts."""

    def features(starts: Starts) -> FloatArray:
        return np.hstack([habits(starts), _moves(starts, fly_ahead(starts, vehicle))])

    return features


def _back(starts: Starts, time_s: float) -> int:
    return max(round(time_s / starts.dt_s), 1)


def _moves(starts: Starts, ahead: Ahead) -> FloatArray:
    """(S, 12) moves to the horizon beyond constant velocity, in body axes of the start."""
    at = starts.at
    time_s = starts.steps * starts.dt_s
    body = starts.attitude[at]
    velocity = starts.velocity[at]
    parts = (
        rotations.to_body(body, ahead.position[-1] - starts.position[at] - time_s * velocity),
        rotations.to_body(body, ahead.velocity[-1] - velocity),
        rotations.to_vector(rotations.product(rotations.inverse(body), ahead.attitude[-1])),
        ahead.rate[-1] - starts.record.gyro[at],
    )
    return np.hstack(parts)


def measured(starts: Starts) -> Ahead:
    """What came, at the horizon alone."""
    rows = starts.at + starts.steps
    return Ahead(
        starts.position[rows][None],
        starts.velocity[rows][None],
        starts.attitude[rows][None],
        starts.record.gyro[rows][None],
    )


@dataclass(frozen=True, eq=False)
class Far:
    """A prediction to one horizon."""

    features: Features
    ridge: Ridge
    low: FloatArray
    high: FloatArray

    def predict(self, starts: Starts) -> Ahead:
        """At the horizon alone."""
        moved = self.ridge(np.clip(self.features(starts), self.low, self.high))
        at = starts.at
        body = starts.attitude[at]
        velocity = starts.velocity[at]
        time_s = starts.steps * starts.dt_s
        position = starts.position[at] + time_s * velocity + rotations.to_world(body, moved[:, :3])
        attitude = rotations.product(body, rotations.from_vector(moved[:, 6:9]))
        rate = starts.record.gyro[at] + moved[:, 9:]
        return Ahead(
            position[None],
            (velocity + rotations.to_world(body, moved[:, 3:6]))[None],
            attitude[None],
            rate[None],
        )


def fit_far(flights: Sequence[Starts], features: Features) -> Far:
    """A ridge from features of starts to a horizon; its weight predicts flights best that are left out."""
    known = [features(starts) for starts in flights]
    low, high = np.quantile(np.concatenate(known), USUAL, axis=0)
    known = [np.clip(x, low, high) for x in known]
    wanted = [_moves(starts, measured(starts)) for starts in flights]
    size = np.sqrt(np.mean(np.concatenate(wanted) ** 2, axis=0)) + np.finfo(float).tiny

    def error(weight: float) -> float:
        total = 0.0
        for out in range(len(known)):
            rest = [i for i in range(len(known)) if i != out]
            ridge = fit_ridge([known[i] for i in rest], [wanted[i] for i in rest], weight)
            total += float((np.abs(ridge(known[out]) - wanted[out]) / size).mean())
        return total

    weight = min(WEIGHTS, key=error) if len(known) > 1 else max(WEIGHTS)
    return Far(features, fit_ridge(known, wanted, weight), low, high)
