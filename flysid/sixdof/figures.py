"""The numbers of a fitted vehicle with intervals, and which flight would determine the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.sixdof import layout
from flysid.sixdof.layout import (
    ARM,
    BODY_DRAG,
    CURVE,
    DAMPING,
    DELAY,
    EFFECTS,
    INERTIA,
    LAG,
    LEAN,
    POWER,
    ROTOR_DRAG,
    THRUST,
    TRIM,
)
from flysid.stretch import FloatArray

Z95 = 1.959964
UNDETERMINED = 0.5
"""Of its scale, half an interval: then the flights do not determine a number."""
_SCALES = {CURVE: 1.0, POWER: 1.0}
"""Numbers that zero is an ordinary value of are held against these."""


@dataclass(frozen=True)
class VehicleNumber:
    """One number of the vehicle.

    Attributes
    ----------
    half_width : of its 95 % interval; NaN where it is held.
    is_determined : half the interval is small beside the value.
    reason : where it is not determined: why, or what it is held at.
    flight : where it is not determined: the flight that would tell.
    """

    name: str
    value: float
    unit: str
    half_width: float
    is_determined: bool
    reason: str = ""
    flight: str = ""

    def __str__(self) -> str:
        if self.is_determined:
            return f"{self.name} {self.value:.4g} +- {self.half_width:.2g} {self.unit}".rstrip()
        return f"{self.name}: not determined ({self.reason}); to find it, {self.flight}"


def figures_of(
    theta: FloatArray, covariance: FloatArray, inside: FloatArray, held: dict[int, str]
) -> tuple[VehicleNumber, ...]:
    """All numbers, in their order.

    Parameters
    ----------
    held : index -> why a number was not sought.
    """
    motors = (len(theta) - EFFECTS) // 3
    effects = layout.effects(theta)
    found = []
    for number in layout.numbers(motors):
        index = number.index
        value = float(theta[index])
        width = Z95 * float(np.sqrt(max(covariance[index, index], 0.0)))
        scale = abs(_SCALES.get(index, value))
        if index >= EFFECTS:
            axis = (index - EFFECTS) // motors
            scale = float(np.sqrt(np.mean(effects[axis] ** 2)))
        if TRIM <= index < DAMPING:
            scale = float(np.sqrt(np.mean(effects[index - TRIM] ** 2)))
        told = bool(inside[index]) and 0.0 < width <= UNDETERMINED * scale
        reason = "" if told else held.get(index, _why(inside[index], value, width, number.unit))
        found.append(
            VehicleNumber(
                number.name,
                value,
                number.unit,
                width if inside[index] else float("nan"),
                told,
                reason,
                "" if told else flight_that_tells(index),
            )
        )
    return tuple(found)


def _why(inside: bool, value: float, width: float, unit: str) -> str:
    if not inside:
        return f"at its limit, {value:.3g} {unit}".rstrip()
    return f"{value:.3g} +- {width:.2g} {unit}".rstrip()


_FLIGHTS: Sequence[tuple[range, str]] = (
    (range(LAG, DELAY + 1), "log motors and gyro at 200 Hz or more, with quick steps of roll and pitch"),
    (range(CURVE, CURVE + 1), "climb and descend: full thrust, then little"),
    (range(POWER, POWER + 1), "log the voltage, and fly from a full battery to an empty one"),
    (range(THRUST, THRUST + 1), "log velocities or the accelerometer"),
    (range(ROTOR_DRAG, BODY_DRAG), "log velocities, and fly to and fro at half speed and full speed"),
    (range(BODY_DRAG, TRIM), "log velocities, and fly twice as fast along this axis"),
    (range(TRIM, DAMPING), "hover for ten seconds"),
    (range(DAMPING, LEAN), "turn about this axis at several rates, for seconds"),
    (range(LEAN, INERTIA), "log velocities, and fly to and fro along this axis"),
    (range(ARM, EFFECTS), "turn about each axis at several rates, for seconds"),
    (range(INERTIA, ARM), "turn about two axes at once: quick circles while yawing"),
)


def flight_that_tells(index: int) -> str:
    """What to fly or log so that a number is determined."""
    for places, flight in _FLIGHTS:
        if index in places:
            return flight
    return "fly quick steps about this axis"
