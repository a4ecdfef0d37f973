"""What the logs of simulated quadrotors hold, whatever their format: sensors' words, gains, rates.

Rates are those of a log made for tuning: accelerometers and rates at 400 Hz, others slower.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import signal

from bench.faulty_quadrotor import (
    DAMPING_S,
    GROUND_S,
    INTEGRAL,
    RATE_HZ,
    SECONDS,
    Flight,
)
from bench.faulty_sensors import EARTH_G
from flysid.dataset import FloatArray

Rows = npt.NDArray[np.void]
BEGIN_US = 20_000_000
AIR_S = (GROUND_S, SECONDS - GROUND_S)
DEGREE = 1e-7
EARTH_M = 6_371_000.0
HOME = (47.4, 8.5, 450.0)
FIELD_G = np.array([0.22, 0.01, 0.42])
LOITER, POSITION = 5, 2
ACRO, PX4_ACRO = 1, 10


def rate_gains(flight: Flight) -> dict[str, tuple[float, float, float]]:
    """Axis -> P, I and D of the rate loop, from rad/s to a share of the largest torque."""
    vehicle = flight.vehicle
    full = vehicle.mass_kg * 9.81 / (4.0 * vehicle.hover)
    inertia = 0.12 * vehicle.mass_kg * (2.0 * vehicle.arm_m) ** 2
    tilting = inertia / (full * vehicle.arm_m * np.sqrt(2.0))
    roll = vehicle.gain * vehicle.bandwidth_rad_s * tilting
    yaw = vehicle.yaw_rad_s * 1.8 * inertia / (2.0 * full * vehicle.torque_m)
    found = {"RLL": (roll, DAMPING_S), "PIT": (1.05 * roll, DAMPING_S), "YAW": (yaw, 0.0)}
    return {axis: (p, INTEGRAL * p, slope * p) for axis, (p, slope) in found.items()}


def vibration_level(accel: FloatArray) -> FloatArray:
    """(N, 3) as ArduPilot computes it: high-passed at 5 Hz, squared, low-passed at 2 Hz, root."""
    fast = accel - follow(accel, 5.0)
    level: FloatArray = np.sqrt(follow(fast**2, 2.0))
    return level


def follow(values: FloatArray, cutoff_hz: float) -> FloatArray:
    """A filter of first order along the first axis, at rest where the values begin."""
    step = 2.0 * np.pi * cutoff_hz / RATE_HZ
    found: FloatArray = values[:1] + signal.lfilter([step], [1.0, step - 1.0], values - values[:1], axis=0)
    return found


def clips(accel: FloatArray, limit: float = 156.0) -> npt.NDArray[np.int64]:
    """(N,) samples so far at the sensor's end."""
    found: npt.NDArray[np.int64] = np.cumsum((np.abs(accel) >= limit).any(axis=1))
    return found


def gps_ratio(flight: Flight) -> FloatArray:
    """(N,) how far the GPS lies from the estimate, over the gate of 5 standard deviations of half a metre."""
    ratio: FloatArray = np.linalg.norm(flight["gps"] - flight["position"], axis=1) / 2.5
    return ratio


def compass_ratio(flight: Flight) -> FloatArray:
    """(N,) how far the heading lies from the compass, over its gate: a wrong one is doubted, then taken."""
    vehicle = flight.vehicle
    since_s = flight.time_s - vehicle.strays_s
    strayed = (vehicle.strays_s > 0.0) & (since_s >= 0.0)
    return np.where(strayed, 0.06 + 1.4 * np.exp(-np.clip(since_s, 0.0, None) / 6.0), 0.06)


def geodetic(flight: Flight) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Latitude and longitude in degrees, and height in m, as the GPS receives them."""
    north, east, down = flight["gps"].T
    degree_m = np.radians(1.0) * EARTH_M
    east_m = degree_m * np.cos(np.radians(HOME[0]))
    return HOME[0] + north / degree_m, HOME[1] + east / east_m, HOME[2] - down


def magnetic_field(flight: Flight) -> FloatArray:
    """(N, 3) of the earth along the vehicle's axes, and a little of its wires."""
    roll, pitch, yaw = flight["attitude"].T
    x = np.cos(yaw) * FIELD_G[0] + np.sin(yaw) * FIELD_G[1]
    y = -np.sin(yaw) * FIELD_G[0] + np.cos(yaw) * FIELD_G[1]
    z = np.full(len(yaw), FIELD_G[2])
    tilted = np.stack([x - pitch * z, y + roll * z, z + pitch * x - roll * y], axis=1)
    of_wires = 0.0005 + flight.vehicle.wires * EARTH_G
    field: FloatArray = tilted + of_wires * flight["current"][:, None] * np.array([0.3, -0.2, 0.5])
    return field


def in_the_air(flight: Flight) -> npt.NDArray[np.bool_]:
    """(N,) whether it flies."""
    return (flight.time_s >= AIR_S[0]) & (flight.time_s < AIR_S[1])


def fill(rows: Rows, at: slice, values: Mapping[str, Any]) -> None:
    """Columns of rows from arrays over the flight, of which `at` is taken, or from numbers."""
    for label, value in values.items():
        column = value[at] if isinstance(value, np.ndarray) else value
        whole = np.issubdtype(rows.dtype[label].base, np.integer)
        rows[label] = np.round(column) if whole else column
