"""How a vehicle lies in the air, how far that is from what was commanded, and how fast it sinks."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.lake.clocked import BoolArray, ClockedLog, Column

FRESH = 10.0
"""Periods: an older command is of a mode that was left, such as before a pilot took the rates."""


def up_axis(flight: ClockedLog) -> tuple[FloatArray, FloatArray, str] | None:
    """(n,) times, (n, 3) the vehicle's downward axis with its nose to the north, its field; None for none."""
    rolls = ("ATT.Roll", "ATTITUDE.roll", "main.attitude[0]")
    pitches = ("ATT.Pitch", "ATTITUDE.pitch", "main.attitude[1]")
    return _of_angles(flight, rolls, pitches) or _of_quaternion(flight, "vehicle_attitude.q")


def commanded_axis(flight: ClockedLog) -> tuple[FloatArray, FloatArray, str] | None:
    """As `up_axis`, of the setpoint."""
    return _of_angles(flight, ("ATT.DesRoll",), ("ATT.DesPitch",)) or _of_quaternion(
        flight, "vehicle_attitude_setpoint.q_d"
    )


def _of_angles(
    flight: ClockedLog, rolls: tuple[str, ...], pitches: tuple[str, ...]
) -> tuple[FloatArray, FloatArray, str] | None:
    """With the nose to the north: an angle between two of them is that between their tilts."""
    roll = flight.quantity(*rolls, unit="rad", stated="deg")
    pitch = flight.quantity(*pitches, unit="rad", stated="deg")
    if roll is None or pitch is None:
        return None
    lean = pitch.held(roll.time_s)
    axis = [np.cos(roll.values) * np.sin(lean), -np.sin(roll.values), np.cos(roll.values) * np.cos(lean)]
    return roll.time_s, np.stack(axis, axis=1), roll.address


def _of_quaternion(flight: ClockedLog, field: str) -> tuple[FloatArray, FloatArray, str] | None:
    """Without its heading, as `_of_angles`."""
    parts = [flight.quantity(f"{field}[{i}]") for i in range(4)]
    known = [part for part in parts if part is not None]
    if len(known) < 4 or len({len(part) for part in known}) > 1:
        return None
    w, x, y, z = (part.values for part in known)
    forward, right = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x)
    axis = np.stack([-forward, -right, 1.0 - 2.0 * (x * x + y * y)], axis=1)
    return known[0].time_s, axis, known[0].address


def tilt(flight: ClockedLog) -> Column | None:
    """Angle from level in deg."""
    found = up_axis(flight)
    if found is None:
        return None
    time_s, axis, field = found
    return Column(field, "deg", time_s, np.degrees(np.arccos(np.clip(axis[:, 2], -1.0, 1.0))))


def tilt_error(flight: ClockedLog) -> Column | None:
    """Angle in deg between the tilt that was commanded and the one that came, while a command is logged."""
    found, wanted = up_axis(flight), commanded_axis(flight)
    if found is None or wanted is None or not len(wanted[0]):
        return None
    time_s, axis, field = found
    place = np.searchsorted(wanted[0], time_s, side="right") - 1
    known = is_fresh(wanted[0], time_s)
    cosine = np.einsum("ni,ni->n", axis[known], wanted[1][place[known]])
    return Column(field, "deg", time_s[known], np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def is_fresh(stamps_s: FloatArray, time_s: FloatArray) -> BoolArray:
    """(n,) whether at times (n,) a command of some stamps (m,) is in force; m is at least 1."""
    place = np.searchsorted(stamps_s, time_s, side="right") - 1
    fresh_s = FRESH * float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else np.inf
    return (place >= 0) & (time_s - stamps_s[place] <= fresh_s)


def lean_towards(flight: ClockedLog, first_s: float, last_s: float) -> tuple[float, float] | None:
    """Forward and right components of the way it tipped between two times; None where it is not known."""
    found = up_axis(flight)
    if found is None:
        return None
    time_s, axis, _ = found
    inside = (time_s >= first_s) & (time_s <= last_s)
    if not inside.any():
        return None
    furthest = axis[inside][np.argmin(axis[inside][:, 2])]
    return -float(furthest[0]), -float(furthest[1])


def sink_speed(flight: ClockedLog) -> Column | None:
    """Downward speed in m/s, as the estimator gives it."""
    estimate = next((thing for name in ("XKF1", "NKF1") for thing in flight.things(name)[:1]), "XKF1")
    down = flight.quantity(f"{estimate}.VD", "vehicle_local_position.vz", unit="m/s", stated="m/s")
    if down is not None:
        return down
    up = flight.quantity("CTUN.CRt", "main.navVel[2]", unit="m/s", stated="cm/s")
    return None if up is None else Column(up.address, "m/s", up.time_s, -up.values)
