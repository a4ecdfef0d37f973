"""Trial flights of a position loop on the models of a run: all laws and all vehicles of a shape at once.

The velocity that the loop sees is the model's, with the disturbance of the vehicle's stretch of flight; its
integral is the place. The range in which a model holds is the one that it was trained in: a vehicle whose
velocity leaves the model's output limits is lost, and stays as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.design.law import Gains, keeping
from flysid.design.modelvehicles import ModelVehicle
from flysid.design.trialflight import FIRST_STEPS_S, HELD, Flown, course, judge_flight, steer
from flysid.export.program import Memberships


def fly_models(
    vehicles: Sequence[ModelVehicle], laws: Sequence[Gains], sign: float, limit: float
) -> list[list[Flown]]:
    """What every law (outer) does on every vehicle of a channel (inner), over the first axis' course.

    `sign`: -1 where the output falls as the input rises.
    `limit`: largest input.
    """
    found: list[list[Flown | None]] = [[None] * len(vehicles) for _ in laws]
    for shape in dict.fromkeys(_shape(v) for v in vehicles):
        alike = [i for i, v in enumerate(vehicles) if _shape(v) == shape]
        dt_s = vehicles[alike[0]].body.dt_s
        away, inputs, lost = _fly([vehicles[i] for i in alike], laws, sign, limit)
        for t, i in enumerate(alike):
            for j in range(len(laws)):
                rows = away[:, t, j], inputs[:, t, j]
                found[j][i] = judge_flight(*rows, limit, FIRST_STEPS_S[0], bool(lost[t, j]), dt_s=dt_s)
    return [[f for f in flown if f is not None] for flown in found]


def _shape(vehicle: ModelVehicle) -> tuple[Any, ...]:
    """What vehicles have in common that are flown together."""
    body = vehicle.body
    m = body.memberships
    return (body.A.shape, body.P.shape, m and (m.shape, m.conjunction), vehicle.acts_at_once, body.dt_s)


@dataclass(frozen=True, eq=False)
class _Bodies:
    """T bodies of one shape; x (T, L, n) and u (T, L) of L laws."""

    output: FloatArray
    step: FloatArray
    scheduling: FloatArray
    memberships: Memberships | None
    limits: FloatArray
    start: FloatArray

    @classmethod
    def of(cls, vehicles: Sequence[ModelVehicle]) -> _Bodies:
        """Matrices act on [x, u, 1]."""
        bodies = [v.body for v in vehicles]
        output = np.stack([np.concatenate([b.C, b.D, b.g[..., None]], axis=2) for b in bodies])
        step = np.stack([np.concatenate([b.A, b.B, b.f[..., None]], axis=2) for b in bodies])
        return cls(
            output[:, None],
            step[:, None],
            np.stack([np.column_stack([b.P, b.Q]) for b in bodies])[:, None],
            _stacked([b.memberships for b in bodies if b.memberships is not None]),
            np.stack([b.output_limits[:, 0] for b in bodies])[:, :, None],
            np.stack([b.x0 for b in bodies])[:, None],
        )

    def weights(self, seen: FloatArray) -> FloatArray:
        """(T, L, 1, R) of [x, u, 1]."""
        if self.memberships is None:
            return np.ones((1, 1, 1, 1))
        z = (self.scheduling @ seen[..., :-1, None])[..., 0]
        return self.memberships.weights(z)[..., None, :]


def _stacked(every: Sequence[Memberships]) -> Memberships | None:
    if not every:
        return None
    numbers: dict[str, Any] = {
        name: np.stack([getattr(m, name) for m in every])[:, None] for name in Memberships.NUMBERS
    }
    return replace(every[0], **numbers)


def _blend(weights: FloatArray, matrices: FloatArray, seen: FloatArray) -> FloatArray:
    """(T, L, rows) of every rule's matrix (T, 1, R, rows, n + 2) at [x, u, 1], as loud as it speaks."""
    every = (matrices @ seen[:, :, None, :, None])[..., 0]
    return np.asarray((weights @ every)[..., 0, :])


def _fly(
    vehicles: Sequence[ModelVehicle], laws: Sequence[Gains], sign: float, limit: float
) -> tuple[FloatArray, FloatArray, Any]:
    """(N, T, L) error of place and input, and (T, L) whether the vehicle was lost."""
    dt_s = vehicles[0].body.dt_s
    place, speed = course(dt_s=dt_s)
    shape = (len(vehicles), len(laws))
    bodies = _Bodies.of(vehicles)
    gains = np.array([law.packed() for law in laws])
    keep = np.array([keeping((law.cut_hz, law.error_hz), dt_s) for law in laws])
    late = np.array([v.late_s for v in vehicles]) / dt_s
    beyond = np.stack([v.disturbance for v in vehicles])
    inputs = np.zeros((len(place), *shape))
    away = np.empty((len(place), *shape))
    held = np.zeros((*shape, HELD))
    lost = np.zeros(shape, dtype=bool)
    seen = np.concatenate(
        [
            np.broadcast_to(bodies.start, (*shape, bodies.start.shape[-1])),
            np.zeros((*shape, 1)),
            np.ones((*shape, 1)),
        ],
        axis=-1,
    )
    at = np.zeros(shape)
    before = np.zeros(shape)
    for k in range(len(place)):
        if vehicles[0].acts_at_once:
            seen[..., -2] = sign * _acting(inputs, k, late)
        weights = bodies.weights(seen)
        y = _blend(weights, bodies.output, seen)[..., 0]
        kept = np.clip(y, bodies.limits[:, 0], bodies.limits[:, 1])
        lost |= kept != y
        v = kept + beyond[:, k, None]
        at += 0.5 * dt_s * (before + v) if k else 0.0
        before = v
        away[k] = place[k, 0] - at
        _steer_all(gains, keep, limit, dt_s, away[k], speed[k, 0], v, held, k == 0, inputs[k])
        seen[..., -2] = sign * _acting(inputs, k, late)
        after = _blend(weights, bodies.step, seen)
        seen[..., :-2] = np.where(lost[..., None], seen[..., :-2], after)
    return away, inputs, lost


def _acting(inputs: FloatArray, k: int, late: FloatArray) -> FloatArray:
    """(T, L) the input that acts at sample k, so many samples late; zero before the flight."""
    whole = np.floor(late).astype(int)
    share = (late - whole)[:, None]
    rows = np.arange(len(late))
    newer = np.where((k >= whole)[:, None], inputs[np.maximum(k - whole, 0), rows], 0.0)
    older = np.where((k > whole)[:, None], inputs[np.maximum(k - whole - 1, 0), rows], 0.0)
    return np.asarray((1.0 - share) * newer + share * older)


@njit(cache=True)
def _steer_all(gains, keep, limit, dt_s, away, speed, v, held, first, inputs):  # type: ignore[no-untyped-def]
    """Fill the inputs (T, L) of one sample."""
    for t in range(v.shape[0]):
        for j in range(v.shape[1]):
            inputs[t, j] = steer(
                gains[j], keep[j], limit, dt_s, away[t, j], speed, v[t, j], held[t, j], first
            )
