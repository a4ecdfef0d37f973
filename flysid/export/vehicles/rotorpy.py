"""RotorPy: the dictionary of parameters that `rotorpy.vehicles.multirotor.Multirotor` takes.

Commands are rotor speeds there, thrust goes with their square, and the lag is that of the speed. A vehicle
whose curve is 1 is the same. Of any other curve the command to give is `full sqrt(share)`, and the lag is
that of small changes. One k_d stands for forward and sideways drag, and one k_flap for roll and pitch.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flysid.export.vehicles.body import ARM_M, MASS_KG, body_of, with_trim_in_places
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import LAG

_HEAD = '''"""A vehicle identified by flysid, for rotorpy.vehicles.multirotor.Multirotor.

Speeds are in the unit of the logged commands: {full:g} is full scale. Mass and arm are {stated}.
"""

import numpy as np

quad_params = {{
{rows}
}}
'''


def rotorpy_parameters(
    vehicle: FittedVehicle, mass_kg: float = MASS_KG, arm_m: float = ARM_M
) -> dict[str, Any]:
    """Keys and values as RotorPy names them, arrays as NumPy's; raises as `body_of`."""
    body = body_of(vehicle, mass_kg, arm_m)
    full = vehicle.full
    places = with_trim_in_places(body, vehicle)
    yaw = float(np.mean(np.abs(body.yaw_nm)))
    return {
        "mass": body.mass_kg,
        "Ixx": float(body.inertia[0]),
        "Iyy": float(body.inertia[1]),
        "Izz": float(body.inertia[2]),
        "Ixy": 0.0,
        "Ixz": 0.0,
        "Iyz": 0.0,
        "num_rotors": vehicle.motors,
        "rotor_pos": {f"r{i + 1}": np.array([*place, 0.0]) for i, place in enumerate(places)},
        "rotor_directions": body.yaw_nm / yaw if yaw > 0.0 else np.zeros(vehicle.motors),
        "rI": np.zeros(3),
        "c_Dx": float(body.body_drag[0]),
        "c_Dy": float(body.body_drag[1]),
        "c_Dz": float(body.body_drag[2]),
        "k_eta": body.thrust_n / full**2,
        "k_m": yaw / full**2,
        "k_d": float(np.mean(body.rotor_drag[:2])) / full,
        "k_z": float(body.rotor_drag[2]) / full,
        "k_h": 0.0,
        "k_flap": float(body.lean[1] - body.lean[0]) / 2.0 / full,
        "tau_m": float(vehicle.theta[LAG]),
        "rotor_speed_min": 0.0,
        "rotor_speed_max": full,
        "motor_noise_std": 0.0,
    }


def rotorpy_source(vehicle: FittedVehicle, mass_kg: float = MASS_KG, arm_m: float = ARM_M) -> str:
    """A Python module that defines `quad_params`, as RotorPy's own vehicles do."""
    rows = [
        f"    {name!r}: {_literal(value)},"
        for name, value in rotorpy_parameters(vehicle, mass_kg, arm_m).items()
    ]
    stated = f"{mass_kg:g} kg and {arm_m:g} m"
    return _HEAD.format(full=vehicle.full, stated=stated, rows="\n".join(rows))


def _literal(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name!r}: {_literal(own)}" for name, own in value.items()) + "}"
    if isinstance(value, np.ndarray):
        return f"np.array({value.tolist()!r})"
    return repr(value)
