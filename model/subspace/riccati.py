"""The stationary gain of the Kalman predictor."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.linear.data import EXACT


def kalman_gain(a: FloatArray, c: FloatArray, q: FloatArray, s: FloatArray, r: FloatArray) -> FloatArray:
    """(n, n_y) stationary gain of the predictor for process noise q, output noise r and cross covariance s.

    Zero where the Riccati equation has no stabilising solution (no noise reaches an unstable state).
    """
    from scipy.linalg import solve_discrete_are

    n = len(a)
    floor = EXACT**2
    try:
        p = solve_discrete_are(a.T, c.T, q + floor * np.eye(n), r + floor * np.eye(len(c)), s=s)
    except (np.linalg.LinAlgError, ValueError):
        return np.zeros((n, len(c)))
    gain: FloatArray = np.linalg.solve((c @ p @ c.T + r + floor * np.eye(len(c))).T, (a @ p @ c.T + s).T).T
    return gain
