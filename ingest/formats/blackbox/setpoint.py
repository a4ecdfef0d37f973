"""What rates the pilot asked for, in logs of Betaflight before 4.0, which hold the sticks only.

    rc = stick / 500,  rc' = rc |rc|^3 expo + rc (1 - expo)
    rate = 200 rc' rc_rate / (1 - |rc| super_rate),  at most 1998 deg/s

with the rates of the header, in hundredths; an rc_rate above 2 counts 14.54 times beyond 2. From 4.0 on, the
log has the field `setpoint`.

Source: Betaflight 3.1 to 3.5, `fc_rc.c`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.ingest.formats.blackbox.header import Header
from flysid.stretch import FloatArray

STICK = 500.0
FULL_RATE = 200.0
STEEP_FROM = 2.0
STEEPER = 14.54
LIMIT = 1998.0
LEAST = 0.01


@dataclass(frozen=True)
class Rates:
    """Rates of one axis: rc_rate, expo and super rate as fractions."""

    rate: float
    expo: float
    super_rate: float

    def setpoint(self, stick: npt.NDArray[np.generic]) -> FloatArray:
        """(n,) deg/s of (n,) `rcCommand`.

        >>> Rates(1.0, 0.0, 0.7).setpoint(np.array([0, 250, -500])).round(1).tolist()
        [0.0, 153.8, -666.7]
        """
        rc = stick.astype(np.float64) / STICK
        size = np.abs(rc)
        curved = rc * size**3 * self.expo + rc * (1.0 - self.expo)
        rate = self.rate + max(0.0, self.rate - STEEP_FROM) * STEEPER
        steepness = np.clip(1.0 - size * self.super_rate, LEAST, 1.0)
        asked: FloatArray = np.clip(FULL_RATE * rate * curved / steepness, -LIMIT, LIMIT)
        return asked


def rates_of(header: Header) -> tuple[Rates, ...]:
    """Rates of roll, pitch and yaw; empty where the log holds setpoints itself, or its law is not known."""
    name, version = header.firmware
    if name != "betaflight" or not (3, 1) <= version < (4,):
        return ()
    rate = _per_axis(header, ("rc_rates", "rcRate", "rc_rate"), ("rcYawRate", "rc_rate_yaw", "rc_yaw_rate"))
    expo = _per_axis(header, ("rc_expo", "rcExpo"), ("rcYawExpo", "rc_expo_yaw", "rc_yaw_expo"))
    steep = header.numbers("rates")
    if not (len(rate) == len(expo) == len(steep) == 3):
        return ()
    return tuple(Rates(r / 100, e / 100, s / 100) for r, e, s in zip(rate, expo, steep, strict=True))


def _per_axis(header: Header, names: tuple[str, ...], yaw_names: tuple[str, ...]) -> tuple[float, ...]:
    """A setting of all three axes, or of roll and pitch together and of yaw."""
    found = header.numbers(*names)
    return found if len(found) == 3 else (*found, *found, *header.numbers(*yaw_names))
