"""Motors that stop giving thrust, and their ESCs: heat, counted errors, a lost beat, a fall, no current.

A multicopter's motor that loses its beat shows in its speed; where no speed is logged, the vehicle falls
towards a motor that is driven at full. A plane's or rover's motor draws no current under throttle.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.lake.attitude import commanded_axis, up_axis
from flysid.ingest.lake.motors import Motor
from flysid.reviews.battery import Battery
from flysid.reviews.fact import Fact, Finding, Grade
from flysid.reviews.figures import absent, fact_of
from flysid.reviews.logged import BoolArray, Column, LoggedFlight

MOST = 8
"""ESCs in a message of PX4's."""


def esc_facts(flight: LoggedFlight, motors: Sequence[Motor]) -> Iterator[Fact]:
    """The hottest ESC, the most errors, and when a motor lost its beat."""
    yield from _temperature(flight)
    yield from _errors(flight)
    yield from _beat(flight, motors)


def first_lasting(holds: BoolArray, samples: int) -> int | None:
    """Where something first holds for so many samples in a row."""
    lasts = np.convolve(holds, np.ones(samples), "valid") >= samples
    return int(np.argmax(lasts)) if lasts.any() else None


def _temperature(flight: LoggedFlight) -> Iterator[Fact]:
    fields = [f"{thing}.Temp" for thing in flight.things("ESC")]
    fields += [f"esc_status.esc[{i}].esc_temperature" for i in range(MOST)]
    known = (flight.quantity(field, unit="degC", stated="degC") for field in fields)
    warm = [column for column in known if column is not None and (column.values > 0.0).any()]
    if warm:
        hottest = max(warm, key=lambda column: float(np.percentile(column.values, 99.0)))
        at_s = float(hottest.time_s[np.argmax(hottest.values)])
        value = float(np.percentile(hottest.values, 99.0))
        yield fact_of("power.esc_temperature", value, (hottest.address,), at_s=at_s)


def _errors(flight: LoggedFlight) -> Iterator[Fact]:
    """What PX4's ESCs count: it only rises, and may begin anywhere."""
    counted = [flight.quantity(f"esc_status.esc[{i}].esc_errorcount") for i in range(MOST)]
    risen = [(float(np.ptp(column.values)), column.address) for column in counted if column is not None]
    if risen:
        most, field = max(risen)
        yield fact_of("power.esc_errors", most, (field,))


# ------------------------------------------------------------------------------------------- a lost beat

LOST = 0.5
"""Of the speed that a command usually gives: a slower motor has lost its beat, or its power."""
IN_A_ROW = 2
"""Samples at least: one alone may be a reading that went wrong, or a step of the command."""
SPINS_UP_S, BEAT_S = 0.15, 0.05
"""A motor needs so long to follow its command; what is shorter than that is a reading that went wrong."""
ANSWERS_S, DRIVEN_UP = 0.3, 0.85
"""So soon, and to so much of the range, a controller drives up a motor that gives no thrust."""
LEAST_SHARE = 0.1
"""Of the range: below it speeds follow their command too loosely."""


def _beat(flight: LoggedFlight, motors: Sequence[Motor]) -> Iterator[Fact]:
    turning = [(motor, motor.speed) for motor in motors if motor.speed is not None]
    if not turning:
        return
    times = [(_first_loss(flight, motor, speed), motor.number) for motor, speed in turning]
    lost = [found for found in times if np.isfinite(found[0])]
    at_s, number = min(lost, default=(None, 0))
    text = f"motor {number} at {at_s:.1f} s" if lost else "none"
    fields = tuple(speed.address for _, speed in turning)
    yield fact_of("power.desync", text, fields, grade=Grade.BAD if lost else Grade.GOOD, at_s=at_s)


def _first_loss(flight: LoggedFlight, motor: Motor, every: Column) -> float:
    """When a motor first turned far more slowly than its command usually makes it; NaN where it never did."""
    speed = every.where(flight.flying(every.time_s))
    lag_s = max(SPINS_UP_S, speed.period_s) if len(speed) > 1 else 0.0
    share = np.fmin(motor.command.at(speed.time_s), motor.command.at(speed.time_s - lag_s))
    driven = share > LEAST_SHARE
    if driven.sum() < 20:
        return float("nan")
    usual = speed.values[driven] / np.sqrt(share[driven])
    lost = driven & (speed.values < LOST * np.median(usual) * np.sqrt(np.where(driven, share, 1.0)))
    need = max(IN_A_ROW, round(BEAT_S * speed.rate_hz))
    slow = BEAT_S * speed.rate_hz < 1.0
    usual_share = float(np.median(share[driven]))
    for i in np.flatnonzero(lost):
        at_s = float(speed.time_s[i])
        if lost[i : i + need].sum() == need or (slow and _is_driven_up(motor, at_s, usual_share)):
            return at_s
    return float("nan")


