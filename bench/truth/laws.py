"""Controllers around drawn plants: P, PI, PID with a filter, at the input or a setpoint; or a pilot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from bench.truth.plants import Plant
from flysid.dataset import Dataset, FloatArray
from flysid.model.frequency.sampling import sample
from flysid.model.polynomials import ComplexArray

SETPOINT, INPUT = "setpoint", "input"
LOOPS = ("added at the input", "PI", "PID", "PI at a setpoint", "pilot")
"""Who closes the loop, and where the reference enters; a pilot's is not logged."""


@dataclass(frozen=True, eq=False)
class Law:
    """A controller in steps of the log: u(k) is its answer to what it sees of sample k - 1.

    `at`: where the reference that is logged enters; "" where none is.
    """

    top: FloatArray
    bottom: FloatArray
    at: str = INPUT

    def response(self, omega: FloatArray, dt_s: float) -> ComplexArray:
        """(F,) without the step that it takes."""
        z = np.exp(-1j * omega * dt_s)
        return np.asarray(np.polyval(self.top[::-1], z) / np.polyval(self.bottom[::-1], z))


def draw_law(rng: np.random.Generator, kind: str, plant: Plant, dt_s: float) -> Law:
    """One of a kind, of a gain that leaves a gain margin of 2 to 5."""
    law = _shape(rng, kind, plant, dt_s)
    omega = plant.grid(dt_s)
    sign = np.sign(plant.transfer.numerators[0][-1])
    loop = sign * plant.response(omega, dt_s) * law.response(omega, dt_s) * np.exp(-1j * omega * dt_s)
    turned = np.flatnonzero(np.unwrap(np.angle(loop)) < -np.pi)
    limit = 1.0 / abs(loop[turned[0]]) if len(turned) else 5.0 / abs(loop[0])
    return replace(law, top=law.top * float(sign * limit / rng.uniform(2.0, 5.0)))


def _shape(rng: np.random.Generator, kind: str, plant: Plant, dt_s: float) -> Law:
    """Of gain one; what integrates gets no second integrator."""
    one = np.ones(1)
    if kind == "pilot":
        late = max(round(float(rng.uniform(0.2, 0.5)) / plant.corner / dt_s), 1)
        return Law(np.append(np.zeros(late), 1.0), one, at="")
    at = SETPOINT if kind.endswith(SETPOINT) else INPUT
    if not kind.startswith("PI") or plant.gain is None:
        return Law(one, one, at=at)
    slow = plant.corner * dt_s / rng.uniform(2.0, 6.0)
    law = Law(np.array([1.0 + slow, -1.0]), np.array([1.0, -1.0]), at=at)
    if kind != "PID":
        return law
    quick = float(rng.uniform(0.1, 0.4)) / plant.corner / dt_s
    keep = np.exp(-1.0 / max(0.2 * quick, 0.5))
    slope = quick * (1.0 - keep) * np.convolve([1.0, -1.0], [1.0, -1.0])
    return Law(np.convolve(law.top, [1.0, -keep]) + slope, np.convolve(law.bottom, [1.0, -keep]))


def log_loop(plant: Plant, law: Law, drive: FloatArray, dt_s: float, noise: FloatArray) -> Dataset:
    """Inputs u and, where it is logged, r; output y under a disturbance, `noise` times its clean size."""
    a, (b,) = sample(plant.transfer, dt_s, "zero")
    late = np.append(0.0, law.top)
    bottom = _add(np.convolve(a, law.bottom), np.convolve(b, late))
    forward = np.convolve(b, late if law.at == SETPOINT else law.bottom)
    clean = np.asarray(lfilter(forward, bottom, drive))
    added = noise * clean.std()
    y = clean + np.asarray(lfilter(np.convolve(a, law.bottom), bottom, added))
    if law.at == SETPOINT:
        u = np.asarray(lfilter(late, law.bottom, drive - y))
    else:
        u = drive - np.asarray(lfilter(late, law.bottom, y))
    if not law.at:
        return Dataset.from_arrays(u, y, dt_s, inputs=["u"], outputs=["y"])
    return Dataset.from_arrays(np.column_stack([u, drive]), y, dt_s, inputs=["u", "r"], outputs=["y"])


def _add(one: FloatArray, other: FloatArray) -> FloatArray:
    size = max(len(one), len(other))
    return np.pad(one, (0, size - len(one))) + np.pad(other, (0, size - len(other)))
