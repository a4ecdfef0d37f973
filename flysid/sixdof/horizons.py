"""From many starts of a flight to some steps ahead: what is predicted, and how far it is from what came.

A start is whole if telemetry is undamaged from `BEFORE_S` before it to its horizon, and the vehicle flies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.filters import apply_filter
from flysid.sixdof import layout, rotations
from flysid.sixdof.actuators import interval_means, shares
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import ARM, BODY_DRAG, DAMPING, INERTIA, LEAN, ROTOR_DRAG, THRUST, TRIM
from flysid.sixdof.record import Record
from flysid.sixdof.rigid_body import GRAVITY
from flysid.sixdof.rules import ROLL, Conditions, HingeRule, add_up
from flysid.sixdof.torque_fit import log_voltage_of
from flysid.stretch import FloatArray

BEFORE_S = 0.2
KINDS = ("position", "velocity", "attitude", "rate")
"""Of errors: m, m/s, rad, rad/s."""
TORQUE_S = 0.1
FORCE_S = 0.15
"""Over which a disturbance of torque, and of force, is averaged before a start."""


@dataclass(frozen=True, eq=False)
class Ahead:
    """Predictions from S starts, H steps ahead.

    Attributes
    ----------
    position, velocity, rate : (H, S, 3); attitude : (H, S, 4).
    """

    position: FloatArray
    velocity: FloatArray
    attitude: FloatArray
    rate: FloatArray


@dataclass(frozen=True, eq=False)
class Starts:
    """A flight with velocities and attitudes, seen from its starts.

    Attributes
    ----------
    at : (S,) samples.
    """

    record: Record
    at: FloatArray
    steps: int

    @property
    def dt_s(self) -> float:
        return self.record.dt_s

    @property
    def position(self) -> FloatArray:
        assert self.record.position is not None
        return self.record.position

    @property
    def velocity(self) -> FloatArray:
        assert self.record.velocity is not None
        return self.record.velocity

    @property
    def attitude(self) -> FloatArray:
        assert self.record.attitude is not None
        return self.record.attitude


def whole_starts(record: Record, steps: int, every: int) -> Starts:
    """Every so many samples of a record, where it flies and telemetry is whole.

    Parameters
    ----------
    steps : how far ahead predictions go, in samples.
    """
    before = round(BEFORE_S / record.dt_s)
    damaged = np.concatenate([[0], np.cumsum(record.lost)])
    at = np.arange(0, len(record) - steps, every)
    at = at[at >= before]
    whole = damaged[at + steps + 1] == damaged[at - before]
    return Starts(record, at[whole & record.flying[at]], steps)


def hold(starts: Starts) -> Ahead:
    """Constant velocity and constant body rate."""
    steps = np.arange(1, starts.steps + 1) * starts.dt_s
    at = starts.at
    rate = starts.record.gyro[at]
    turn = rotations.from_vector(steps[:, None, None] * rate)
    shape = (len(steps), len(at), 3)
    return Ahead(
        starts.position[at] + steps[:, None, None] * starts.velocity[at],
        np.broadcast_to(starts.velocity[at], shape),
        rotations.product(starts.attitude[at][None], turn),
        np.broadcast_to(rate, shape),
    )


@dataclass(frozen=True, eq=False)
class Driven:
    """What a vehicle's numbers say of a whole record.

    Attributes
    ----------
    torque : (N - 1, 3) angular acceleration by motors, from sample to sample.
    turning : (N - 1, 3) that by all else: trim, damping, speed.
    lift : (N - 1,) specific force along z by motors; spin : (N - 1,) sum of rotor speeds.
    """

    torque: FloatArray
    turning: FloatArray
    lift: FloatArray
    spin: FloatArray


def drive(record: Record, vehicle: FittedVehicle) -> Driven:
    """Torques and forces over a record at measured velocities and attitudes."""
    theta = vehicle.theta
    log_voltage = np.zeros(len(record))
    if np.isfinite(vehicle.reference_v):
        log_voltage = log_voltage_of(record, vehicle.reference_v)
    mean = interval_means(shares(record.commands, log_voltage, record.dt_s, theta)[0])
    spin = np.sqrt(np.maximum(mean, 0.0)).sum(axis=1)
    assert record.velocity is not None
    assert record.attitude is not None
    air = rotations.to_body(record.attitude, record.velocity)[:-1]
    rate = record.gyro[:-1]
    turning = theta[TRIM:DAMPING] - theta[DAMPING : DAMPING + 3] * spin[:, None] * rate
    turning[:, 0] += theta[LEAN] * spin * air[:, 1]
    turning[:, 1] += theta[LEAN + 1] * spin * air[:, 0]
    turning += _met_by_hubs(theta, mean, rate)
    pitch, yaw = theta[INERTIA : INERTIA + 2]
    couple = np.array([pitch - yaw, (yaw - 1.0) / pitch, (1.0 - pitch) / yaw])
    turning += couple * np.roll(rate, -1, axis=1) * np.roll(rate, -2, axis=1)
    return Driven(mean @ layout.effects(theta).T, turning, theta[THRUST] * mean.sum(axis=1), spin)


def _met_by_hubs(theta: FloatArray, share: FloatArray, rate: FloatArray) -> FloatArray:
    """(n, 3) angular acceleration by the air that hubs meet as the vehicle turns; see `layout`."""
    if not (theta[ARM] > 0.0 and theta[THRUST] > 0.0):
        return np.zeros_like(rate)
    root = np.sqrt(np.maximum(share, 0.0))
    roll, pitch, _ = layout.effects(theta)
    drag = theta[ROTOR_DRAG : ROTOR_DRAG + 3]
    ry, rz = theta[INERTIA : INERTIA + 2]
    tipping = rate[:, :1] * roll + ry * rate[:, 1:2] * pitch
    yaw = rate[:, 2] * (root @ (drag[0] * roll**2 + drag[1] * (ry * pitch) ** 2)) / rz
    parts = (
        drag[2] * (root * roll * tipping).sum(axis=1),
        drag[2] * (root * pitch * tipping).sum(axis=1),
        yaw,
    )
    return np.asarray(-theta[ARM] / theta[THRUST] * np.stack(parts, axis=1))


def averaged(values: FloatArray, time_s: float, dt_s: float) -> FloatArray:
    """(N + 1, ...) exponential averages of what was before every sample."""
    fade = np.exp(-dt_s / time_s)
    found = apply_filter(np.array([1.0 - fade]), np.array([1.0, -fade]), values)
    return np.concatenate([np.zeros((1, *values.shape[1:])), found])


def torque_apart(record: Record, driven: Driven, added: FloatArray | None = None) -> FloatArray:
    """(N - 1, 3) angular acceleration beyond what a vehicle's numbers say, and rules add."""
    left = np.diff(record.gyro, axis=0) / record.dt_s - driven.torque - driven.turning
    return np.asarray(left if added is None else left - added)


