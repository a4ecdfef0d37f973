"""ArduPilot's simulator: the model that `--model FRAME:vehicle.json` of its SITL loads.

ArduPilot's thrust curve, rotor drag (momentum drag) and body drag are those of flysid. Yaw torque grows there
with thrust times command, and is matched at hover. Motors have no lag there, and air that streams into the
rotors takes thrust away. One damping stands for all axes.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from flysid.export.vehicles.body import ARM_M, MASS_KG, Body, body_of, with_trim_in_places
from flysid.export.vehicles.hover import hover_of
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import CURVE
from flysid.sixdof.records import PULSES
from flysid.sixdof.rigid_body import GRAVITY

OWN_GRAVITY = 9.80665
"""m/s^2, as ArduPilot has it."""
AIR = 1.225
"""kg/m^3 at the altitude and temperature that the file states."""
GAS, PRESSURE = 287.26, 101325.0
KELVIN = 273.15
REFERENCE_SPEED = 10.0
"""m/s at which the drag is stated."""
YAW_ARM = 0.05
"""Of the diameter: ArduPilot's yaw torque by thrust and command."""
TURNED = 400.0
"""deg/s by which ArduPilot's damping is stated."""
CELL_V = 4.2


def frame_model(vehicle: FittedVehicle, mass_kg: float = MASS_KG, arm_m: float = ARM_M) -> dict[str, Any]:
    """Keys and values as ArduPilot names them.

    Raises UsageError: mass or arm is not above zero; a vehicle that cannot hover.
    """
    body = body_of(vehicle, mass_kg, arm_m)
    hover = hover_of(vehicle)
    wide = 2.0 * arm_m
    rotors = np.pi * (arm_m / 2.0) ** 2 * vehicle.motors
    drag = float(np.mean(body.rotor_drag[:2]))
    gain = drag / np.sqrt(body.thrust_n * AIR * rotors / vehicle.motors)
    yaw = body.yaw_nm * hover.slope / (YAW_ARM * wide * body.thrust_n)
    yaw /= hover.share + hover.command * hover.slope
    damping = float(np.mean(hover.damping))
    pulses = vehicle.zero >= PULSES[0] and vehicle.zero + vehicle.full <= PULSES[1]
    zero, full = (vehicle.zero, vehicle.full) if pulses else (1000.0, 1000.0)
    known = np.isfinite(vehicle.reference_v)
    volts = vehicle.reference_v if known else 3.0 * CELL_V
    blown = np.sqrt(body.mass_kg * OWN_GRAVITY / (0.5 * AIR * rotors))
    model: dict[str, Any] = {
        "mass": body.mass_kg,
        "diagonal_size": wide,
        "refSpd": REFERENCE_SPEED,
        "refAngle": _angle_deg(body, gain, rotors),
        "refVoltage": volts,
        "refCurrent": 0.5 * body.mass_kg * OWN_GRAVITY * blown / volts,
        "refAlt": 0.0,
        "refTempC": PRESSURE / (GAS * AIR) - KELVIN,
        "refBatRes": 0.0,
        "maxVoltage": volts,
        "battCapacityAh": 0.0,
        "propExpo": float(vehicle.theta[CURVE]),
        "refRotRate": float(np.radians(TURNED)) / damping if damping > 0.0 else 0.0,
        "hoverThrOut": hover.share * OWN_GRAVITY / GRAVITY,
        "pwmMin": zero,
        "pwmMax": zero + full,
        "spin_min": 0.0,
        "spin_max": 1.0,
        "slew_max": 0.0,
        "disc_area": rotors,
        "mdrag_coef": float(gain),
        "moment_inertia": body.inertia.tolist(),
        "num_motors": vehicle.motors,
    }
    for i, place in enumerate(with_trim_in_places(body, vehicle)):
        model[f"motor{i + 1}_position"] = [float(place[0]), -float(place[1]), 0.0]
        model[f"motor{i + 1}_yaw"] = -float(yaw[i])  # about down
    return model


def _angle_deg(body: Body, gain: float, rotors: float) -> float:
    """The lean at which thrust holds the reference speed: how ArduPilot is given the drag."""
    from scipy.optimize import brentq

    weight = body.mass_kg * OWN_GRAVITY
    drag = float(np.mean(body.body_drag[:2])) * REFERENCE_SPEED**2

    def left(angle: float) -> float:
        lean = np.cos(angle)
        momentum = lean * gain * REFERENCE_SPEED * lean * np.sqrt(weight / lean * AIR * rotors)
        return float(weight * np.tan(angle) - momentum - drag)

    return float(np.degrees(brentq(left, 0.0, np.radians(89.9))))


def frame_file(vehicle: FittedVehicle, mass_kg: float = MASS_KG, arm_m: float = ARM_M) -> str:
    """The file, as text; raises as `frame_model`."""
    return json.dumps(frame_model(vehicle, mass_kg, arm_m), indent=1, allow_nan=False) + "\n"
