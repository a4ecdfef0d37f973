"""A quadrotor that shares no code with the fit: Euler steps of a millisecond, and a controller.

It flies circles and dashes with steps of roll, pitch and yaw torque on top, so that every number shows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from flysid.dataset import Dataset, FloatArray, Segment, Signal

STEP_S = 0.001
LOGGED_S = 0.01
GRAVITY = 9.81
MIX = np.array([[-1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]])
"""Motors front right, rear right, rear left, front left; signs of roll, pitch and yaw."""
SIGNALS = (
    *("gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z", "q_w", "q_x", "q_y", "q_z"),
    *("v_x", "v_y", "v_z", "p_x", "p_y", "p_z"),
)
Beyond = Callable[[FloatArray, float], tuple[FloatArray, float]]
"""Air speed in body axes and height -> force in m/s^2 beyond the laws, and a factor of torque."""


@dataclass(frozen=True)
class HiddenQuad:
    """What is to be found: thrust and effects of a motor at full command, at the nominal voltage."""

    thrust: float = 5.0
    roll: float = 120.0
    pitch: float = 100.0
    yaw: float = 15.0
    lag: float = 0.04
    delay: float = 0.02
    curve: float = 0.7
    drag: float = 0.08
    inertia: tuple[float, float, float] = (1.0, 1.2, 1.9)
    wind: tuple[float, float] = (0.0, 0.0)
    gust: float = 0.0
    noise: float = 1.0
    strength: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    trim: tuple[float, float, float] = field(default=(0.5, -0.8, 0.2))
    beyond: Beyond | None = None


def fly(quad: HiddenQuad, seconds: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """(N, 4) commands and (N, 16) signals at 100 Hz."""
    rng = np.random.default_rng(seed)
    x = np.full(4, 0.5)
    p = np.array([0.0, 0.0, 2.0])
    v = np.zeros(3)
    w = np.zeros(3)
    turn = Rotation.identity()
    inertia = np.array(quad.inertia)
    across, along = MIX[:, 0] * quad.roll * inertia[0], -MIX[:, 1] * quad.pitch * inertia[1]
    places = np.column_stack([along, across, np.zeros(4)]) / quad.thrust  # thrust there turns it so
    wind = np.array([*quad.wind, 0.0])
    queue = [np.full(4, 0.55)] * (round(quad.delay / STEP_S) + 1)
    u = queue[0]
    gust = np.zeros(3)
    shake = np.zeros(3)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    commands = []
    rows = []
    every = round(LOGGED_S / STEP_S)
    for i in range(round(seconds / STEP_S)):
        t = i * STEP_S
        r = turn.as_matrix()
        lift = np.array(quad.strength) * ((1.0 - quad.curve) * x + quad.curve * x**2)
        air = r.T @ (v - wind)
        hubs = -quad.drag * np.sqrt(lift)[:, None] * air * [1.0, 1.0, 0.0]  # drag acts at the hubs
        force = hubs.sum(axis=0) + np.array([0.0, 0.0, quad.thrust * lift.sum()])
        added, factor = (0.0, 1.0) if quad.beyond is None else quad.beyond(air, p[2])
        force = force + added
        if i % every == 0:
            noise = quad.noise * rng.standard_normal(16)
            q = turn.as_quat()[[3, 0, 1, 2]]
            spread = np.repeat([0.01, 0.05, 0.001, 0.01, 0.002], [3, 3, 4, 3, 3])
            seen = np.concatenate([w, force, q, v, p]) + spread * noise
            u = _controlled(quad, seen, t, phase)
            if i % 250 == 0:
                shake = rng.choice([-1.0, 0.0, 1.0], 3) * np.array([0.05, 0.05, 0.12])
            u = np.clip(u + MIX @ shake, 0.08, 1.0)
            commands.append(u)
            rows.append(seen)
        queue.append(u)
        x = x + STEP_S / quad.lag * (queue.pop(0) - x)
        gust += STEP_S / 0.5 * -gust + np.sqrt(2.0 * STEP_S / 0.5) * quad.gust * rng.standard_normal(3)
        effect = factor * np.array([quad.roll, quad.pitch, quad.yaw]) * (MIX.T @ lift)
        couple = -_cross(w, inertia * w) / inertia
        dragged = _cross(places, hubs).sum(axis=0) / inertia
        p = p + STEP_S * v
        v = v + STEP_S * (r @ force - [0.0, 0.0, GRAVITY])
        turn = turn * Rotation.from_rotvec(w * STEP_S)
        w = w + STEP_S * (effect + couple + dragged + np.array(quad.trim) + gust)
    return np.array(commands), np.array(rows)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(..., 3) as `np.cross`, which takes longer than a whole step."""
    (a0, a1, a2), (b0, b1, b2) = a.T, b.T
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0]).T


def _controlled(quad: HiddenQuad, seen: FloatArray, t: float, phase: FloatArray) -> FloatArray:
    """Commands of a position controller that follows a figure."""
    turn = Rotation.from_quat(seen[[7, 8, 9, 6]])
    goal = np.array(
        [3.0 * np.sin(0.9 * t + phase[0]), 2.0 * np.sin(1.3 * t + phase[1]), 2.0 + np.sin(t + phase[2])]
    )
    push = 1.5 * (goal - seen[13:16]) - 2.0 * seen[10:13]
    yaw = 0.5 * t
    ahead = Rotation.from_euler("z", -yaw).apply(push)
    lean = np.array([-np.clip(ahead[1], -5.0, 5.0), np.clip(ahead[0], -5.0, 5.0)]) / GRAVITY
    tilt = (Rotation.from_euler("z", -yaw) * turn).as_rotvec()
    wanted = (
        np.array([80.0, 80.0, 8.0]) * (np.array([*lean, 0.0]) - tilt) - np.array([14.0, 14.0, 5.0]) * seen[:3]
    )
    lift = (GRAVITY + np.clip(push[2], -4.0, 4.0)) / (4.0 * quad.thrust)
    each = np.clip(lift + MIX @ (wanted / (4.0 * np.array([quad.roll, quad.pitch, quad.yaw]))), 0.01, 1.0)
    a, b = quad.curve, 1.0 - quad.curve
    return np.asarray((-b + np.sqrt(b * b + 4.0 * a * each)) / (2.0 * a) if a > 0.0 else each)


def dataset(quad: HiddenQuad, flights: int, seconds: float, seed: int) -> Dataset:
    """Flights as a dataset of a vehicle."""
    segments = []
    for i in range(flights):
        commands, rows = fly(quad, seconds, seed + i)
        segments.append(Segment(commands, rows, flight=f"flight-{i}"))
    inputs = tuple(Signal(f"motor{i}") for i in (1, 2, 3, 4))
    return Dataset(LOGGED_S, inputs, tuple(Signal(name) for name in SIGNALS), tuple(segments))


def write_table(path: Path, data: Dataset, voltage: float = 0.0) -> Path:
    """The first flight as a table with the columns that the recipe `sixdof` states."""
    segment = data.segments[0]
    columns = [LOGGED_S * np.arange(len(segment)), *segment.u.T, *segment.y.T]
    names = ["time", *(s.name for s in data.inputs), *SIGNALS]
    if voltage:
        columns.append(voltage - 0.0005 * np.arange(len(segment)))
        names.append("voltage")
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=",".join(names), comments="", fmt="%.8g")
    return path
