"""Prediction of a vehicle in the loop: physics, and what its controller will do about the state it is in.

The rates and attitudes some steps ahead are linear in the state, its past and the torques of the motors, an
axis by itself, one ridge regression a step. Position and velocity follow from thrust and drag along these
attitudes, and a ridge on what is left. None of this is the vehicle: another controller, another prediction.
The ridge's weight is that which predicts flights best that are left out in turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from flysid.errors import DataError
from flysid.sixdof import layout, rotations
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.horizons import (
    Ahead,
    Driven,
    Starts,
    drive,
    force_left,
    move_ahead,
    torque_left,
)
from flysid.sixdof.rigid_body import GRAVITY
from flysid.stretch import FloatArray

RATES_S = (0.0, 0.01, 0.03, 0.06, 0.1, 0.2)
TURNS_S = (0.02, 0.05, 0.1)
SPEEDS_S = (0.1, 0.2)
FORCES_S = (0.03, 0.1, 0.3, 1.0)
"""How long before a start the rates, turns, speeds and disturbances of force were that tell of it."""
PAST_S = 0.12
FINE_S = 0.02
COARSE_S = 0.04
"""Torques are averaged over pieces this long: fine ones near the start, coarse ones later."""
WEIGHTS = (1e-3, 1e-2, 3e-2, 1e-1)
"""Ridges that are tried."""
STILL = 1e-3
"""Of the mean square of all flights: a flight that moves less weighs no more."""


@dataclass(frozen=True, eq=False)
class Ridge:
    """Linear regression of (S, K) targets on (S, F) features, shrunk towards no effect."""

    mean: FloatArray
    spread: FloatArray
    slopes: FloatArray
    middle: FloatArray

    def __call__(self, features: FloatArray) -> FloatArray:
        return np.asarray((features - self.mean) / self.spread @ self.slopes + self.middle)


def fit_ridge(features: Sequence[FloatArray], targets: Sequence[FloatArray], weight: float) -> Ridge:
    """A ridge in which every flight counts alike, a gentle one as much as a fierce one.

    A flight's errors grow with its motion, so that its samples weigh as the inverse of its targets' squares.
    """
    each = np.array([np.mean(y**2, axis=0) for y in targets])
    size = (each / np.maximum(each.mean(axis=0), np.finfo(float).tiny)).mean(axis=1)
    size = np.maximum(size, STILL)
    share = np.concatenate(
        [np.full(len(x), 1.0 / (len(x) * own)) for x, own in zip(features, size, strict=True)]
    )
    share /= share.sum()
    x = np.concatenate(features)
    y = np.concatenate(targets)
    mean = share @ x
    spread = np.sqrt(share @ (x - mean) ** 2)
    spread[spread < 1e-9] = 1.0
    middle = share @ y
    scaled = (x - mean) / spread
    gram = scaled.T @ (share[:, None] * scaled)
    slopes = np.linalg.solve(gram + weight * np.eye(len(gram)), scaled.T @ (share[:, None] * (y - middle)))
    return Ridge(mean, spread, np.asarray(slopes, dtype=np.float64), middle)


@dataclass(frozen=True, eq=False)
class InLoop:
    """A prediction in the loop.

    Attributes
    ----------
    vehicle : the physics beneath it.
    turns : [step][axis] ridge to a turn (rad) and a rate (rad/s) about the body axis of the start.
    moves : [step][axis] ridge to what is left of position and velocity along the body axis of the start.
    weight : of the ridges.
    """

    vehicle: FittedVehicle
    turns: Sequence[Sequence[Ridge]]
    moves: Sequence[Sequence[Ridge]]
    weight: float

    def predict(self, starts: Starts) -> Ahead:
        """All starts of a flight."""
        seen = _Seen(starts, self.vehicle)
        attitudes, rates = _turned(seen, self.turns)
        positions, velocities = move_ahead(starts, self.vehicle, seen.driven, attitudes)
        body = starts.attitude[starts.at]
        for step, row in enumerate(self.moves):
            left = np.stack([row[axis](seen.move_features(step + 1, axis)) for axis in range(3)], axis=1)
            positions[step] += rotations.to_world(body, left[:, :, 0])
            velocities[step] += rotations.to_world(body, left[:, :, 1])
        return Ahead(positions, velocities, attitudes, rates)


def blind(vehicle: FittedVehicle) -> FittedVehicle:
    """The vehicle without its motors: whatever acts is held as a disturbance, and inputs tell nothing."""
    theta = vehicle.theta.copy()
    theta[layout.EFFECTS :] = 0.0
    theta[layout.THRUST] = 0.0
    theta[layout.ROTOR_DRAG : layout.BODY_DRAG] = 0.0  # drag and lean grow with the rotors' speed
    theta[layout.LEAN : layout.INERTIA] = 0.0
    return replace(vehicle, theta=theta)


def fit_in_loop(flights: Sequence[Starts], vehicle: FittedVehicle, weight: float | None = None) -> InLoop:
    """A prediction in the loop from training flights.

    Parameters
    ----------
    weight : of the ridges; None: that of `WEIGHTS` that predicts flights best that are left out in turn.

    Raises
    ------
    DataError : fewer than two flights have whole starts.
    """
    used = [starts for starts in flights if len(starts.at)]
    if len(used) < 2:
        raise DataError("a prediction in the loop needs two flights with whole starts")
    seen = [_Seen(starts, vehicle) for starts in used]
    chosen = _choose_weight(seen) if weight is None else weight
    turns = [_fit_turns(seen, step, chosen) for step in range(1, used[0].steps + 1)]
    ahead = []
    for own in seen:
        attitudes, _ = _turned(own, turns)
        ahead.append(move_ahead(own.starts, vehicle, own.driven, attitudes))
    moves = [_fit_moves(seen, ahead, step, chosen) for step in range(1, used[0].steps + 1)]
    return InLoop(vehicle, turns, moves, chosen)


class _Seen:
    """What predictions look at, from all starts of a flight."""

    def __init__(self, starts: Starts, vehicle: FittedVehicle) -> None:
        self.starts = starts
        self.driven: Driven = drive(starts.record, vehicle)
        self._dt = starts.dt_s
        self._torques = np.concatenate([np.zeros((1, 3)), np.cumsum(self.driven.torque, axis=0)])
        self._lifts = np.concatenate([[0.0], np.cumsum(self.driven.lift)])
        at = starts.at
        rates = [starts.record.gyro[at - self._back(t)] for t in RATES_S]
        turns = [
            rotations.to_vector(
                rotations.product(rotations.inverse(starts.attitude[at - self._back(t)]), starts.attitude[at])
            )
            for t in TURNS_S
        ]
        air = rotations.to_body(starts.attitude, starts.velocity)
        speeds = [air[at], *(air[at] - air[at - self._back(t)] for t in SPEEDS_S)]
        up = rotations.matrices(starts.attitude[at])[:, 2]
        forces = [force_left(starts, self.driven, vehicle, t)[at] for t in FORCES_S]
        torque = torque_left(starts, self.driven)[at]
        self._turning = []
        self._moving = []
        for axis in range(3):
            own = [*(r[:, axis] for r in rates), torque[:, axis], *(t[:, axis] for t in turns)]
            if axis < 2:
                other = 1 - axis  # rolling tilts the lift sideways, pitching forwards
                own += [up[:, other], *(s[:, other] for s in speeds), forces[1][:, other]]
            self._turning.append(np.stack(own, axis=1))
            moving = [*(f[:, axis] for f in forces), *(s[:, axis] for s in speeds), up[:, axis]]
            if axis == 2:
                moving.append((air[at, :2] ** 2).sum(axis=1))
            self._moving.append(np.stack(moving, axis=1))

    def _back(self, time_s: float) -> int:
        return round(time_s / self._dt)

    def turn_features(self, step: int, axis: int) -> FloatArray:
        """(S, F) what rates and turns so many steps ahead are regressed on."""
        at = self.starts.at
        fine = max(self._back(FINE_S), 1)
        coarse = max(self._back(COARSE_S), 1)
        past = self._back(PAST_S)
        edges = sorted({*range(-past, min(step, past), fine), *range(past, step, coarse), 0, step})
        pieces = [
            (self._torques[at + b, axis] - self._torques[at + a, axis]) / (b - a) for a, b in pairwise(edges)
        ]
        return np.column_stack([self._turning[axis], *pieces])

    def move_features(self, step: int, axis: int) -> FloatArray:
        """(S, F) what is left of moves so many steps ahead is regressed on."""
        if axis < 2:
            return self._moving[axis]
        at = self.starts.at
        past = self._back(PAST_S)
        before = (self._lifts[at] - self._lifts[at - past]) / past
        after = (self._lifts[at + step] - self._lifts[at]) / step
        return np.column_stack([self._moving[axis], before - GRAVITY, after - GRAVITY])

    def turn_targets(self, step: int, axis: int) -> FloatArray:
        """(S, 2) turn and rate about one axis, beyond those of a constant rate."""
        at = self.starts.at
        rate = self.starts.record.gyro[at, axis]
        attitude = self.starts.attitude
        turn = rotations.to_vector(rotations.product(rotations.inverse(attitude[at]), attitude[at + step]))
        later = self.starts.record.gyro[at + step, axis]
        return np.column_stack([turn[:, axis] - step * self._dt * rate, later - rate])


def _turned(seen: _Seen, turns: Sequence[Sequence[Ridge]]) -> tuple[FloatArray, FloatArray]:
    """(H, S, 4) attitudes and (H, S, 3) rates."""
    start = seen.starts.attitude[seen.starts.at]
    rate = seen.starts.record.gyro[seen.starts.at]
    attitudes = []
    rates = []
    for step, row in enumerate(turns, start=1):
        found = np.stack([row[axis](seen.turn_features(step, axis)) for axis in range(3)], axis=1)
        turn = found[:, :, 0] + step * seen.starts.dt_s * rate
        attitudes.append(rotations.product(start, rotations.from_vector(turn)))
        rates.append(rate + found[:, :, 1])
    return np.array(attitudes), np.array(rates)


def _fit_turns(seen: Sequence[_Seen], step: int, weight: float) -> list[Ridge]:
    return [
        fit_ridge(
            [own.turn_features(step, axis) for own in seen],
            [own.turn_targets(step, axis) for own in seen],
            weight,
        )
        for axis in range(3)
    ]


def _fit_moves(
    seen: Sequence[_Seen], ahead: Sequence[tuple[FloatArray, FloatArray]], step: int, weight: float
) -> list[Ridge]:
    left = []
    for own, (positions, velocities) in zip(seen, ahead, strict=True):
        rows = own.starts.at + step
        body = own.starts.attitude[own.starts.at]
        apart = (
            own.starts.position[rows] - positions[step - 1],
            own.starts.velocity[rows] - velocities[step - 1],
        )
        left.append(np.stack([rotations.to_body(body, each) for each in apart], axis=2))
    return [
        fit_ridge([own.move_features(step, axis) for own in seen], [x[:, axis] for x in left], weight)
        for axis in range(3)
    ]


def _choose_weight(seen: Sequence[_Seen]) -> float:
    """The ridge that predicts rates best of flights that are left out in turn, as shares of their motion."""
    steps = np.unique(np.geomspace(1, seen[0].starts.steps, 4).round().astype(int))

    def error(weight: float) -> float:
        total = 0.0
        for left_out in range(len(seen)):
            rest = [own for place, own in enumerate(seen) if place != left_out]
            for step in steps:
                row = _fit_turns(rest, int(step), weight)
                for axis in range(3):
                    told = row[axis](seen[left_out].turn_features(int(step), axis))
                    wanted = seen[left_out].turn_targets(int(step), axis)
                    total += float(np.abs(told - wanted)[:, 1].mean() / np.abs(wanted)[:, 1].mean())
        return total

    return min(WEIGHTS, key=error)
