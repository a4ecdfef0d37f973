"""ESCs: how hot they get, the errors that they count, and motors that lose their beat."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.ingest.lake.motors import Motor
from flysid.reviews.fact import Action, Fact, Finding, Grade
from flysid.reviews.limits import limit
from flysid.reviews.logged import Column, LoggedFlight

MOST = 8
"""ESCs in a message of PX4's."""
LOST = 0.5
"""Of the speed that a command usually gives: a slower motor has lost its beat, or its power."""
IN_A_ROW = 2
"""Samples at least: one alone may be a reading that went wrong, or a step of the command."""
SPINS_UP_S, LASTS_S = 0.15, 0.05
"""A motor needs so long to follow its command; what is shorter than that is a reading that went wrong."""
ANSWERS_S, DRIVEN_UP = 0.3, 0.85
"""So soon, and to so much of the range, a controller drives up a motor that gives no thrust."""
LEAST_SHARE = 0.1
"""Of the range: below it speeds follow their command too loosely."""


def facts(flight: LoggedFlight, motors: Sequence[Motor]) -> Iterator[Fact]:
    """The hottest ESC, the most errors, and when a motor lost its beat."""
    yield from _temperature(flight)
    yield from _errors(flight)
    yield from _beat(flight, motors)


def _temperature(flight: LoggedFlight) -> Iterator[Fact]:
    fields = [f"{thing}.Temp" for thing in flight.things("ESC")]
    fields += [f"esc_status.esc[{i}].esc_temperature" for i in range(MOST)]
    hottest: tuple[float, Column] | None = None
    for field in fields:
        column = flight.quantity(field, unit="degC", stated="degC")
        if column is None or not (column.values > 0.0).any():
            continue
        value = float(np.percentile(column.values, 99.0))
        if hottest is None or value > hottest[0]:
            hottest = value, column
    if hottest is None:
        return
    value, column = hottest
    known = limit("power.esc_temperature")
    at_s = float(column.time_s[np.argmax(column.values)])
    fields_of = (column.address,)
    yield Fact(
        "power.esc_temperature",
        "hottest ESC",
        value,
        "degC",
        None,
        known.grade(value),
        known.source,
        fields_of,
        at_s,
    )


def _errors(flight: LoggedFlight) -> Iterator[Fact]:
    """What PX4's ESCs count: it only rises, and may begin anywhere."""
    counted = [flight.quantity(f"esc_status.esc[{i}].esc_errorcount") for i in range(MOST)]
    risen = [(float(np.ptp(column.values)), column.address) for column in counted if column is not None]
    if risen:
        most, field = max(risen)
        grade = Grade.WATCH if most else Grade.GOOD
        yield Fact("power.esc_errors", "most errors of an ESC", most, "", grade=grade, fields=(field,))


def _beat(flight: LoggedFlight, motors: Sequence[Motor]) -> Iterator[Fact]:
    turning = [motor for motor in motors if motor.speed is not None]
    if not turning:
        return
    losses = [
        (at_s, motor) for motor in turning for at_s in [_first_loss(flight, motor)] if np.isfinite(at_s)
    ]
    fields = tuple(motor.speed.address for motor in turning if motor.speed is not None)
    label = "motor that loses its beat"
    if not losses:
        yield Fact("power.desync", label, "none", grade=Grade.GOOD, fields=fields)
        return
    at_s, motor = min(losses, key=lambda loss: loss[0])
    text = f"motor {motor.number} at {at_s:.1f} s"
    yield Fact("power.desync", label, text, grade=Grade.BAD, fields=fields, at_s=at_s)


def _first_loss(flight: LoggedFlight, motor: Motor) -> float:
    """When a motor first turned far more slowly than its command usually makes it; NaN where it never did."""
    assert motor.speed is not None
    speed = motor.speed.where(flight.flying(motor.speed.time_s))
    lag_s = max(SPINS_UP_S, speed.period_s) if len(speed) > 1 else 0.0
    share = np.fmin(motor.command.at(speed.time_s), motor.command.at(speed.time_s - lag_s))
    driven = share > LEAST_SHARE
    if driven.sum() < 20:
        return float("nan")
    usual = speed.values[driven] / np.sqrt(share[driven])
    lost = driven & (speed.values < LOST * np.median(usual) * np.sqrt(np.where(driven, share, 1.0)))
    need = max(IN_A_ROW, round(LASTS_S * speed.rate_hz))
    slow = LASTS_S * speed.rate_hz < 1.0
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


def findings(stated: Sequence[Fact]) -> Iterator[Finding]:
    """A motor that lost its beat, an ESC that is too hot or counts errors."""
    by_key = {fact.key: fact for fact in stated}
    beat = by_key.get("power.desync")
    if beat is not None and beat.grade is Grade.BAD:
        motor, _, when = str(beat.value).partition(" at ")
        text = f"{motor.capitalize()} turns at less than half of what its command gives at {when}"
        yield Finding(
            text, Grade.BAD, 0.9, beat.key, "a desync, an ESC that cuts out, or a motor that stalls"
        )
    hot = by_key.get("power.esc_temperature")
    if hot is not None and hot.grade.rank >= Grade.WATCH.rank:
        yield Finding(f"An ESC gets {hot.words} hot", hot.grade, 0.6, hot.key, hot.note)
    errors = by_key.get("power.esc_errors")
    if errors is not None and errors.grade is not Grade.GOOD:
        yield Finding(f"An ESC counts {errors.value:.0f} errors", Grade.WATCH, 0.4, errors.key)


def actions(stated: Sequence[Fact]) -> Iterator[Action]:
    """What to do about a motor that lost its beat."""
    beat = next((fact for fact in stated if fact.key == "power.desync"), None)
    if beat is not None and beat.grade is Grade.BAD:
        motor = str(beat.value).partition(" at ")[0]
        reason = f"{beat.value}: it turned at less than half of its usual speed for that command"
        order = f"Check {motor}: its ESC's timing, wires and bearings"
        yield Action(order, reason, predicted="a speed that follows its command", weight=0.8, fact=beat.key)
