"""Why a flight ended badly: causes ranked by what the log holds of the last ten seconds, or none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.ingest.lake.attitude import lean_towards
from flysid.ingest.lake.events import Event
from flysid.ingest.lake.failures import plain_words
from flysid.ingest.lake.motors import Motor, read_motors
from flysid.reviews.battery import read_battery
from flysid.reviews.failures import Failure
from flysid.reviews.figures import limit
from flysid.reviews.gps import find_jump, read_receiver
from flysid.reviews.logged import Column, LoggedFlight

BEFORE_S = 10.0
AT_FULL = 0.95
"""Of a motor's range."""
STOPPED = 0.2
"""Of a motor's speed in steady flight."""
HELD_S = 0.3
"""At full for so long: a gust asks for less."""


@dataclass(frozen=True)
class Cause:
    """A cause, how strongly the log speaks for it (0 to 1), and what it holds.

    `name`: a few words.
    `evidence`: a sentence with its figures.
    """

    name: str
    weight: float
    evidence: str


def rank_causes(
    flight: LoggedFlight, begins_s: float, events: Sequence[Event], stated: Sequence[Failure]
) -> list[Cause]:
    """The likeliest first; empty where the log does not tell.

    `begins_s`: when it went wrong, on the log's clock.
    `events`, `stated`: of the log, and the failures that it states.
    """
    motors = read_motors(flight)
    found = [
        *_switched_off(flight, motors, begins_s, events),
        *_motor_lost(flight, motors, begins_s),
        *_brown_out(flight, begins_s),
        *_glitch(flight, begins_s),
        *_shaken(flight, begins_s),
        *_stated(begins_s, stated),
    ]
    return sorted(found, key=lambda cause: -cause.weight)


def _switched_off(
    flight: LoggedFlight, motors: Sequence[Motor], begins_s: float, events: Sequence[Event]
) -> Iterator[Cause]:
    """All motors idle before the vehicle tipped over."""
    if not motors:
        return
    times = motors[0].command.time_s
    highest = np.max([m.command.at(times) for m in motors], axis=0)
    before = (times >= begins_s - BEFORE_S) & (times < begins_s)
    idle = np.flatnonzero(before & (highest <= 0.01))
    carried = before & (highest > 0.05)
    if not len(idle) or not carried.any() or times[idle[-1]] < begins_s - 1.0:
        return
    at_s = float(times[carried][-1])
    reason = _message_between(flight, events, at_s - 1.0, at_s + 0.5)
    text = f"all motors were commanded to stop at {at_s:.1f} s, {begins_s - at_s:.1f} s before it tipped over"
    yield Cause("motors switched off in the air", 0.95, f"{text}{f', with {reason!r}' if reason else ''}")


def _message_between(flight: LoggedFlight, events: Sequence[Event], first_s: float, last_s: float) -> str:
    """The last message between two times."""
    texts = [
        e.text
        for e in events
        if e.kind == "message" and first_s <= flight.clock.seconds(e.boot, e.time_ns) <= last_s
    ]
    return plain_words(texts[0]) if texts else ""


def _motor_lost(flight: LoggedFlight, motors: Sequence[Motor], begins_s: float) -> Iterator[Cause]:
    """One motor at full alone: it turned too slowly or too fast, or the vehicle fell towards it."""
    towards = lean_towards(flight, begins_s - 0.5, begins_s + 0.5)
    for motor in motors:
        inside = _between(motor.command, begins_s - 2.0, begins_s + 0.3)
        if not len(inside) or np.sum(inside.values >= AT_FULL) * motor.command.period_s < HELD_S:
            continue
        others = [_between(m.command, begins_s - 2.0, begins_s + 0.3) for m in motors if m is not motor]
        if sum(float(np.mean(o.values >= AT_FULL)) > 0.2 for o in others if len(o)) > 1:
            continue
        text = f"motor {motor.number} was driven at full"
        speed = _speed_change(motor, begins_s)
        if np.isfinite(speed) and speed < 0.8:
            slower = "stopped" if speed < STOPPED else f"turned {100.0 * (1.0 - speed):.0f} % slower"
            yield Cause(f"motor {motor.number} failed", 0.9, f"{text} while it {slower}")
        elif np.isfinite(speed) and speed > 1.3:
            percent = 100.0 * (speed - 1.0)
            yield Cause(f"propeller {motor.number} lost", 0.85, f"{text} and turned {percent:.0f} % faster")
        elif towards is not None and np.dot(towards, motor.place) > 0.5 * np.hypot(*towards) * np.hypot(
            *motor.place
        ):
            cause = f"thrust of motor {motor.number} lost"
            yield Cause(cause, 0.75, f"{text} while the vehicle fell towards it")
        elif towards is None and not np.isfinite(speed):
            yield Cause(f"thrust of motor {motor.number} lost", 0.7, f"{text} alone")


