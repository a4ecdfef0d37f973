"""Attitudes and frames: quaternions, Euler angles, NED and ENU, FRD and FLU, the heading frame.

Conventions
-----------
Quaternions are (w, x, y, z), Hamilton, and rotate a vector from the body frame to the earth frame.
Euler angles are yaw, pitch, roll about z, y', x'' (aerospace order). Earth frames: NED (MAVLink,
PX4, ArduPilot) and ENU (ROS, motion capture). Body frames: FRD (forward, right, down) and FLU (forward,
left, up). The heading frame is the earth frame turned by yaw about the vertical: "forward" is where the
nose points on the map. All angles are radians.

Source: Diebel (2006), "Representing Attitude", equations 125, 289 and 290.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def unit_quaternion(q: npt.ArrayLike) -> FloatArray:
    """(N, 4) quaternions scaled to length one; rows of length zero or not finite become NaN."""
    array = np.atleast_2d(np.asarray(q, dtype=np.float64))
    length = np.linalg.norm(array, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(length > 0, array / length, np.nan))


def roll_of(q: npt.ArrayLike) -> FloatArray:
    """(N,) roll of (N, 4) quaternions, in (-pi, pi]."""
    w, x, y, z = unit_quaternion(q).T
    return np.asarray(np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))


def pitch_of(q: npt.ArrayLike) -> FloatArray:
    """(N,) pitch of (N, 4) quaternions, in [-pi/2, pi/2]; nose up is positive in FRD, negative in FLU."""
    w, x, y, z = unit_quaternion(q).T
    return np.asarray(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)))


def yaw_of(q: npt.ArrayLike) -> FloatArray:
    """(N,) yaw of (N, 4) quaternions, in (-pi, pi]; clockwise from above in NED/FRD, counter in ENU/FLU."""
    w, x, y, z = unit_quaternion(q).T
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def quaternion_of(roll: npt.ArrayLike, pitch: npt.ArrayLike, yaw: npt.ArrayLike) -> FloatArray:
    """(N, 4) quaternions of Euler angles; the inverse of `roll_of`, `pitch_of`, `yaw_of`."""
    angles = (np.atleast_1d(np.asarray(a, dtype=np.float64)) / 2.0 for a in (roll, pitch, yaw))
    half_r, half_p, half_y = np.broadcast_arrays(*angles)
    cr, sr, cp, sp = np.cos(half_r), np.sin(half_r), np.cos(half_p), np.sin(half_p)
    cy, sy = np.cos(half_y), np.sin(half_y)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )


def earth_from_body(q: npt.ArrayLike, v: npt.ArrayLike) -> FloatArray:
    """(N, 3) vectors in the earth frame, from (N, 3) vectors in the body frame."""
    unit, vector = unit_quaternion(q), np.atleast_2d(np.asarray(v, dtype=np.float64))
    w, axis = unit[:, :1], unit[:, 1:]
    turn = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * turn + np.cross(axis, turn))


def body_from_earth(q: npt.ArrayLike, v: npt.ArrayLike) -> FloatArray:
    """(N, 3) vectors in the body frame, from (N, 3) vectors in the earth frame."""
    return earth_from_body(np.asarray(q, dtype=np.float64) * (1.0, -1.0, -1.0, -1.0), v)


def flu_from_frd(v: npt.ArrayLike) -> FloatArray:
    """(N, 3) vectors or body rates in forward-left-up, from forward-right-down; its own inverse."""
    return np.asarray(np.atleast_2d(np.asarray(v, dtype=np.float64)) * (1.0, -1.0, -1.0))


def enu_from_ned(v: npt.ArrayLike) -> FloatArray:
    """(N, 3) vectors in east-north-up, from north-east-down; its own inverse."""
    array = np.atleast_2d(np.asarray(v, dtype=np.float64))
    return np.stack([array[:, 1], array[:, 0], -array[:, 2]], axis=1)


def forward_of(north: npt.ArrayLike, east: npt.ArrayLike, yaw: npt.ArrayLike) -> FloatArray:
    """(N,) component along the heading; yaw clockwise from north (NED)."""
    return np.asarray(np.asarray(north) * np.cos(yaw) + np.asarray(east) * np.sin(yaw), dtype=np.float64)


def right_of(north: npt.ArrayLike, east: npt.ArrayLike, yaw: npt.ArrayLike) -> FloatArray:
    """(N,) component to the right of the heading; yaw clockwise from north (NED)."""
    return np.asarray(np.asarray(east) * np.cos(yaw) - np.asarray(north) * np.sin(yaw), dtype=np.float64)