def _is_driven_up(motor: Motor, at_s: float, usual: float) -> bool:
    """Whether a controller answered at once: what it read then was no slip of the telemetry."""
    near = np.abs(motor.command.time_s - at_s) <= ANSWERS_S
    return bool(near.any()) and float(motor.command.values[near].max()) > max(DRIVEN_UP, 1.5 * usual)


# ------------------------------------------------------------------------------------------- a fall

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

    @property
    def fact(self) -> Fact:
        """For the page."""
        note = f"towards motor {self.motor}, which was driven up against it"
        return fact_of(
            "power.thrust_loss", self.away_deg, (self.field,), at_s=self.at_s, note=note, grade=Grade.BAD
        )

    @property
    def finding(self) -> Finding:
        """The sentence of it."""
        text = f"Falls {self.away_deg:.0f} deg towards motor {self.motor} at {self.at_s:.0f} s"
        more = "a desync, an ESC that cuts out, or a hit: the motor's speed would tell"
        return Finding(f"{text} while that is driven up", Grade.BAD, 0.8, "power.thrust_loss", more)


def find_thrust_loss(flight: LoggedFlight, motors: Sequence[Motor]) -> ThrustLoss | None:
    """The furthest fall towards one motor that answered it; None where none stands out."""
    found, wanted = up_axis(flight), commanded_axis(flight)
    if found is None or wanted is None or len(motors) < 4 or not len(wanted[0]):
        return None
    time_s, axis, field = found
    place = np.clip(np.searchsorted(wanted[0], time_s, side="right") - 1, 0, None)
    off = axis - wanted[1][place]
    away = np.degrees(np.hypot(off[:, 0], off[:, 1]))
    steps = np.linalg.norm(np.diff(wanted[1], axis=0, prepend=wanted[1][:1]), axis=1)
    path = np.degrees(np.cumsum(steps))
    turned = path[place] - np.interp(time_s - AROUND_S, wanted[0], path)
    away = np.where(turned < 0.5 * away, away, 0.0)  # else the command left the vehicle
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


# ------------------------------------------------------------------------------------------- no current

DRIVEN = 0.25
"""Of the throttle: below it a plane's motor may idle."""
STOPPED = 0.3
"""Of the current that a throttle usually draws, above what the rest of the vehicle draws."""
LASTS_S = 1.0


def read_throttle(flight: LoggedFlight) -> Column | None:
    """Share of full throttle that the firmware asks for."""
    thing = next((name for name in ("CTUN", "THR") if flight.has(name)), "CTUN")
    throttle = flight.quantity("CTUN.ThO", "THR.ThrOut") or flight.quantity(f"{thing}.ThO", unit="%")
    if throttle is None or not len(throttle):
        return None
    full = 100.0 if np.abs(throttle.values).max() > 1.5 else 1.0
    return replace(throttle, values=np.abs(throttle.values) / full)


def motor_stop(flight: LoggedFlight, battery: Battery) -> Fact:
    """When the motor of a plane or a rover stopped although the throttle was open."""
    key = "power.motor_stop"
    throttle, current = read_throttle(flight), battery.current
    if throttle is None or current is None:
        return absent(key, "throttle and current are not both in the log")
    moving = flight.flying(current.time_s)
    share = np.fmin(throttle.held(current.time_s), throttle.held(current.time_s - LASTS_S))
    driven = moving & (share > DRIVEN)
    fields = (throttle.address, current.address)
    if driven.sum() * current.period_s < 10.0 * LASTS_S:
        return absent(key, "the throttle was hardly open", fields=fields)
    resting = float(np.percentile(current.values, 1.0))
    drawn = (current.values - resting) / np.maximum(share, DRIVEN)
    first_half = drawn[driven][: max(10, int(driven.sum()) // 2)]
    low = driven & (drawn < STOPPED * float(np.median(first_half)))
    at = first_lasting(low, max(2, round(LASTS_S * current.rate_hz)))
    if at is None:
        return fact_of(key, "none", fields, grade=Grade.GOOD)
    at_s = float(current.time_s[at])
    text = f"{100.0 * share[at]:.0f} % throttle draws {current.values[at]:.1f} A at {at_s:.1f} s"
    return fact_of(key, text, fields, grade=Grade.BAD, at_s=at_s)
