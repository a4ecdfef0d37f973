"""From commands to thrust shares: voltage, delay, lag and curve, with exact derivatives by each of them.

Commands are held from sample to sample, so that a motor's speed is exact at any delay. It is given at every
half sample, where a Runge-Kutta step needs it.
"""

from __future__ import annotations

import math

import numpy as np

from flysid.compiling import njit
from flysid.sixdof.layout import CURVE, DELAY, LAG, POWER
from flysid.stretch import FloatArray

CHAIN = (LAG, DELAY, CURVE, POWER)
"""By what shares are differentiated, in this order."""


@njit(cache=True)
def _follow(pushed, pushed_power, dt, lag, delay):  # type: ignore[no-untyped-def]
    """(2N - 1, m) motor speeds at half samples; (3, 2N - 1, m) their derivatives by lag, delay and power."""
    n, m = pushed.shape
    half = 0.5 * dt
    fade = math.exp(-half / lag)
    x = np.empty((2 * n - 1, m))
    by = np.zeros((3, 2 * n - 1, m))
    x[0] = pushed[0]
    by[2, 0] = pushed_power[0]
    for j in range(2 * n - 2):
        before = (j * half - delay) / dt
        after = ((j + 1) * half - delay) / dt
        first = max(math.floor(before - 1e-9), 0)  # a switch at the very beginning counts here
        last = max(math.ceil(after - 1e-9) - 1, 0)
        rest = half if last == first else (j + 1) * half - delay - last * dt
        late = math.exp(-rest / lag)
        for i in range(m):
            a = pushed[first, i]
            b = pushed[last, i]
            x[j + 1, i] = x[j, i] * fade + a * (late - fade) + b * (1.0 - late)
            by[0, j + 1, i] = by[0, j, i] * fade + ((x[j, i] - a) * fade * half + (a - b) * late * rest) / (
                lag * lag
            )
            by[1, j + 1, i] = by[1, j, i] * fade
            if last != first:
                by[1, j + 1, i] += (a - b) * late / lag
            by[2, j + 1, i] = (
                by[2, j, i] * fade
                + pushed_power[first, i] * (late - fade)
                + pushed_power[last, i] * (1.0 - late)
            )
    return x, by


def shares(
    commands: FloatArray, log_voltage: FloatArray, dt_s: float, theta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Thrust shares of motors at every half sample, and their derivatives.

    Parameters
    ----------
    commands : (N, motors) shares of full scale, held from sample to sample.
    log_voltage : (N,) logarithm of the voltage over the reference's; zeros where none is measured.

    Returns
    -------
    (2N - 1, motors) shares; (4, 2N - 1, motors) derivatives by the numbers of `CHAIN`.
    """
    factor = np.exp(theta[POWER] * log_voltage)[:, None]
    pushed = commands * factor
    x, by = _follow(pushed, pushed * log_voltage[:, None], dt_s, theta[LAG], theta[DELAY])
    curve = theta[CURVE]
    slope = (1.0 - curve) + 2.0 * curve * x
    found = (1.0 - curve) * x + curve * x**2
    return found, np.stack([slope * by[0], slope * by[1], x**2 - x, slope * by[2]])


def interval_means(halves: FloatArray) -> FloatArray:
    """(..., N - 1, m) means over every sample interval of what is known at half samples (Simpson's rule)."""
    return np.asarray((halves[..., :-2:2, :] + 4.0 * halves[..., 1:-1:2, :] + halves[..., 2::2, :]) / 6.0)
