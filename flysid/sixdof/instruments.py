"""Do the instruments of a flight agree with each other, and with gravity? It shows wrong units and axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flysid.errors import DataError
from flysid.sixdof import rotations
from flysid.sixdof.cleaning import ALIKE
from flysid.sixdof.frames import likeness, steps_of
from flysid.sixdof.record import Record
from flysid.sixdof.rigid_body import GRAVITY
from flysid.sixdof.thrust_fit import WINDOW_S
from flysid.stretch import FloatArray

FORCES = {GRAVITY: "m/s^2", 1.0: "g", 100.0 * GRAVITY: "cm/s^2 or mg"}
"""What gravity reads in a unit. An accelerometer's unit is the one whose reading is nearest, as a ratio."""
TURNS = {1.0: "rad/s", float(np.degrees(1.0)): "deg/s", 1000.0: "mrad/s"}
"""A rad/s in a unit."""


def check_instruments(records: Sequence[Record]) -> tuple[str, ...]:
    """What does not agree, in words.

    Parameters
    ----------
    records : in axes that are settled.

    Raises
    ------
    DataError : a gyro that stands still; instruments in other units.
    """
    gyro = np.concatenate([record.gyro for record in records])
    if not np.ptp(gyro, axis=0).any():
        raise DataError("the gyro never changes", hint="a recipe that names the body rates (rad/s)")
    _check_force(records)
    return _check_attitude(records)


def _check_force(records: Sequence[Record]) -> None:
    """Over a flight an accelerometer reads gravity on average."""
    parts = [record.force[record.flying] for record in records if record.force is not None]
    force = np.concatenate(parts) if parts else np.zeros((0, 3))
    if not len(force):
        return
    size = float(np.linalg.norm(force, axis=1).mean())
    unit = _nearest(FORCES, size)
    if unit != "m/s^2":
        raise DataError(
            f"the accelerometer reads {size:.2g} on average, as one in {unit} does", hint="write it in m/s^2"
        )


def _nearest(readings: Mapping[float, str], value: float) -> str:
    """The unit whose reading is nearest, as a ratio."""
    return readings[min(readings, key=lambda reading: abs(np.log(value / reading)))]


def _check_attitude(records: Sequence[Record]) -> tuple[str, ...]:
    """A gyro shows how fast the attitude turns."""
    pairs = [
        (r.gyro[:-1][steps_of(r)], rotations.body_rates(r.attitude, r.dt_s)[steps_of(r)])
        for r in records
        if r.attitude is not None and len(r) > 1
    ]
    if not pairs:
        return ()
    gyro, rates = (np.concatenate(side) for side in zip(*pairs, strict=True))
    alike = likeness(gyro, rates)
    if not alike > ALIKE:
        return (
            f"gyro and attitude hardly turn alike (correlation {alike:.2f}): axes or clocks are mixed up, or "
            "the attitude is coarse",
        )
    times = float((gyro**2).sum() / (gyro * rates).sum())
    unit = _nearest(TURNS, times)
    if unit != "rad/s":
        raise DataError(
            f"the gyro turns {times:.0f} times as fast as the attitude, as one in {unit} does",
            hint="write it in rad/s",
        )
    return ()


def check_lift(records: Sequence[Record]) -> None:
    """DataError where the vehicle is lifted less while its motors are commanded more.

    Parameters
    ----------
    records : in axes that are settled, what flies marked.
    """
    parts = [
        (_averages(r, r.commands.sum(axis=1), first, last), _averages(r, r.force[:, 2], first, last))
        for r in records
        if r.force is not None
        for first, last in r.stretches
    ]
    if not parts:
        return
    pushed, lifted = (np.concatenate(side)[:, None] for side in zip(*parts, strict=True))
    alike = likeness(pushed, lifted)
    if alike < -ALIKE:
        raise DataError(
            f"the more these motors are commanded the less they lift (correlation {alike:.2f}): the "
            "commands are reversed, or those of no motors",
            hint="turn the commands round, so that more is more thrust",
        )


def _averages(record: Record, signal: FloatArray, first: int, last: int) -> FloatArray:
    """(N,) means of a stretch over windows that motors follow within."""
    length = max(round(WINDOW_S / record.dt_s), 1)
    count = max((last - first) // length, 1)
    return np.array([part.mean() for part in np.array_split(signal[first:last], count)])
