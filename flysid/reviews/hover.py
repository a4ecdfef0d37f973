"""Hover throttle: stretches of nearly still flight, and the thrust they took."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.lake.motors import is_multicopter
from flysid.reviews.logged import BoolArray, Column, LoggedFlight

STATED = {"ardupilot": "MOT_THST_HOVER", "px4": "MPC_THR_HOVER"}
"""Firmware -> parameter that says what hovering takes."""


@dataclass(frozen=True)
class Hover:
    """Share of full thrust that hovering takes, its interval of 95 %, and where it was read; NaN for unknown.

    `stated`: what the parameter says; NaN where there is none.
    `learns`: the firmware sets the parameter itself after each flight.
    """

    share: float
    interval: tuple[float, float]
    field: str
    stated: float
    learns: bool


def find_calm(
    flight: LoggedFlight,
    time_s: FloatArray,
    *,
    tilt_deg: float = 10.0,
    speed_m_s: float = 3.0,
    edge_s: float = 2.0,
    lasts_s: float = 1.0,
) -> BoolArray:
    """(n,) whether it flew level and slowly, as far as that is logged.

    `tilt_deg`: the most that it leans.
    `speed_m_s`: over ground, and half of it up or down.
    `edge_s`: after take-off and before landing, when the ground carries a part.
    `lasts_s`: the least that a stretch lasts: level for a moment is a manoeuvre.
    """
    calm = flight.flying(time_s - edge_s) & flight.flying(time_s + edge_s)
    for column, most in (
        (_tilt_deg(flight), tilt_deg),
        (_speed(flight), speed_m_s),
        (_climb(flight), 0.5 * speed_m_s),
    ):
        if column is not None:
            calm &= ~(np.abs(column.held(time_s)) > most)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], calm.astype(np.int8), [0]])))
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        calm[first:end] &= time_s[end - 1] - time_s[first] >= lasts_s
    return calm


def _tilt_deg(flight: LoggedFlight) -> Column | None:
    roll = flight.quantity("ATT.Roll", "ATTITUDE.roll", unit="deg", stated="deg")
    pitch = flight.quantity("ATT.Pitch", "ATTITUDE.pitch", unit="deg", stated="deg")
    if roll is not None and pitch is not None:
        return Column("tilt", "deg", roll.time_s, np.hypot(roll.values, pitch.at(roll.time_s)))
    x, y = (flight.quantity(f"vehicle_attitude.q[{i}]") for i in (1, 2))
    if x is None or y is None:
        return None
    cosine = 1.0 - 2.0 * (x.values**2 + y.at(x.time_s) ** 2)
    return Column("tilt", "deg", x.time_s, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _speed(flight: LoggedFlight) -> Column | None:
    for thing in flight.things("GPS")[:1]:
        return flight.quantity(f"{thing}.Spd", unit="m/s", stated="m/s")
    x, y = (_estimated(flight, f"v{axis}", "v_xy_valid") for axis in "xy")
    if x is None or y is None:
        return None
    return Column("speed", "m/s", x.time_s, np.hypot(x.values, y.at(x.time_s)))


def _climb(flight: LoggedFlight) -> Column | None:
    climb = flight.quantity("CTUN.CRt", unit="m/s", stated="cm/s")
    return climb if climb is not None else _estimated(flight, "vz", "v_z_valid")


def _estimated(flight: LoggedFlight, field: str, valid: str) -> Column | None:
    """A velocity of PX4's estimate; None unless the estimator vouches for it in all of the flight."""
    velocity = flight.quantity(f"vehicle_local_position.{field}", unit="m/s", stated="m/s")
    vouched = flight.quantity(f"vehicle_local_position.{valid}")
    if velocity is None or (
        vouched is not None and not vouched.where(flight.flying(vouched.time_s)).values.all()
    ):
        return None
    return velocity


def measure_hover(flight: LoggedFlight, *, least_s: float = 3.0) -> Hover:
    """From what the firmware estimates, else from the throttle while calm; at least `least_s` of it."""
    stated = _stated(flight)
    learns = flight.family == "ardupilot" and flight.parameters.get("MOT_HOVER_LEARN", 2.0) == 2.0
    nothing = Hover(float("nan"), (float("nan"), float("nan")), "", stated, learns)
    thrust = _thrust(flight) if is_multicopter(flight) else None
    if thrust is None:
        return nothing
    calm = thrust.where(find_calm(flight, thrust.time_s) & (thrust.values > 0.0))
    if calm.covered_s < least_s:
        return nothing
    share = float(np.median(calm.values))
    return Hover(share, _interval(calm, share), thrust.address, stated, learns)


def _stated(flight: LoggedFlight) -> float:
    """What the firmware takes hovering for: what it has learnt by take-off, else its parameter."""
    learnt = flight.quantity("CTUN.ThH")
    if learnt is not None:
        flown = learnt.where(flight.flying(learnt.time_s) & (learnt.values > 0.0))
        if len(flown):
            return float(flown.values[0])
    return flight.parameters.get(STATED.get(flight.family, ""), float("nan"))


def _thrust(flight: LoggedFlight) -> Column | None:
    estimate = flight.quantity("hover_thrust_estimate.hover_thrust")
    valid = flight.quantity("hover_thrust_estimate.valid")
    if estimate is not None and valid is not None:
        known = estimate.where((valid.held(estimate.time_s) > 0.0) & flight.flying(estimate.time_s))
        if len(known) and not _is_at_end(flight, known):
            return known
    throttle = flight.quantity("CTUN.ThO")
    if throttle is not None:
        return throttle if throttle.values.max() <= 1.0 else None
    down = flight.quantity("vehicle_thrust_setpoint.xyz[2]")
    return None if down is None else Column(down.address, "", down.time_s, -down.values)


def _is_at_end(flight: LoggedFlight, estimate: Column) -> bool:
    """Whether PX4's estimate lies where it may not go further: HTE_THR_RANGE from MPC_THR_HOVER."""
    away = flight.parameters.get("HTE_THR_RANGE", 0.2)
    apart = np.abs(np.median(estimate.values) - flight.parameters.get("MPC_THR_HOVER", 0.5))
    return bool(apart > 0.97 * away)


def _interval(calm: Column, share: float, *, block_s: float = 5.0) -> tuple[float, float]:
    """Of 95 %, from how much blocks of the flight differ; the whole spread of fewer than three."""
    blocks = (calm.time_s // block_s).astype(int)
    means = np.array([calm.values[blocks == block].mean() for block in np.unique(blocks)])
    if len(means) < 3:
        return float(calm.values.min()), float(calm.values.max())
    half = 1.96 * float(means.std(ddof=1)) / np.sqrt(len(means))
    return share - half, share + half
