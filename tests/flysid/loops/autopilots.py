"""Rate loops of PX4 and ArduPilot whose margins are known, in logs as they keep them."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
from numba import njit

from flysid.dataset import FloatArray
from tests.flysid.loops.simulated import Vehicle

STEP_S = 0.001
PX4 = {"K": 1.0, "P": 0.15, "I": 0.2, "D": 0.003, "FF": 0.0}
ARDUPILOT = {"P": 0.135, "I": 0.135, "D": 0.0036, "FLTT": 20.0, "FLTE": 0.0, "FLTD": 20.0, "FF": 0.0}
VEHICLE = Vehicle(1.0, 0.04, 8)
"""From thousandths of the output to deg/s; its delay in steps of half a millisecond."""


@dataclass
class Log:
    """As much of a stored log as the loops read."""

    name: str
    tables: dict[str, dict[str, Any]]
    info: dict[str, str] = field(default_factory=dict)

    @property
    def rows(self) -> dict[str, int]:
        return dict.fromkeys(self.tables, 1)

    @property
    def facts(self) -> Any:
        return SimpleNamespace(streams=dict.fromkeys(self.tables, 1), info=self.info)

    def columns(self, stream: str) -> list[str]:
        return list(self.tables[stream])

    def table(self, stream: str, columns: list[str]) -> pa.Table:
        return pa.table({name: self.tables[stream][name] for name in columns})


def signals(
    kind: str,
    seconds: float,
    seed: int,
    *,
    rate_hz: float = 100.0,
    outer: float = 0.0,
    stick: float = 60.0,
    disturbance: float = 20.0,
    noise: float = 0.5,
    vehicle: Vehicle = VEHICLE,
) -> FloatArray:
    """(4, N) setpoint, output (thousandths), rate, sticks; with `outer`, 1/s, an angle loop."""
    rng = np.random.default_rng(seed)
    n = round(seconds / STEP_S)
    held = np.repeat(rng.standard_normal(n // 60 + 1), rng.integers(60, 500, n // 60 + 1))[:n]
    box = np.ones(30) / 30.0
    sticks = stick * np.convolve(np.convolve(held, box, "same"), box, "same")
    if outer > 0.0:
        sticks = sticks / outer  # an angle whose error asks for rates of the same size
    d = disturbance * np.convolve(rng.standard_normal(n), np.ones(50) / 7.0, "same")
    unit = np.pi / 180.0 * 1000.0
    if kind == "px4":
        g = PX4
        law = np.array(
            [unit * g["K"] * g["P"], unit * g["K"] * g["I"], unit * g["K"] * g["D"], 0.0, 0.0, 30.0]
        )
    else:
        g = ARDUPILOT
        law = np.array([unit * g["P"], unit * g["I"], unit * g["D"], 1.0, g["FLTT"], g["FLTD"]])
    numbers = np.array([vehicle.gain, vehicle.lag_s, outer])
    delay = vehicle.delay_steps // 2
    r, u, y = _fly(sticks, d, noise * rng.standard_normal(n), law, numbers, delay)
    every = round(1.0 / (rate_hz * STEP_S))
    return np.stack([r, u, y, sticks])[:, ::every]


def px4_log(
    seconds: float = 90.0, seed: int = 1, changed: dict[str, float] | None = None, **flight: Any
) -> Log:
    """A PX4 flight of its roll axis."""
    r, u, y, asked = signals("px4", seconds, seed, **flight)
    rate_hz = flight.get("rate_hz", 100.0)
    time = (np.arange(len(r)) * 1e9 / rate_hz).astype(np.int64)
    none = np.zeros(len(r))
    angle = 0.5 * np.radians(asked if flight.get("outer") else none)
    turns = np.stack([np.cos(angle), np.sin(angle), none, none], 1)
    names = {f"MC_ROLLRATE_{k}": v for k, v in PX4.items()} | {"IMU_DGYRO_CUTOFF": 30.0} | (changed or {})
    defaults = dict.fromkeys(names, 9.0)
    count = len(names)
    return Log(
        "px4",
        {
            "vehicle_rates_setpoint": {"time_ns": time, "roll": np.radians(r)},
            "vehicle_torque_setpoint": {
                "time_ns": time,
                "xyz": np.stack([u / 1000.0, none, none], 1).tolist(),
            },
            "vehicle_angular_velocity": {
                "time_ns": time,
                "xyz": np.stack([np.radians(y), none, none], 1).tolist(),
            },
            "vehicle_attitude_setpoint": {"time_ns": time, "q_d": turns.tolist()},
            "parameters": {
                "name": [*names, *defaults],
                "value": [*names.values(), *defaults.values()],
                "origin": ["initial"] * count + ["system default"] * count,
            },
        },
    )


def ardupilot_log(
    seconds: float = 90.0, seed: int = 1, changed: dict[str, float] | None = None, **flight: Any
) -> Log:
    """An ArduCopter flight of its roll axis."""
    r, u, y, asked = signals("ardupilot", seconds, seed, **flight)
    time = (np.arange(len(r)) * 1e9 / flight.get("rate_hz", 100.0)).astype(np.int64)
    names = {f"ATC_RAT_RLL_{k}": v for k, v in ARDUPILOT.items()} | (changed or {})
    return Log(
        "ardupilot",
        {
            "RATE": {"time_ns": time, "RDes": r, "R": y, "ROut": u / 1000.0},
            "ATT": {"time_ns": time, "DesRoll": asked if flight.get("outer") else np.zeros(len(r))},
            "PARM": {"Name": list(names), "Value": list(names.values())},
        },
    )


@njit(cache=True)
def _fly(sticks, d, noise, law, numbers, delay):  # type: ignore[no-untyped-def]
    p, i, kd, on_error, target_hz, cut = law
    gain, lag, outer = numbers
    n = sticks.size
    h = 0.001
    r = np.zeros(n)
    u = np.zeros(n)
    y = np.zeros(n)
    angle = 0.0
    rate = 0.0
    torque = 0.0
    total = 0.0
    target = 0.0
    slope = 0.0
    old = 0.0
    w = 2.0 * np.pi * cut
    keep = np.exp(-w * h)
    for k in range(n):
        seen = rate + noise[k]
        asked = outer * (sticks[k] - angle) if outer > 0.0 else sticks[k]
        if on_error > 0.0:
            target += (asked - target) * (1.0 - np.exp(-2.0 * np.pi * target_hz * h))
            error = target - seen
            turning = error
        else:
            error = asked - seen
            turning = -seen
        slope = keep * slope + (1.0 - keep) * (turning - old) / h
        old = turning
        total += i * h * error
        u[k] = p * error + total + kd * slope
        r[k] = asked
        y[k] = seen
        acting = u[k - delay] if k >= delay else 0.0
        torque += h * (gain * (acting + d[k]) - torque) / lag
        rate += h * torque
        angle += h * rate
    return r, u, y
