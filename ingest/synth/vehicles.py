"""What can be flown: each vehicle turns commands into the truth of a flight, in the paper's signs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.synth.dryden import Wind, wind_field
from flysid.ingest.synth.plants import LOOPS, fly

if TYPE_CHECKING:
    from flysid.ingest.synth.rigid_body import SimulatedVehicle

CHANGES = ("mass", "thrust", "drag", "lag")
# Spread of a fleet, as standard deviations of the logarithm.
SPREAD = {"mass_kg": 0.03, "thrust_factor": 0.03, "motor_lag_s": 0.1, "sag": 0.1}


@dataclass(frozen=True)
class Air:
    """What a flight meets.

    `wind`, `rng`: the wind, and the generator of its direction and turbulence.
    `vehicle`, `seed`: which of a fleet flies; the first is the nominal one, `seed` disperses the others.
    `altitude_m`: at the start.
    `without`: names of the effects that are switched off.
    `changes`: what has changed on this vehicle: a name of `CHANGES` and a factor.
    `step_s`: of the integration.
    """

    wind: Wind
    rng: np.random.Generator
    vehicle: int = 0
    seed: int = 0
    altitude_m: float = 20.0
    without: tuple[str, ...] = ()
    changes: tuple[tuple[str, float], ...] = ()
    step_s: float = 0.001


Truth = dict[str, FloatArray]


@dataclass(frozen=True)
class Flyer:
    """A vehicle: (commands (N, 3), period in seconds, air) -> truth at the same N times.

    `effects` can be switched off; a vehicle with any also feels the wind.
    """

    fly: Callable[[FloatArray, float, Air], Truth]
    effects: tuple[str, ...] = ()


def fly_linear(command: FloatArray, dt_s: float, _: Air, *, attitude_lag_s: float = 0.12) -> Truth:
    """The plants (10), (11), (12), from rest, uncoupled.

    Tilt is not part of those equations; it follows the command with a first-order lag of 0.12 s, so that the
    attitude messages have something to say. Position is the integral of velocity (trapezoidal).
    """
    truth = {loop.output: fly(loop, u, dt_s) for loop, u in zip(LOOPS.values(), command.T, strict=True)}
    keep = np.exp(-dt_s / attitude_lag_s)
    truth |= {name: _lag(u, keep) for name, u in zip(("theta", "phi"), command.T, strict=False)}
    truth["psi"] = np.zeros(len(command))
    for axis in "xyz":
        v = truth[f"v{axis}"]
        truth[axis] = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * dt_s / 2)])
    return truth


def fly_rigid_body(command: FloatArray, dt_s: float, air: Air) -> Truth:
    """The nonlinear AR.Drone, from hover; z is counted from there."""
    from flysid.ingest.synth.rigid_body import ALL, SimulatedVehicle, fly_vehicle

    vehicle = SimulatedVehicle(effects=replace(ALL, **dict.fromkeys(air.without, False)))
    if air.vehicle:
        vehicle = disperse(vehicle, np.random.default_rng([air.seed, air.vehicle, 2]))
    for name, factor in air.changes:
        vehicle = change(vehicle, name, factor)
    wind = replace(air.wind, towards_deg=float(air.rng.uniform(0.0, 360.0)))
    field = wind_field(wind, len(command), dt_s, air.altitude_m, air.rng)
    start = vehicle.hover(air.altitude_m)
    flown = fly_vehicle(
        vehicle, command, period_s=dt_s, record_s=dt_s, wind_m_s=field, start=start, step_s=air.step_s
    )
    return {**flown.series(), "z": flown.states[:, 2] - air.altitude_m}


def disperse(vehicle: SimulatedVehicle, rng: np.random.Generator) -> SimulatedVehicle:
    """The same type, another specimen: parameters spread by `SPREAD`, drag by 10 %, inertias by 3 %."""
    a = vehicle.airframe
    numbers = {
        name: getattr(a, name) * float(np.exp(s * rng.standard_normal())) for name, s in SPREAD.items()
    }
    drag, quad, inertia = (
        tuple(float(v) for v in np.asarray(values) * np.exp(s * rng.standard_normal(len(values))))
        for values, s in ((a.linear_drag_1_s, 0.1), (a.quadratic_drag_1_m, 0.1), (a.inertia_kg_m2, 0.03))
    )
    airframe = replace(
        a,
        **numbers,
        linear_drag_1_s=(drag[0], drag[1], drag[2]),
        quadratic_drag_1_m=(quad[0], quad[1]),
        inertia_kg_m2=(inertia[0], inertia[1], inertia[2]),
    )
    return replace(vehicle, airframe=airframe)


def change(vehicle: SimulatedVehicle, name: str, factor: float) -> SimulatedVehicle:
    """The vehicle after something, a name of `CHANGES`, of which its inner loop knows nothing."""
    a = vehicle.airframe
    drag = {"mass": 1.0 / factor, "drag": factor}.get(name, 1.0)  # drag is per mass
    x, y, z = a.linear_drag_1_s
    quad_xy, quad_z = a.quadratic_drag_1_m
    return replace(
        vehicle,
        airframe=replace(
            a,
            load=a.load * (factor if name == "mass" else 1.0),
            lift=a.lift * (factor if name == "thrust" else 1.0),
            motor_lag_s=a.motor_lag_s * (factor if name == "lag" else 1.0),
            linear_drag_1_s=(drag * x, drag * y, drag * z),
            quadratic_drag_1_m=(drag * quad_xy, drag * quad_z),
        ),
    )


def _lag(u: FloatArray, keep: float) -> FloatArray:
    """x[k+1] = keep x[k] + (1 - keep) u[k], from rest."""
    x = np.zeros(len(u))
    for k in range(len(u) - 1):
        x[k + 1] = keep * x[k] + (1.0 - keep) * u[k]
    return x


# Named here too, so that an order can be checked without compiling the vehicle; a test holds them equal.
EFFECTS = (
    "motor_lag",
    "motor_limits",
    "linear_drag",
    "quadratic_drag",
    "ground_effect",
    "battery_sag",
    "gyroscopic",
    "altitude_drop",
    "delay",
    "command_limits",
)

VEHICLES: Mapping[str, Flyer] = {
    "ardrone-linear": Flyer(fly_linear),
    "ardrone": Flyer(fly_rigid_body, EFFECTS),
}
