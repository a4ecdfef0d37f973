"""Rules on what physics leaves: beyond a threshold of a quantity, a base acts more, or less, than it says.

A rule adds base * (plain + slope * max(0, quantity - above)) to one of six accelerations: Takagi and Sugeno's
rules with two sets of one variable, whose consequents meet at the threshold. From zero on it is a polynomial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.sixdof.layout import AXES
from flysid.stretch import FloatArray

FORWARD, LEFT, UP, ROLL, PITCH, YAW = range(6)
"""Accelerations: specific forces in body axes, then those about them."""
SIZE = 6


@dataclass(frozen=True, eq=False)
class Conditions:
    """Under which a vehicle flies, n times.

    Attributes
    ----------
    air : (n, 3) velocity in body axes.
    lift : (n,) specific force by motors, m/s^2; torque : (n, 3) angular acceleration by them.
    height : (n,) m above the lowest place of the flight.
    """

    air: FloatArray
    lift: FloatArray
    torque: FloatArray
    height: FloatArray

    def __getitem__(self, rows: slice) -> Conditions:
        """Some of the times."""
        return Conditions(self.air[rows], self.lift[rows], self.torque[rows], self.height[rows])


@dataclass(frozen=True)
class Quantity:
    """What rules depend on: how it is read, its unit; words for any value of it, and beyond a threshold."""

    read: Callable[[Conditions], FloatArray]
    unit: str
    any_value: str
    beyond: str


SPEED, LIFT, TORQUE = "speed", "lift", "torque"
"""Bases: speed along the axis that a force acts along, or that a turn follows from; what motors do."""
_TURNED_BY = {FORWARD: 0, LEFT: 1, UP: 2, ROLL: 1, PITCH: 0}
QUANTITIES: Mapping[str, Quantity] = {
    "forward": Quantity(lambda c: np.abs(c.air[:, 0]), "m/s", "forward or back", "above {} forward or back"),
    "aside": Quantity(lambda c: np.abs(c.air[:, 1]), "m/s", "to either side", "above {} to either side"),
    "across": Quantity(
        lambda c: np.hypot(c.air[:, 0], c.air[:, 1]), "m/s", "across the rotors", "above {} across the rotors"
    ),
    "climb": Quantity(lambda c: np.maximum(c.air[:, 2], 0.0), "m/s", "in climbs", "in climbs faster than {}"),
    "sink": Quantity(
        lambda c: np.maximum(-c.air[:, 2], 0.0), "m/s", "in descents", "in descents faster than {}"
    ),
    "low": Quantity(lambda c: -c.height, "m", "near the ground", "below {} from the lowest place"),
    "hard": Quantity(lambda c: c.lift, "m/s^2", "the harder motors lift", "above a thrust of {}"),
}
_MOTORS_BY = ("across", "climb", "sink", "low")
CANDIDATES: Mapping[int, Mapping[str, Sequence[str]]] = {
    FORWARD: {SPEED: ("forward",)},
    LEFT: {SPEED: ("aside",)},
    UP: {SPEED: ("climb", "sink"), LIFT: (*_MOTORS_BY, "hard")},
    ROLL: {SPEED: ("aside",), TORQUE: _MOTORS_BY},
    PITCH: {SPEED: ("forward",), TORQUE: _MOTORS_BY},
    YAW: {TORQUE: _MOTORS_BY},
}
"""Acceleration -> base -> quantities that may change what it does."""


def base_of(conditions: Conditions, axis: int, base: str) -> FloatArray:
    """(n,) what a rule about an acceleration scales."""
    if base == LIFT:
        return conditions.lift
    if base == TORQUE:
        return np.asarray(conditions.torque[:, axis - ROLL])
    return np.asarray(conditions.air[:, _TURNED_BY[axis]])


@dataclass(frozen=True)
class HingeRule:
    """One rule.

    Attributes
    ----------
    axis : which acceleration; base, quantity : see `CANDIDATES`.
    above : threshold of the quantity.
    plain : of the base at any value of the quantity; slope : beyond the threshold, up to `reach`.
    reach : the quantity where it is large in these flights. Nothing is known, and nothing grows, beyond it.
    """

    axis: int
    base: str
    quantity: str
    above: float
    plain: float
    slope: float
    reach: float

    def __call__(self, conditions: Conditions) -> FloatArray:
        """(n,) acceleration, in m/s^2 or rad/s^2."""
        beyond = hinge(conditions, self.quantity, self.above, self.reach)
        return np.asarray(base_of(conditions, self.axis, self.base) * (self.plain + self.slope * beyond))

    def __str__(self) -> str:
        quantity = QUANTITIES[self.quantity]
        change = self.slope * (self.reach - self.above)
        reach = abs(self.reach)
        at = f"at {reach:.2g} {quantity.unit}"
        where = (
            quantity.beyond.format(f"{abs(self.above):.2g} {quantity.unit}")
            if self.above
            else quantity.any_value
        )
        if self.base != SPEED:
            what = "thrust" if self.base == LIFT else f"the motors' {AXES[self.axis - ROLL]} torque"
            turn = "grows" if change > 0.0 else "falls"
            return f"{where} {what} {turn}: {100.0 * change / (1.0 + self.plain):+.2g} % {at}"
        if self.axis >= ROLL:
            return f"{where} speed turns it in {AXES[self.axis - ROLL]}: {change * reach:+.2g} rad/s^2 {at}"
        law = "drag grows with the square" if change < 0.0 else "drag grows less than speed does"
        return f"{where} {law}: {-change * reach:+.2g} m/s^2 {at}"


def hinge(conditions: Conditions, quantity: str, above: float, reach: float) -> FloatArray:
    """(n,) how far a quantity is above a threshold: 0 below it, and no more than at its reach."""
    return np.asarray(np.clip(QUANTITIES[quantity].read(conditions), above, reach) - above)


def add_up(rules: Sequence[HingeRule], conditions: Conditions) -> FloatArray:
    """(n, 6) what rules add to the accelerations."""
    found = np.zeros((len(conditions.air), SIZE))
    for rule in rules:
        found[:, rule.axis] += rule(conditions)
    return found
