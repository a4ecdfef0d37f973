"""A motor that gives no thrust for a moment: the vehicle falls towards it while it is driven at full.

Only what a log without the motors' speeds can show: `esc` finds it in their speeds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.lake.attitude import commanded_axis, up_axis
from flysid.ingest.lake.motors import Motor
from flysid.reviews.fact import Fact, Finding, Grade
from flysid.reviews.logged import LoggedFlight

AWAY_DEG = 12.0
"""From the commanded tilt: half of what ArduPilot's crash check takes, and more than gusts give."""
STANDS_OUT = 1.5
"""So many times what 99 % of the flight leave."""
ALONG = 0.85
"""Cosine between the fall and the motor's arm."""
AROUND_S = 0.5
MORE, FULL = 0.3, 0.9
"""Of the range: the motor towards which it falls is driven so high, and so much above the others."""


@dataclass(frozen=True)
class ThrustLoss:
    """When a vehicle fell towards a motor, which, and how far."""

    at_s: float
    motor: int
    away_deg: float
    field: str


def find_thrust_loss(flight: LoggedFlight, motors: Sequence[Motor]) -> ThrustLoss | None:
    """The furthest fall towards one motor that answered it; None where none stands out."""
    found, wanted = up_axis(flight), commanded_axis(flight)
    if found is None or wanted is None or len(motors) < 4 or not len(wanted[0]):
        return None
    time_s, axis, field = found
    place = np.clip(np.searchsorted(wanted[0], time_s, side="right") - 1, 0, None)
    off = axis - wanted[1][place]
    away = np.degrees(np.hypot(off[:, 0], off[:, 1]))
    flying = flight.flying(time_s) & flight.flying(time_s + 2.0 * AROUND_S)
    if flying.sum() < 100:
        return None
    away = np.where(flying, away, 0.0)
    at = int(np.argmax(away))
    if away[at] < max(AWAY_DEG, STANDS_OUT * float(np.percentile(away[flying], 99.0))):
        return None
    motor = _towards(motors, float(time_s[at]), -off[at, :2])
    return None if motor is None else ThrustLoss(float(time_s[at]), motor, float(away[at]), field)


def _towards(motors: Sequence[Motor], at_s: float, falls: FloatArray) -> int | None:
    """The number of the motor on the side to which it falls, if it was driven up against it."""
    places = np.array([motor.place for motor in motors])
    alike = places @ falls / np.maximum(np.linalg.norm(places, axis=1) * np.linalg.norm(falls), 1e-9)
    near = int(np.argmax(alike))
    times = np.arange(at_s - AROUND_S, at_s + AROUND_S, 0.02)
    commands = np.array([motor.command.at(times) for motor in motors])
    if alike[near] < ALONG or not np.isfinite(commands).all() or commands[near].max() < FULL:
        return None
    extra = commands[near] - np.delete(commands, near, axis=0).mean(axis=0)
    return motors[near].number if extra.max() >= MORE else None


def facts(loss: ThrustLoss | None) -> Iterator[Fact]:
    """When, where there is one."""
    if loss is not None:
        yield Fact(
            "power.thrust_loss",
            "fall towards a motor",
            loss.away_deg,
            "deg",
            grade=Grade.BAD,
            note=f"towards motor {loss.motor}, which was driven up against it",
            fields=(loss.field,),
            at_s=loss.at_s,
        )


def findings(loss: ThrustLoss | None) -> Iterator[Finding]:
    """The sentence of it."""
    if loss is not None:
        text = (
            f"Falls {loss.away_deg:.0f} deg towards motor {loss.motor} at {loss.at_s:.0f} s "
            "while that is driven up"
        )
        more = "a desync, an ESC that cuts out, or a hit: the motor's speed would tell"
        yield Finding(text, Grade.BAD, 0.8, "power.thrust_loss", more)
