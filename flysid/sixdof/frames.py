"""Axes of a log, found from the data: forward, left, up or forward, right, down; the world's likewise.

A gyro and an attitude that agree show the attitude's body axes, and which way it turns. What an accelerometer
reads in flight shows where up is, in either. Where velocities change as the accelerations that follow from
both, their world is the attitude's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np

from flysid.sixdof import rotations
from flysid.sixdof.cleaning import CHANCE, BoolArray
from flysid.sixdof.figures import Z95
from flysid.sixdof.record import Record
from flysid.sixdof.thrust_fit import WINDOW_S
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
    if found[0].attitude is not None and found[0].force is not None and found[0].velocity is not None:
        found = _match_force(found, words)
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


def _best_of(ways: Iterable[str], agrees: Callable[[str], float], steps: int) -> str:
    """The way that agrees best; that of no words where chance may have made another one better."""
    from scipy.special import ndtri

    alike = {name: agrees(name) for name in ways}
    best = max(alike, key=lambda name: alike[name])
    beyond = -ndtri(CHANCE) * np.sqrt(2.0 / max(steps, 1))  # of two correlations, where there is none
    return best if alike[best] - alike[""] > beyond else ""


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

    best = _best_of(ways, agrees, len(gyro))
    if not best:
        return list(records)
    words.append(best)
    return [replace(record, attitude=ways[best](_q(record))) for record in records]


_WORLDS = {
    "": np.eye(3),
    "velocities point down where the attitude's world points up": np.diag(OVER),
    "velocities are east and north where the attitude's world is north and west": _SWAPPED,
}
"""From the world of velocities to the attitude's."""


TURNS = [
    np.eye(3)[list(order)] * signs
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]
"""Of axes into axes: those first that move fewest of them, forward last; mirrors behind all turns."""
TURNS.sort(key=lambda turn: (np.linalg.det(turn), np.trace(turn), turn[0, 0]), reverse=True)


def _match_force(records: Sequence[Record], words: list[str]) -> list[Record]:
    """Accelerometers in the attitude's body axes.

    A velocity changes by gravity and by what is read, turned into the world. The turn of the accelerometer is
    the one that explains changes best, in that world of velocities in which it explains them best.
    """
    parts = [_changes(r, first, last) for r in records for first, last in r.stretches]
    if not parts:
        return list(records)
    read, moved = (np.concatenate(side) for side in zip(*parts, strict=True))
    if len(read) <= read.shape[2]:
        return list(records)
    turn = min((_turn_of(read, moved @ world.T) for world in _WORLDS.values()), key=lambda found: found[1])[0]
    if (turn == np.eye(3)).all():
        return list(records)
    axes = ", ".join(f"{'-' if row.sum() < 0.0 else ''}{'xyz'[int(np.abs(row).argmax())]}" for row in turn)
    words.append(f"the accelerometer's axes are not the attitude's, whose x, y, z are its {axes}")
    return [replace(record, force=_f(record) @ turn.T) for record in records]


def _changes(record: Record, first: int, last: int) -> tuple[FloatArray, FloatArray]:
    """(n, 3, 9) what each reading would add along each body axis, in the world; (n, 3) changes of velocity.

    Both are means over short windows, in m/s^2. A column of the nine is a body axis and, fastest, a reading.
    """
    assert record.velocity is not None
    width = max(round(WINDOW_S / record.dt_s), 1)
    at = np.arange(first, last - width, width)
    turn = rotations.matrices(_q(record)[first:last])
    each = np.einsum("nwk,nj->nwkj", turn, _f(record)[first:last]).reshape(-1, 3, 9)
    sums = np.concatenate([np.zeros((1, 3, 9)), each.cumsum(axis=0)])
    moved = (record.velocity[at + width] - record.velocity[at]) / (width * record.dt_s)
    return (sums[at - first + width] - sums[at - first]) / width, moved


def _turn_of(read: FloatArray, moved: FloatArray) -> tuple[FloatArray, float]:
    """(3, 3) turn of an accelerometer into body axes, and the mean square left.

    It is the first of `TURNS` that has the rows which are sure.
    """
    rows = (read - read.mean(axis=0)).reshape(-1, 9)  # gravity is what is constant
    wanted = (moved - moved.mean(axis=0)).ravel()
    inverse = np.linalg.pinv(rows.T @ rows, hermitian=True)
    found = inverse @ (rows.T @ wanted)
    left = float(np.mean((wanted - rows @ found) ** 2))
    sure = Z95 * np.sqrt(np.maximum(left * np.diag(inverse), 0.0)).reshape(3, 3)
    size = found.reshape(3, 3)
    known = np.abs(np.abs(size) - 0.5).min(axis=1) > sure.max(axis=1)  # a turn has ones and noughts
    fitting = (turn for turn in TURNS if (np.round(size)[known] == turn[known]).all())
    return next(fitting, np.eye(3)), left


def _match_velocity(records: Sequence[Record], words: list[str]) -> list[Record]:
    """Velocities and positions in the attitude's world."""

    def agrees(name: str) -> float:
        pairs = [
            (
                (np.diff(r.velocity, axis=0) @ _WORLDS[name].T)[steps_of(r)],
                rotations.to_world(_q(r), _f(r))[:-1][steps_of(r)],
            )
            for r in records
            if r.velocity is not None
        ]
        return likeness(*(np.concatenate(side) for side in zip(*pairs, strict=True)))

    best = _best_of(_WORLDS, agrees, sum(int(steps_of(r).sum()) for r in records))
    if not best:
        return list(records)
    words.append(best)
    turn = _WORLDS[best].T
    return [
        replace(
            record,
            velocity=None if record.velocity is None else record.velocity @ turn,
            position=None if record.position is None else record.position @ turn,
        )
        for record in records
    ]
