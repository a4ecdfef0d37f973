"""A vehicle in kilograms and metres: what simulators ask for, from ratios that flights determine.

Flights determine accelerations by commands, so mass and arm are free: any pair moves alike. What is stated
(weighed, measured) is taken; else a mass of 1 kg and an arm of 0.1 m stand for themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.errors import UsageError
from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import BODY_DRAG, INERTIA, LEAN, ROTOR_DRAG, THRUST, TRIM
from flysid.sixdof.rigid_body import GRAVITY
from flysid.stretch import FloatArray

MASS_KG = 1.0
ARM_M = 0.1


@dataclass(frozen=True, eq=False)
class Body:
    """A vehicle in SI units; axes forward, left, up.

    `thrust_n`: of a motor at full command.
    `inertia`: (3,) kg m^2.
    `places`: (motors, 2) m, forward and left of the centre of mass.
    `yaw_nm`: (motors,) N m about z at full command.
    `rotor_drag`: (3,) N s/m a motor at full speed; `body_drag`: (3,) N s^2/m^2.
    `lean`: (2,) N s a motor at full speed: roll from speed to the left, pitch from speed forward.
    `trim_nm`: (3,) N m that acts always.
    """

    mass_kg: float
    thrust_n: float
    inertia: FloatArray
    places: FloatArray
    yaw_nm: FloatArray
    rotor_drag: FloatArray
    body_drag: FloatArray
    lean: FloatArray
    trim_nm: FloatArray


def body_of(vehicle: FittedVehicle, mass_kg: float = MASS_KG, arm_m: float = ARM_M) -> Body:
    """The body that moves as the vehicle does.

    `mass_kg`: as weighed.
    `arm_m`: mean distance of motors from the centre of mass, seen from above.
    Raises UsageError: mass or arm is not above zero; the motors have no effect about roll or pitch.
    """
    if not (mass_kg > 0.0 and arm_m > 0.0):
        raise UsageError(f"mass {mass_kg:g} kg and arm {arm_m:g} m must be above zero")
    theta = vehicle.theta
    effects = layout.effects(theta)
    ratios = np.array([1.0, *theta[INERTIA : INERTIA + 2]])
    thrust = float(theta[THRUST]) * mass_kg
    shape = np.stack(
        [-effects[1] * ratios[1], effects[0]], axis=1
    )  # places at an inertia of 1 and a thrust of 1
    reach = float(np.mean(np.linalg.norm(shape, axis=1)))
    if not (reach > 0.0 and thrust > 0.0):
        raise UsageError("these motors neither lift nor turn: no body moves as this vehicle does")
    inertia = ratios * thrust * arm_m / reach
    return Body(
        mass_kg=mass_kg,
        thrust_n=thrust,
        inertia=inertia,
        places=shape * inertia[0] / thrust,
        yaw_nm=effects[2] * inertia[2],
        rotor_drag=theta[ROTOR_DRAG : ROTOR_DRAG + 3] * mass_kg,
        body_drag=theta[BODY_DRAG : BODY_DRAG + 3] * mass_kg,
        lean=theta[LEAN : LEAN + 2] * inertia[:2],
        trim_nm=theta[TRIM : TRIM + 3] * inertia,
    )


def hover_share(vehicle: FittedVehicle) -> float:
    """Thrust share of every motor at which the vehicle neither climbs nor sinks."""
    return GRAVITY / (vehicle.motors * float(vehicle.theta[THRUST]))


def with_trim_in_places(body: Body, vehicle: FittedVehicle) -> FloatArray:
    """(motors, 2) places, moved so that at hover they turn as trim does: for targets without trim."""
    lift = vehicle.motors * hover_share(vehicle) * body.thrust_n
    return np.asarray(body.places + np.array([-body.trim_nm[1], body.trim_nm[0]]) / lift)
