"""PX4's Simulation-In-Hardware: a parameter file with its SIH_ names, as QGroundControl loads it.

PX4 simulates four or six motors in its own places and order, a thrust that is linear in the output, one drag
for all axes that is linear in speed, and a damping. All is matched at hover. Exact where the curve is 0, the
frame is symmetric and drag is alike in all axes.
"""

from __future__ import annotations

import numpy as np

from flysid.errors import UsageError
from flysid.export.vehicles.body import ARM_M, MASS_KG, body_of
from flysid.export.vehicles.hover import hover_of
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import LAG
from flysid.stretch import FloatArray

_SIDE = np.sqrt(3.0) / 2.0
FRAMES = {
    4: (0, [(1, -1, -1), (-1, 1, -1), (1, 1, 1), (-1, -1, 1)]),
    6: (
        4,
        [
            (_SIDE, -0.5, -1),
            (0, -1, 1),
            (-_SIDE, -0.5, -1),
            (-_SIDE, 0.5, 1),
            (0, 1, -1),
            (_SIDE, 0.5, 1),
        ],
    ),
}
"""Motors -> SIH_VEHICLE_TYPE; (forward, left, turn about up) of every motor in PX4's order."""
REAL, WHOLE = 9, 6
"""MAVLink's types of parameters: float32 and int32."""
ALIKE = 0.5
"""Least cosine between a frame's places and those of PX4."""


def sih_parameters(
    vehicle: FittedVehicle, mass_kg: float = MASS_KG, arm_m: float = ARM_M
) -> dict[str, float]:
    """Name -> value, as PX4 documents them.

    Raises UsageError: mass or arm is not above zero; a number or an order of motors that PX4 does not
    simulate; a vehicle that cannot hover.
    """
    body = body_of(vehicle, mass_kg, arm_m)
    hover = hover_of(vehicle)
    kind, own, places, turns = _matched(body.places, body.yaw_nm)
    arms = [float(own[:, k] @ places[:, k] / (own[:, k] @ own[:, k])) for k in (0, 1)]
    speeds = float(np.sqrt(hover.share)) * vehicle.motors
    full = body.thrust_n * hover.share / hover.command
    steeper = hover.share / hover.command
    return {
        "SIH_VEHICLE_TYPE": kind,
        "SIH_MASS": body.mass_kg,
        "SIH_IXX": float(body.inertia[0]),
        "SIH_IYY": float(body.inertia[1]),
        "SIH_IZZ": float(body.inertia[2]),
        "SIH_IXY": 0.0,
        "SIH_IXZ": 0.0,
        "SIH_IYZ": 0.0,
        "SIH_T_MAX": full,
        "SIH_Q_MAX": float(np.mean(turns * own[:, 2])) * steeper,
        "SIH_L_ROLL": arms[1],
        "SIH_L_PITCH": arms[0],
        "SIH_KDV": float(np.mean(body.rotor_drag[:2])) * speeds,
        "SIH_KDW": float(np.mean(hover.damping * body.inertia)),
        "SIH_T_TAU": float(vehicle.theta[LAG]),
    }


def _matched(places: FloatArray, yaw: FloatArray) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """SIH_VEHICLE_TYPE, PX4's signs, and places and yaw torques in PX4's order of motors."""
    from scipy.optimize import linear_sum_assignment

    motors = len(places)
    if motors not in FRAMES:
        raise UsageError(f"PX4's SIH simulates four or six motors, not {motors}")
    kind, rows = FRAMES[motors]
    signs = np.array(rows, dtype=float)
    seen = np.column_stack([places, yaw])
    scaled = seen / np.maximum(np.sqrt(np.mean(seen**2, axis=0)), np.finfo(float).tiny)
    known = signs / np.sqrt(np.mean(signs**2, axis=0))
    _, order = linear_sum_assignment(-(known @ scaled.T))
    likeness = np.sum(known * scaled[order], axis=0) / motors
    if likeness.min() < ALIKE:
        raise UsageError(
            f"no order of these {motors} motors is PX4's frame of {motors}: they must stand and turn as in "
            "an X",
            hint="export for another target, or fit flights that determine all effects",
        )
    return kind, signs, places[order], yaw[order]


def sih_file(vehicle: FittedVehicle, mass_kg: float = MASS_KG, arm_m: float = ARM_M) -> str:
    """The file, as text; raises as `sih_parameters`."""
    rows = [
        f"1\t1\t{name}\t{value:.9g}\t{WHOLE if name == 'SIH_VEHICLE_TYPE' else REAL}"
        for name, value in sih_parameters(vehicle, mass_kg, arm_m).items()
    ]
    hover = hover_of(vehicle)
    head = [
        "# A vehicle identified by flysid, for PX4's Simulation-In-Hardware",
        f"# Matched at hover: commands of {hover.command:.3f}, which is MPC_THR_HOVER where THR_MDL_FAC is 0",
        "#",
        "# Vehicle-Id Component-Id Name Value Type",
    ]
    return "\n".join([*head, *rows]) + "\n"