def torque_left(starts: Starts, driven: Driven, time_s: float = TORQUE_S) -> FloatArray:
    """(N, 3) disturbance of angular acceleration, as the samples before show it."""
    return averaged(torque_apart(starts.record, driven), time_s, starts.dt_s)


def force_apart(
    record: Record, driven: Driven, vehicle: FittedVehicle, added: FloatArray | None = None
) -> FloatArray:
    """(N - 1, 3) specific force in body axes beyond what a vehicle's numbers say, and rules add."""
    assert record.velocity is not None
    assert record.attitude is not None
    seen = np.diff(record.velocity, axis=0) / record.dt_s + np.array([0.0, 0.0, GRAVITY])
    body = rotations.to_body(record.attitude[:-1], seen)
    air = rotations.to_body(record.attitude, record.velocity)[:-1]
    left = body - _force(vehicle, driven.lift, driven.spin, air)
    return np.asarray(left if added is None else left - added)


def force_left(starts: Starts, driven: Driven, vehicle: FittedVehicle, time_s: float = FORCE_S) -> FloatArray:
    """(N, 3) disturbance of specific force in body axes, as the samples before show it."""
    return averaged(force_apart(starts.record, driven, vehicle), time_s, starts.dt_s)


def conditions_of(record: Record, driven: Driven) -> Conditions:
    """From sample to sample, N - 1 times."""
    assert record.velocity is not None
    assert record.attitude is not None
    assert record.position is not None
    air = rotations.to_body(record.attitude, record.velocity)[:-1]
    height = record.position[:-1, 2] - lowest(record)
    return Conditions(air, driven.lift, driven.torque, height)


def lowest(record: Record) -> float:
    """m, the lowest place whose telemetry is whole."""
    assert record.position is not None
    whole = record.position[~record.lost, 2]
    return float(whole.min()) if len(whole) else 0.0


