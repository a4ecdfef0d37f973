"""A second-order plant whose output slows itself down: one flight of it."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray


def flight(n: int, seed: int, gain: float = 0.1, noise: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """(N,) random steps of ten samples and (N,) the measured response."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, n // 10 + 1), 10)[:n]
    y = np.zeros(n)
    for k in range(2, n):
        y[k] = 1.5 * y[k - 1] - 0.6 * y[k - 2] + gain * u[k - 1] - 0.08 * y[k - 1] * abs(y[k - 1])
    return u, y + noise * rng.standard_normal(n)
