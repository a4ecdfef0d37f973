"""What the sensors of simulated quadrotors give: vibration, noise, and the faults that only sensors have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import signal

from bench.faulty_quadrotor import GROUND_S, RATE_HZ, SECONDS, Flight, Quadrotor, move
from flysid.dataset import FloatArray

WANDER_M, WANDER_S = 0.25, 20.0
"""How far the GPS wanders, and over what time."""
BROWNING_S = 1.5
"""How long the supply of the board falls before the log ends."""
SATELLITES, FEW = 17, 7
JAMMED_S, JAMMED_M = 15.0, 3.0
"""How long a GPS is jammed, and how far it strays meanwhile."""
AWAY_M = 8.0
"""A receiver so far off knows that it is not accurate."""
FLIES_OFF = 1.35
"""Speed of a motor without its propeller, over that with it."""
TOUCH_S, BLOW_S = 0.8, 0.03
"""The land detector takes so long; the blow of a landing lasts so long."""
BLOW_M_S2 = 80.0
"""Of the ground, and of nothing in flight."""
EARTH_G = 0.48


def fly(vehicles: Sequence[Quadrotor]) -> list[Flight]:
    """The flights of several vehicles, as their sensors see them."""
    return [cut_off(measure(flight)) for flight in move(vehicles)]


def cut_off(flight: Flight) -> Flight:
    """Until the board's supply is gone, or until its pilot disarms it on the ground that it hit."""
    vehicle = flight.vehicle
    last_s, armed_s = vehicle.browns_s, flight.armed_s
    if vehicle.fails_s or vehicle.hits_s:
        blows = np.flatnonzero(np.linalg.norm(flight["accel"], axis=1) > BLOW_M_S2)
        if len(blows):
            disarmed_s = flight.time_s[blows[-1]] + np.random.default_rng(vehicle.seed + 2).uniform(1.5, 5.0)
            armed_s, last_s = (armed_s[0], min(armed_s[1], disarmed_s)), min(SECONDS, disarmed_s + 0.5)
    if not last_s:
        return flight
    n = int(last_s * RATE_HZ)
    columns = {k: v[:n] for k, v in flight.columns.items()}
    return replace(flight, time_s=flight.time_s[:n], columns=columns, armed_s=armed_s)


def measure(flight: Flight) -> Flight:
    """With what its sensors give."""
    vehicle = flight.vehicle
    rng = np.random.default_rng(vehicle.seed + 1)
    rpm = _rpm(flight)
    phase = 2.0 * np.pi * np.cumsum(rpm / 60.0, axis=0) / RATE_HZ + rng.uniform(0.0, 6.0, 4)
    hover = vehicle.rpm * np.sqrt(vehicle.hover)
    size = np.full(4, vehicle.shake_m_s2 / 2.0)
    if vehicle.bent >= 0:
        size[vehicle.bent] += vehicle.bent_m_s2
    tones = size * (rpm / hover) ** 2 * np.sin(phase)
    shake = tones.sum(axis=1)[:, None] * np.array([0.7, 0.7, 1.0])
    strong = (rpm.mean(axis=1, keepdims=True) / hover) ** 2
    n = len(flight.time_s)
    landed = _land(flight)
    clean = landed["force"] + shake
    accel = clean + 0.25 * strong * rng.normal(size=(n, 3))
    accel_2 = clean + 0.25 * strong * rng.normal(size=(n, 3)) + rng.normal(scale=0.05, size=3)
    if vehicle.loose_m_s2:
        rattle = np.convolve(rng.normal(size=n), [0.5, 0.3, 0.2], "same") * vehicle.loose_m_s2 / 0.6
        accel = accel + (rattle * strong[:, 0])[:, None] * np.array([0.6, 0.6, 1.0])
    gyro = flight["rates"] + 0.01 * shake + 0.01 * strong * rng.normal(size=(n, 3))
    left_s = vehicle.browns_s - flight.time_s if vehicle.browns_s else np.full(n, np.inf)
    board = 5.12 - 0.6 * vehicle.warns * np.clip(BROWNING_S - left_s, 0.0, BROWNING_S)
    sensed = {
        "board": board,
        "rpm": rpm,
        "accel": np.clip(accel, -157.0, 157.0),
        "accel_2": accel_2,
        "gyro": gyro,
        "velocity": landed["velocity"],
        **receive(flight, rng),
    }
    return replace(flight, columns=flight.columns | sensed)


