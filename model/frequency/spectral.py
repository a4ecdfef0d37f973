"""What every way of measuring a frequency response shares: its frequencies, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.polynomials import ComplexArray


@dataclass(frozen=True, eq=False)
class Spectral:
    """What a way of measuring returns, signals in units of their standard deviations.

    The attributes mean what they mean in `flysid.model.frequency.response.MeasuredResponse`.
    """

    omega: FloatArray
    response: ComplexArray
    coherence: FloatArray
    error: FloatArray
    averages: FloatArray
    freedom: FloatArray
    correlation: FloatArray


def highest_frequency(dt_s: float) -> float:
    """0.8 of the Nyquist frequency, rad/s: above, what was sampled is mostly folded."""
    return 0.8 * np.pi / dt_s


def grid(lowest: float, dt_s: float, points: int, band: tuple[float, float] | None) -> FloatArray:
    """(points,) frequencies in rad/s, equally spaced in log omega, within what the data tell and `band`.

    Raises UsageError: the band holds none of them.
    """
    highest = highest_frequency(dt_s)
    low, high = (lowest, highest) if band is None else (max(lowest, band[0]), min(highest, band[1]))
    if not low < high:
        asked = (lowest, highest) if band is None else band
        raise UsageError(
            f"no frequency between {asked[0]:.3g} and {asked[1]:.3g} rad/s can be measured",
            hint=f"another band, or none; these data reach from {lowest:.3g} to {highest:.3g} rad/s",
        )
    return np.asarray(np.geomspace(low, high, points))
