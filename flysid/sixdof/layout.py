"""The numbers of a vehicle: their order, names, units and physical limits.

Axes are forward, left, up; the world's z points up. Of every motor i, x_i is the command after delay and lag,
and s_i = (1 - curve) x_i + curve x_i^2 what it lifts as a share of full thrust at the reference voltage:

    lag dx_i/dt = u_i(t - delay) (V / V_ref)^power - x_i
    specific force = thrust sum(s) z - (rotor drag sum(sqrt(s)) + body drag |w|) w,   w: air speed, body axes
    dω/dt = effects s + trim + sum(sqrt(s)) ((lean_roll w_y, lean_pitch w_x, 0) - damping ω)
            + gyroscopic torque + torque of the rotors' drag, which acts at their hubs

A hub lies (-arm ratio pitch, arm roll) forward and left of the centre of mass, where pitch and roll are its
motor's effects, ratio is the inertia's of pitch over roll, and arm is a number of its own: the air that a hub
meets as the vehicle turns damps.

sqrt(s) is a rotor's speed as a share of its speed at full thrust.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.stretch import FloatArray

LAG, DELAY, CURVE, POWER, THRUST = range(5)
ROTOR_DRAG, BODY_DRAG, TRIM, DAMPING = 5, 8, 11, 14
LEAN, INERTIA, ARM = 17, 19, 21
EFFECTS = 22
"""Where groups begin; the effects of motors about roll, then pitch, then yaw stand last."""
AXES = ("roll", "pitch", "yaw")
LETTERS = ("x", "y", "z")

_UNITS = {
    "motor lag": "s",
    "delay": "s",
    "thrust curve": "",
    "voltage power": "",
    "thrust of a motor": "m/s^2",
}
LIMITS = {
    LAG: (0.001, 0.5),
    DELAY: (0.0, 0.2),
    CURVE: (0.0, 1.0),
    POWER: (0.0, 3.0),
    THRUST: (0.0, np.inf),
    **{ROTOR_DRAG + i: (0.0, np.inf) for i in range(3)},
    **{BODY_DRAG + i: (0.0, np.inf) for i in range(3)},
    **{DAMPING + i: (0.0, np.inf) for i in range(3)},
    **{INERTIA + i: (0.2, 5.0) for i in range(2)},
    ARM: (0.0, np.inf),
}
"""What a multirotor can be: nothing acts before its command, and air never drives it."""


@dataclass(frozen=True)
class Number:
    """One of the numbers: its name, unit, and place."""

    name: str
    unit: str
    index: int


def numbers(motors: int) -> tuple[Number, ...]:
    """All numbers of a vehicle with so many motors, in their order."""
    rows = [*_UNITS.items()]
    rows += [(f"rotor drag {letter}", "1/s") for letter in LETTERS]
    rows += [(f"body drag {letter}", "1/m") for letter in LETTERS]
    rows += [(f"{axis} trim", "rad/s^2") for axis in AXES]
    rows += [(f"{axis} damping", "1/s") for axis in AXES]
    rows += [("roll from sideways speed", "rad/s/m"), ("pitch from forward speed", "rad/s/m")]
    rows += [("inertia pitch / roll", ""), ("inertia yaw / roll", "")]
    rows += [("arm by effect", "m s^2/rad")]
    rows += [(f"{axis} of motor {i + 1}", "rad/s^2") for axis in AXES for i in range(motors)]
    return tuple(Number(name, unit, index) for index, (name, unit) in enumerate(rows))


def count(motors: int) -> int:
    """How many numbers a vehicle with so many motors has."""
    return EFFECTS + 3 * motors


def effects(theta: FloatArray) -> FloatArray:
    """(3, motors) angular acceleration about roll, pitch, yaw by every motor at full thrust."""
    return theta[EFFECTS:].reshape(3, -1)


def limits(motors: int) -> tuple[FloatArray, FloatArray]:
    """Least and largest value of every number."""
    low = np.full(count(motors), -np.inf)
    high = np.full(count(motors), np.inf)
    for index, (least, most) in LIMITS.items():
        low[index] = least
        high[index] = most
    return low, high