def _rpm(flight: Flight) -> FloatArray:
    """(N, 4); a motor that throws its propeller turns faster."""
    vehicle = flight.vehicle
    rpm = flight["turning"] * vehicle.rpm
    if vehicle.fails_s and vehicle.propeller:
        rpm[flight.time_s >= vehicle.fails_s, 0] *= FLIES_OFF
    return rpm


def _land(flight: Flight) -> dict[str, FloatArray]:
    """Force and velocity with the touch-down of a hard landing."""
    force, velocity = flight["force"].copy(), flight["velocity"].copy()
    speed = flight.vehicle.hard_m_s
    touch_s = SECONDS - GROUND_S - TOUCH_S
    if speed:
        since = flight.time_s - touch_s
        velocity[(since >= -1.0) & (since < 0.0), 2] = speed
        velocity[since >= 0.0] = 0.0
        blow = (since >= 0.0) & (since < BLOW_S)
        pulse = np.sin(np.pi * np.clip(since / BLOW_S, 0.0, 1.0))
        force[blow, 2] -= 0.5 * np.pi * speed / BLOW_S * pulse[blow]
    return {"force": force, "velocity": velocity}


def receive(flight: Flight, rng: np.random.Generator) -> dict[str, FloatArray]:
    """What a GPS gives: where it believes to be, how many satellites it sees, how sure it is."""
    vehicle, time_s = flight.vehicle, flight.time_s
    n = len(time_s)
    gps = flight["position"] + _wander(rng, n, WANDER_M, WANDER_S) + 0.02 * rng.normal(size=(n, 3))
    if vehicle.glitch_m:
        jumped = (time_s >= vehicle.glitch_s) & (time_s < vehicle.glitch_s + 5.0)
        gps[jumped, :2] += vehicle.glitch_m * np.array([0.6, 0.8])
    if vehicle.drift_m_s:
        gps[:, 0] += vehicle.drift_m_s * np.maximum(time_s - vehicle.drift_s, 0.0)
    jammed = np.zeros(n, dtype=bool)
    if vehicle.jam_s:
        jammed = (time_s >= vehicle.jam_s) & (time_s < vehicle.jam_s + JAMMED_S)
        gps[jammed] += _wander(rng, n, JAMMED_M, 2.0)[jammed]
    off = np.linalg.norm(gps - flight["position"], axis=1) > AWAY_M
    off &= ~jammed & (vehicle.drift_m_s == 0.0)
    seen = rng.integers(3, 7)
    return {
        "gps": gps,
        "satellites": np.where(jammed, seen, np.where(off, FEW, SATELLITES)).astype(float),
        "hdop": np.where(jammed, rng.uniform(2.5, 6.0), np.where(off, 2.6, 0.7)),
        "accuracy": np.where(jammed, rng.uniform(6.0, 20.0), np.where(off, 7.0, 0.75)),
        "speed_accuracy": np.where(jammed, rng.uniform(1.5, 4.0), np.where(off, 2.0, 0.22)),
        "jamming": np.where(jammed, rng.uniform(85.0, 200.0), 12.0),
    }


def _wander(rng: np.random.Generator, n: int, size: float, time_s: float) -> FloatArray:
    """(n, 3) a slow walk of this size over this time."""
    step = 1.0 / (RATE_HZ * time_s)
    found: FloatArray = size * signal.lfilter(
        [np.sqrt(2.0 * step)], [1.0, step - 1.0], rng.normal(size=(n, 3)), axis=0
    )
    return found