def _force(vehicle: FittedVehicle, lift: FloatArray, spin: FloatArray, air: FloatArray) -> FloatArray:
    """(n, 3) specific force in body axes at an air speed in body axes."""
    theta = vehicle.theta
    speed = np.linalg.norm(air, axis=1, keepdims=True)
    rotor = theta[ROTOR_DRAG : ROTOR_DRAG + 3] * spin[:, None]
    force = -(rotor + theta[BODY_DRAG : BODY_DRAG + 3] * speed) * air
    force[:, 2] += lift
    return np.asarray(force)


def turn_ahead(
    starts: Starts, vehicle: FittedVehicle, driven: Driven, rules: Sequence[HingeRule] = ()
) -> tuple[FloatArray, FloatArray]:
    """(H, S, 4) attitudes and (H, S, 3) rates by physics and rules, disturbances of torque held.

    Rules see the speed and the height of the start, and the torques of every step.
    """
    at = starts.at
    dt = starts.dt_s
    rate = starts.record.gyro[at].copy()
    attitude = starts.attitude[at].copy()
    known = conditions_of(starts.record, driven) if rules else None
    added = None if known is None else add_up(rules, known)[:, ROLL:]
    held = averaged(torque_apart(starts.record, driven, added), TORQUE_S, dt)[at]
    attitudes = []
    rates = []
    damping = vehicle.theta[DAMPING : DAMPING + 3]
    start = rate.copy()
    for step in range(starts.steps):
        other = driven.turning[at] - damping * driven.spin[at, None] * (rate - start)
        if known is not None:
            now = Conditions(
                known.air[at], driven.lift[at + step], driven.torque[at + step], known.height[at]
            )
            other = other + add_up(rules, now)[:, ROLL:]
        after = rate + dt * (driven.torque[at + step] + other + held)
        attitude = rotations.product(attitude, rotations.from_vector(0.5 * dt * (rate + after)))
        rate = after
        attitudes.append(attitude)
        rates.append(rate)
    return np.array(attitudes), np.array(rates)


def move_ahead(
    starts: Starts,
    vehicle: FittedVehicle,
    driven: Driven,
    attitudes: FloatArray,
    rules: Sequence[HingeRule] = (),
) -> tuple[FloatArray, FloatArray]:
    """(H, S, 3) positions and velocities along these attitudes, disturbances of force held."""
    at = starts.at
    dt = starts.dt_s
    floor = lowest(starts.record)
    added = add_up(rules, conditions_of(starts.record, driven))[:, :ROLL] if rules else None
    held = averaged(force_apart(starts.record, driven, vehicle, added), FORCE_S, dt)[at]
    position = starts.position[at].copy()
    velocity = starts.velocity[at].copy()
    before = starts.attitude[at]
    positions = []
    velocities = []
    for step in range(starts.steps):
        half_way = rotations.unit(before + attitudes[step])
        air = rotations.to_body(half_way, velocity)
        force = _force(vehicle, driven.lift[at + step], driven.spin[at + step], air) + held
        if rules:
            height = position[:, 2] - floor
            now = Conditions(air, driven.lift[at + step], driven.torque[at + step], height)
            force = force + add_up(rules, now)[:, :ROLL]
        moved = rotations.to_world(half_way, force) - np.array([0.0, 0.0, GRAVITY])
        position = position + dt * velocity + 0.5 * dt * dt * moved
        velocity = velocity + dt * moved
        before = attitudes[step]
        positions.append(position)
        velocities.append(velocity)
    return np.array(positions), np.array(velocities)


def fly_ahead(starts: Starts, vehicle: FittedVehicle, rules: Sequence[HingeRule] = ()) -> Ahead:
    """The vehicle alone: physics and rules, held disturbances that the samples before a start show."""
    driven = drive(starts.record, vehicle)
    attitudes, rates = turn_ahead(starts, vehicle, driven, rules)
    return Ahead(*move_ahead(starts, vehicle, driven, attitudes, rules), attitudes, rates)


def errors(starts: Starts, ahead: Ahead) -> FloatArray:
    """(H, 4) mean errors over the starts: position, velocity, attitude, rate; NaN without starts."""
    rows = starts.at + np.arange(1, starts.steps + 1)[:, None]
    if not len(starts.at):
        return np.full((starts.steps, len(KINDS)), np.nan)
    turn = rotations.product(rotations.inverse(ahead.attitude), starts.attitude[rows])
    apart = (
        starts.position[rows] - ahead.position,
        starts.velocity[rows] - ahead.velocity,
        rotations.to_vector(turn),
        starts.record.gyro[rows] - ahead.rate,
    )
    return np.stack([np.linalg.norm(each, axis=2).mean(axis=1) for each in apart], axis=1)
