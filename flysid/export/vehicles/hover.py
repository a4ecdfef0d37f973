"""How a vehicle hovers: what targets without its curve, or with drag of another law, are matched at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.errors import UsageError
from flysid.export.vehicles.body import hover_share
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import ARM, CURVE, DAMPING, INERTIA, ROTOR_DRAG, THRUST, effects
from flysid.stretch import FloatArray


@dataclass(frozen=True, eq=False)
class Hover:
    """All motors alike, neither climbing nor sinking.

    `command`: of every motor, as a share of full scale; `share`: of full thrust.
    `slope`: of the share by the command there.
    `damping`: (3,) 1/s of roll, pitch and yaw, by their own damping and by the air that hubs meet.
    """

    command: float
    share: float
    slope: float
    damping: FloatArray


def hover_of(vehicle: FittedVehicle) -> Hover:
    """The hover of a vehicle. Raises UsageError: it cannot hover."""
    theta = vehicle.theta
    curve = float(theta[CURVE])
    share = hover_share(vehicle) if theta[THRUST] > 0.0 else np.inf
    if share > 1.0:
        raise UsageError("this vehicle does not lift its weight at full thrust: no simulator could hover it")
    linear = 1.0 - curve
    command = share if curve == 0.0 else (np.sqrt(linear**2 + 4.0 * curve * share) - linear) / (2.0 * curve)
    root = float(np.sqrt(share))
    roll, pitch, _ = effects(theta)
    pitch = theta[INERTIA] * pitch
    drag = theta[ROTOR_DRAG : ROTOR_DRAG + 3]
    across, along = float(roll @ roll), float(pitch @ pitch)
    met = np.array(
        [
            drag[2] * across,
            drag[2] * along / theta[INERTIA],
            (drag[0] * across + drag[1] * along) / theta[INERTIA + 1],
        ]
    )
    own = theta[DAMPING : DAMPING + 3] * vehicle.motors
    damping = root * (own + theta[ARM] / theta[THRUST] * met)
    return Hover(float(command), share, linear + 2.0 * curve * float(command), damping)
