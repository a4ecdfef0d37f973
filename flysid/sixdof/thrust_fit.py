"""Thrust, its curve and voltage power, and drag: from velocities, else from the accelerometer.

Over short windows the velocity changes by what thrust, drag and gravity sum up to, along the measured
attitude.
Every flight has a wind and a lateral force of its own (how its attitude is mounted), with weak priors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.sixdof import layout, rotations
from flysid.sixdof.actuators import CHAIN, interval_means, shares
from flysid.sixdof.descent import Block, Found, descend, robust
from flysid.sixdof.layout import BODY_DRAG, CURVE, POWER, ROTOR_DRAG, THRUST
from flysid.sixdof.record import Record
from flysid.sixdof.rigid_body import GRAVITY
from flysid.sixdof.torque_fit import BLOCK_S, log_voltage_of
from flysid.stretch import FloatArray

WINDOW_S = 0.2
WIND_SD = 3.0
"""m/s; beforehand of a flight's mean wind, along each horizontal axis."""
FORCE_SD = 0.5
"""m/s^2; beforehand of a flight's lateral force, and of the accelerometer's bias."""
OWN = 4
"""Numbers that every flight has of its own: wind east and north, lateral force forward and left."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """One whole stretch: slices of a record, and whose it is."""

    record: Record
    log_voltage: FloatArray
    first: int
    last: int
    flight: int


def stretches_of(records: Sequence[Record], reference_v: float) -> list[Stretch]:
    """Every whole stretch in the air, of at least three windows."""
    names = list(dict.fromkeys(record.flight for record in records))
    found = []
    for record in records:
        log_voltage = log_voltage_of(record, reference_v)
        for first, last in record.stretches:
            if (last - first) * record.dt_s >= 3.0 * WINDOW_S:
                found.append(Stretch(record, log_voltage, first, last, names.index(record.flight)))
    return found


def fit_thrust(stretches: Sequence[Stretch], theta: FloatArray, free: Sequence[int], calm: bool) -> Found:
    """Thrust, curve, voltage power and drag among `free`; lag and delay of `theta` are held.

    The numbers of flights stand behind those of the vehicle, `OWN` a flight.

    Parameters
    ----------
    calm : hold the wind at zero (indoors, or where nothing tells it).
    """
    flights = 1 + max(stretch.flight for stretch in stretches)
    motors = stretches[0].record.commands.shape[1]
    low, high = layout.limits(motors)
    beyond = np.full(OWN * flights, np.inf)
    limits = np.concatenate([low, -beyond]), np.concatenate([high, beyond])
    start = np.concatenate([theta, np.zeros(OWN * flights)])
    moves = stretches[0].record.velocity is not None and stretches[0].record.attitude is not None
    blocks_of = _velocity_blocks if moves else _force_blocks
    chains = {} if {CURVE, POWER} & set(free) else {id(s): _shares_of(s, theta) for s in stretches}
    size = 1.0
    weights: list[FloatArray] = []

    def blocks_at(own: FloatArray) -> list[Block]:
        found = []
        for stretch in stretches:
            chain = chains.get(id(stretch)) or _shares_of(stretch, own[: len(theta)])
            found += blocks_of(stretch, own, len(theta), chain)
        scaled = [(r / size, by / size) for r, by in found]
        if not weights:
            return scaled
        return [(w * r, w[:, None] * by) for w, (r, by) in zip(weights, scaled, strict=True)]

    wanted = [*free, *_own_numbers(flights, len(theta), calm or not moves)]
    prior = np.zeros(len(start))
    prior[len(theta) :] = np.tile([WIND_SD**-2, WIND_SD**-2, FORCE_SD**-2, FORCE_SD**-2], flights)
    found = descend(blocks_at, start, wanted, limits, prior)
    for _ in range(2):
        weights.clear()
        size = 1.0
        plain = blocks_at(found.theta)
        together = np.concatenate([r for r, _ in plain])
        size = max(1.4826 * float(np.median(np.abs(together))), np.finfo(float).tiny)
        weights += [robust(r) for r, _ in plain]
        found = descend(blocks_at, found.theta, wanted, limits, prior)
    return found


def _own_numbers(flights: int, first: int, calm: bool) -> list[int]:
    """Places of the flights' own numbers that are sought."""
    own = range(2, OWN) if calm else range(OWN)
    return [first + OWN * flight + i for flight in range(flights) for i in own]


