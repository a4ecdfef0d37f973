"""The battery's voltage as an input: commands act as much as a power of it says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError


def find_battery(inputs: Sequence[Signal]) -> int | None:
    """Which input is in volts. Raises UsageError: several are, or nothing else is there."""
    found = [j for j, signal in enumerate(inputs) if is_voltage(signal)]
    if len(found) > 1 or (found and len(inputs) == 1):
        raise UsageError(
            "a physical model takes commands, and one voltage of the battery at most",
            hint="give the voltage of one battery, or commands in another unit than V",
        )
    return found[0] if found else None


def is_voltage(signal: Signal) -> bool:
    return signal.unit == "V"


def voltage_of(u: FloatArray, battery: int | None, mean: FloatArray) -> FloatArray | None:
    """(N,) logarithm of the voltage over its mean in training; None where it is not measured."""
    if battery is None:
        return None
    least = 1e-6 * mean[battery]
    return np.asarray(np.log(np.maximum(u[:, battery], least) / mean[battery]))


def quieten(volts: FloatArray | None, longest: int = 12) -> FloatArray | None:
    """A voltage without its own noise, which would draw its power towards 0 (errors in variables).

    A level that wanders is known best from rows on both sides, weighed by theta^|k|, with the theta whose
    memory of earlier rows foretells the next one best (Harvey, Forecasting, Structural Time Series Models,
    1989, 4.5). A voltage that is held over several rows is foretold by the row before and stays as it is.

    `longest`: binary logarithm of the longest memory that is tried, rows.
    """
    if volts is None or len(volts) < 4:
        return volts
    thetas = 1.0 - 0.5 ** np.arange(longest + 1)
    missed = [float(np.sum((volts[1:] - _fade(volts, theta)[:-1]) ** 2)) for theta in thetas]
    theta = float(thetas[int(np.argmin(missed))])
    both = _fade(volts, theta) + _fade(volts[::-1], theta)[::-1] - (1.0 - theta) * volts
    return np.asarray(both / (1.0 + theta))


def _fade(values: FloatArray, theta: float) -> FloatArray:
    """(1 - theta) sum theta^k of earlier values, as if the first had stood before."""
    from scipy.signal import lfilter

    return np.asarray(lfilter([1.0 - theta], [1.0, -theta], values, zi=[theta * values[0]])[0])