def _between(column: Column, first_s: float, last_s: float) -> Column:
    return column.where((column.time_s >= first_s) & (column.time_s <= last_s))


def _speed_change(motor: Motor, begins_s: float) -> float:
    """Its speed at the end over that of steady flight; NaN where it is not logged."""
    if motor.speed is None:
        return float("nan")
    steady = _between(motor.speed, begins_s - 30.0, begins_s - 3.0)
    last = _between(motor.speed, begins_s - 0.5, begins_s + 0.3)
    if not len(steady) or not len(last):
        return float("nan")
    return float(np.median(last.values) / max(1.0, np.median(steady.values)))


def _brown_out(flight: LoggedFlight, begins_s: float) -> Iterator[Cause]:
    board = flight.quantity("POWR.Vcc", "system_power.voltage5v_v", unit="V", stated="V")
    if board is not None:
        last = _between(board, begins_s - BEFORE_S, begins_s + 1.0)
        if len(last) and last.values.min() < limit("happened.brown_out").bad:
            volts = float(last.values.min())
            yield Cause("brown-out", 0.8, f"the board's supply fell to {volts:.2f} V")
    battery = read_battery(flight)
    if battery.voltage is not None and battery.cells:
        last = _between(battery.voltage, begins_s - BEFORE_S, begins_s + 1.0)
        if len(last) and last.values.min() / battery.cells < limit("happened.empty_cell").bad:
            cell = float(last.values.min()) / battery.cells
            yield Cause("empty battery", 0.8, f"the battery fell to {cell:.2f} V a cell")


def _glitch(flight: LoggedFlight, begins_s: float) -> Iterator[Cause]:
    size_m, at_s = find_jump(read_receiver(flight))
    if size_m >= limit("estimator.gps_jump").bad and begins_s - BEFORE_S <= at_s <= begins_s:
        yield Cause("GPS glitch", 0.7, f"the GPS jumped {size_m:.0f} m, {begins_s - at_s:.1f} s before")


def _shaken(flight: LoggedFlight, begins_s: float) -> Iterator[Cause]:
    """Vibration beyond ArduPilot's limit while the height no longer fits."""
    for thing in flight.things("VIBE")[:1]:
        shaking = flight.quantity(f"{thing}.VibeZ", unit="m/s/s", stated="m/s/s")
        if shaking is None:
            continue
        last = _between(shaking, begins_s - BEFORE_S, begins_s - 0.5)
        if len(last) and np.median(last.values) >= limit("vibration.ardupilot_vibe").bad:
            level = float(np.median(last.values))
            yield Cause("vibration into the estimator", 0.6, f"VibeZ was {level:.0f} m/s2 before")


STATED = {
    "crash": ("", 0.0),
    "more than": ("", 0.0),
    "radio": ("radio lost", 0.5),
    "throttle": ("radio lost", 0.5),
    "rc ": ("radio lost", 0.5),
    "manual control": ("radio lost", 0.4),
    "battery": ("battery failsafe", 0.5),
    "ekf": ("estimator failed", 0.5),
    "estimate": ("estimator failed", 0.5),
    "gps": ("GPS glitch", 0.5),
    "kill": ("stopped by the pilot", 0.6),
    "motor": ("motor failure", 0.6),
    "thrust": ("motor failure", 0.6),
    "esc ": ("motor failure", 0.6),
}
"""Words of a stated failure -> cause and its weight; 0 for what is the crash itself."""


def _stated(begins_s: float, stated: Sequence[Failure]) -> Iterator[Cause]:
    """What the firmware states in the seconds before."""
    named: set[str] = set()
    for failure in stated:
        if not begins_s - BEFORE_S <= failure.at_s <= begins_s:
            continue
        for word, (name, weight) in STATED.items():
            if word in f"{failure.words.lower()} " and name not in named:
                named.add(name)
                if weight:
                    yield Cause(name, weight, f"{failure.words!r} at {failure.at_s:.1f} s")
                break