def _shares_of(stretch: Stretch, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n - 1, motors) mean shares over every sample interval, and (4, n - 1, motors) derivatives."""
    record = stretch.record
    lead = max(stretch.first - round(1.0 / record.dt_s), 0)
    part = slice(lead, stretch.last)
    halves, by = shares(record.commands[part], stretch.log_voltage[part], record.dt_s, theta)
    skip = 2 * (stretch.first - lead)
    return interval_means(halves[skip:]), interval_means(by[:, skip:])


def _forces(
    share: FloatArray, share_by: FloatArray, air: FloatArray, own: FloatArray, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, 3) specific force in body axes, (n, 3, count) its derivatives, (n, 3, 3) those by air speed."""
    lift = share.sum(axis=1)
    root = np.sqrt(np.maximum(share, np.finfo(float).tiny))
    spin = root.sum(axis=1)
    speed = np.linalg.norm(air, axis=1)
    rotor = own[ROTOR_DRAG : ROTOR_DRAG + 3]
    body = own[BODY_DRAG : BODY_DRAG + 3]
    force = -(rotor * spin[:, None] + body * speed[:, None]) * air
    force[:, 2] += own[THRUST] * lift
    by = np.zeros((len(air), 3, count))
    by_air = np.zeros((len(air), 3, 3))
    by[:, 2, THRUST] = lift
    for k in range(3):
        by[:, k, ROTOR_DRAG + k] = -spin * air[:, k]
        by[:, k, BODY_DRAG + k] = -speed * air[:, k]
        by_air[:, k, k] -= rotor[k] * spin + body[k] * speed
        by_air[:, k, :] -= (
            body[k] * air[:, k : k + 1] * air / np.maximum(speed, np.finfo(float).tiny)[:, None]
        )
    for place, column in enumerate(CHAIN):
        spin_by = (0.5 * share_by[place] / root).sum(axis=1)
        by[:, :, column] = -rotor * spin_by[:, None] * air
        by[:, 2, column] += own[THRUST] * share_by[place].sum(axis=1)
    return force, by, by_air


def _velocity_blocks(
    stretch: Stretch, own: FloatArray, count: int, chain: tuple[FloatArray, FloatArray]
) -> list[Block]:
    record = stretch.record
    assert record.velocity is not None
    assert record.attitude is not None
    part = slice(stretch.first, stretch.last)
    velocity = record.velocity[part]
    half_way = rotations.unit(record.attitude[part][1:] + _same_side(record.attitude[part]))
    turn = rotations.matrices(half_way)
    place = count + OWN * stretch.flight
    wind = np.array([own[place], own[place + 1], 0.0])
    air = np.einsum("nji,nj->ni", turn, 0.5 * (velocity[1:] + velocity[:-1]) - wind)
    force, by, by_air = _forces(*chain, air, own, count)
    force[:, :2] += own[place + 2 : place + 4]
    world = np.einsum("nij,nj->ni", turn, force)
    world[:, 2] -= GRAVITY
    slopes = np.zeros((len(force), 3, len(own)))
    slopes[:, :, :count] = np.einsum("nij,njp->nip", turn, by)
    slopes[:, :, place : place + 2] = -np.einsum("nij,njk,nlk->nil", turn, by_air, turn)[:, :, :2]
    slopes[:, :, place + 2 : place + 4] = turn[:, :, :2]
    return _windowed(np.diff(velocity, axis=0) / record.dt_s - world, slopes, record.dt_s)


def _same_side(attitude: FloatArray) -> FloatArray:
    """All quaternions but the last, with the sign of their followers."""
    sign = np.sign((attitude[1:] * attitude[:-1]).sum(axis=1, keepdims=True))
    return np.asarray(np.where(sign == 0.0, 1.0, sign) * attitude[:-1])


def _force_blocks(
    stretch: Stretch, own: FloatArray, count: int, chain: tuple[FloatArray, FloatArray]
) -> list[Block]:
    record = stretch.record
    assert record.force is not None
    part = slice(stretch.first, stretch.last)
    air = np.zeros((stretch.last - stretch.first - 1, 3))
    force, by, _ = _forces(*chain, air, own, count)
    place = count + OWN * stretch.flight
    slopes = np.zeros((len(force), 1, len(own)))
    slopes[:, 0, :count] = by[:, 2]
    slopes[:, 0, place + 3] = 1.0  # where no velocity is known, the bias of the vertical accelerometer
    measured = 0.5 * (record.force[part][1:, 2] + record.force[part][:-1, 2])
    left = measured - force[:, 2] - own[place + 3]
    return _windowed(left[:, None], slopes, record.dt_s)


def force_of(stretch: Stretch, theta: FloatArray, wind: FloatArray) -> FloatArray:
    """(n - 1, 3) specific force in body axes at measured velocities, in a wind east and north."""
    record = stretch.record
    assert record.velocity is not None
    assert record.attitude is not None
    part = slice(stretch.first, stretch.last)
    velocity = 0.5 * (record.velocity[part][1:] + record.velocity[part][:-1])
    air = rotations.to_body(record.attitude[part][:-1], velocity - np.array([*wind, 0.0]))
    return _forces(*_shares_of(stretch, theta), air, theta, len(theta))[0]


def _windowed(left: FloatArray, slopes: FloatArray, dt_s: float) -> list[Block]:
    """Means over windows that overlap by half, in blocks that gusts do not link."""
    width = max(round(WINDOW_S / dt_s), 1)
    starts = np.arange(0, len(left) - width + 1, max(width // 2, 1))
    sums = np.concatenate([np.zeros((1, *left.shape[1:])), np.cumsum(left, axis=0)])
    slope_sums = np.concatenate([np.zeros((1, *slopes.shape[1:])), np.cumsum(slopes, axis=0)])
    mean = (sums[starts + width] - sums[starts]) / width
    by = (slope_sums[starts + width] - slope_sums[starts]) / width
    count = max(round(len(left) * dt_s / BLOCK_S), 1)
    parts = np.array_split(np.arange(len(starts)), min(count, len(starts)))
    return [(mean[rows].ravel(), by[rows].reshape(-1, by.shape[2])) for rows in parts]
