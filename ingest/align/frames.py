"""Attitudes and frames: Euler angles of quaternions, and the heading frame.

Conventions
-----------
Quaternions are (w, x, y, z), Hamilton, and rotate a vector from the body frame to the earth frame.
Euler angles are yaw, pitch, roll about z, y', x'' (aerospace order). The heading frame is the earth frame
turned by yaw about the vertical: "forward" is where the nose points on the map. All angles are radians.

SciPy's Rotation refuses a quaternion of length zero, which real logs hold before an estimator is ready; here
such a row is NaN and costs one sample.

Source: Diebel (2006), "Representing Attitude", equations 125, 289 and 290.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from flysid.stretch import FloatArray


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


def forward_of(north: npt.ArrayLike, east: npt.ArrayLike, yaw: npt.ArrayLike) -> FloatArray:
    """(N,) component along the heading; yaw clockwise from north (NED)."""
    return np.asarray(np.asarray(north) * np.cos(yaw) + np.asarray(east) * np.sin(yaw), dtype=np.float64)


def right_of(north: npt.ArrayLike, east: npt.ArrayLike, yaw: npt.ArrayLike) -> FloatArray:
    """(N,) component to the right of the heading; yaw clockwise from north (NED)."""
    return np.asarray(np.asarray(east) * np.cos(yaw) - np.asarray(north) * np.sin(yaw), dtype=np.float64)
