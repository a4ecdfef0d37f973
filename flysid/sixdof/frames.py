"""Axes of a log, found from the data: forward, left, up or forward, right, down; the world's likewise.

A gyro and an attitude that agree show the attitude's body axes, and which way it turns. What an accelerometer
reads in flight shows where up is, in either. Where velocities change as the accelerations that follow from
both, their world is the attitude's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from flysid.sixdof import rotations
from flysid.sixdof.cleaning import BoolArray
from flysid.sixdof.record import Record
from flysid.stretch import FloatArray

OVER = np.array([1.0, -1.0, -1.0])
"""From forward, left, up to forward, right, down, and back."""
_HALF_TURN = np.array([0.0, 1.0, 0.0, 0.0])
_SWAPPED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""From north, east, down to east, north, up, and back."""


def settle(records: Sequence[Record]) -> tuple[list[Record], tuple[str, ...]]:
    """The records in axes forward, left, up and a world whose z points up, and what was turned, in words.

    Only samples that are marked as flying are looked at: those whose telemetry is whole.
    """
    words: list[str] = []
    found = list(records)
    if found[0].attitude is not None:
        found = _match_attitude(found, words)
    if found[0].force is not None and sum(_f(r)[r.flying, 2].sum() for r in found) < 0.0:
        words.append("body axes are forward, right, down")
        found = [_body_over(record) for record in found]
    if found[0].attitude is not None and found[0].force is not None:
        up = np.concatenate([rotations.to_world(_q(r), _f(r))[r.flying] for r in found]).sum(axis=0)
        if up[2] < 0.0:
            words.append("the world's z points down")
            found = [_world_over(record) for record in found]
        if found[0].velocity is not None:
            found = _match_velocity(found, words)
    return found, tuple(words)


def _q(record: Record) -> FloatArray:
    assert record.attitude is not None
    return record.attitude


def _f(record: Record) -> FloatArray:
    assert record.force is not None
    return record.force


def steps_of(record: Record) -> BoolArray:
    """(N - 1,) steps from one whole sample to the next."""
    return np.asarray(record.flying[1:] & record.flying[:-1])


def _body_over(record: Record) -> Record:
    """From body axes forward, right, down to forward, left, up."""
    return replace(
        record,
        gyro=record.gyro * OVER,
        force=None if record.force is None else record.force * OVER,
        attitude=None if record.attitude is None else rotations.product(record.attitude, _HALF_TURN),
    )


def _world_over(record: Record) -> Record:
    """From a world with z down to one with z up."""
    return replace(
        record,
        attitude=rotations.product(_HALF_TURN, _q(record)),
        velocity=None if record.velocity is None else record.velocity * OVER,
        position=None if record.position is None else record.position * OVER,
    )


def likeness(one: FloatArray, other: FloatArray) -> float:
    """Correlation of all columns together, without their means; 0 where there are no rows."""
    if not len(one):
        return 0.0
    a = one - one.mean(axis=0)
    b = other - other.mean(axis=0)
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0.0 else 0.0


def _match_attitude(records: Sequence[Record], words: list[str]) -> list[Record]:
    """Attitudes that turn the gyro's body axes into the world's."""
    ways: dict[str, Callable[[FloatArray], FloatArray]] = {
        "": lambda q: q,
        "the attitude turns the world into the body": rotations.inverse,
        "the attitude's body axes point down where the gyro's point up": lambda q: rotations.product(
            q, _HALF_TURN
        ),
        "the attitude turns the world into a body that points down where the gyro's points up": lambda q: (
            rotations.product(rotations.inverse(q), _HALF_TURN)
        ),
    }
    gyro = np.concatenate([record.gyro[:-1][steps_of(record)] for record in records])

    def agrees(name: str) -> float:
        rates = [rotations.body_rates(ways[name](_q(r)), r.dt_s)[steps_of(r)] for r in records]
        return likeness(gyro, np.concatenate(rates))

    best = max(ways, key=agrees)
    if not best:
        return list(records)
    words.append(best)
    return [replace(record, attitude=ways[best](_q(record))) for record in records]


def _match_velocity(records: Sequence[Record], words: list[str]) -> list[Record]:
    """Velocities and positions in the attitude's world."""
    ways = {
        "": np.eye(3),
        "velocities point down where the attitude's world points up": np.diag(OVER),
        "velocities are east and north where the attitude's world is north and west": _SWAPPED,
    }

    def agrees(name: str) -> float:
        pairs = [
            (
                (np.diff(r.velocity, axis=0) @ ways[name].T)[steps_of(r)],
                rotations.to_world(_q(r), _f(r))[:-1][steps_of(r)],
            )
            for r in records
            if r.velocity is not None
        ]
        return likeness(*(np.concatenate(side) for side in zip(*pairs, strict=True)))

    best = max(ways, key=agrees)
    if not best:
        return list(records)
    words.append(best)
    turn = ways[best].T
    return [
        replace(
            record,
            velocity=None if record.velocity is None else record.velocity @ turn,
            position=None if record.position is None else record.position @ turn,
        )
        for record in records
    ]
