"""The motor of a plane or a rover: does it draw current when the throttle asks for thrust?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from flysid.reviews.battery import Battery
from flysid.reviews.fact import Action, Fact, Finding, Grade
from flysid.reviews.logged import Column, LoggedFlight

DRIVEN = 0.25
"""Of the throttle: below it a plane's motor may idle."""
STOPPED = 0.3
"""Of the current that a throttle usually draws, above what the rest of the vehicle draws."""
LASTS_S = 1.0
KEY = "power.motor_stop"


def read_throttle(flight: LoggedFlight) -> Column | None:
    """Share of full throttle that the firmware asks for."""
    thing = next((name for name in ("CTUN", "THR") if flight.has(name)), "CTUN")
    asked = flight.quantity("CTUN.ThO", "THR.ThrOut") or flight.quantity(f"{thing}.ThO", unit="%")
    if asked is None or not len(asked):
        return None
    full = 100.0 if np.abs(asked.values).max() > 1.5 else 1.0
    return replace(asked, values=np.abs(asked.values) / full)


def facts(flight: LoggedFlight, battery: Battery) -> Iterator[Fact]:
    """When the motor stopped although the throttle was open."""
    throttle, current = read_throttle(flight), battery.current
    label = "motor that stops under throttle"
    if throttle is None or current is None:
        yield Fact(KEY, label, missing="throttle and current are not both in the log")
        return
    moving = flight.flying(current.time_s)
    share = np.fmin(throttle.held(current.time_s), throttle.held(current.time_s - LASTS_S))
    driven = moving & (share > DRIVEN)
    fields = (throttle.address, current.address)
    if driven.sum() * current.period_s < 10.0 * LASTS_S:
        yield Fact(KEY, label, missing="the throttle was hardly open", fields=fields)
        return
    resting = float(np.percentile(current.values, 1.0))
    drawn = (current.values - resting) / np.maximum(share, DRIVEN)
    first_half = drawn[driven][: max(10, int(driven.sum()) // 2)]
    low = driven & (drawn < STOPPED * float(np.median(first_half)))
    need = max(2, round(LASTS_S * current.rate_hz))
    runs = np.convolve(low, np.ones(need), "valid") >= need
    if not runs.any():
        yield Fact(KEY, label, "none", grade=Grade.GOOD, fields=fields)
        return
    at_s = float(current.time_s[int(np.argmax(runs))])
    at = int(np.argmax(runs))
    text = f"{100.0 * share[at]:.0f} % throttle draws {current.values[at]:.1f} A at {at_s:.1f} s"
    yield Fact(KEY, label, text, grade=Grade.BAD, fields=fields, at_s=at_s)


def findings(stated: Fact) -> Iterator[Finding]:
    """The motor stopped."""
    if stated.grade is Grade.BAD and stated.at_s is not None:
        text = f"The motor stops at {stated.at_s:.0f} s under throttle"
        more = f"{stated.value}: an ESC, a wire, a propeller or the fuel"
        yield Finding(text, Grade.BAD, 0.9, KEY, more)


def actions(stated: Fact) -> Iterator[Action]:
    """What to look at."""
    if stated.grade is Grade.BAD:
        order = "Check the motor: its ESC, wires and propeller"
        yield Action(
            order, f"{stated.value}", predicted="a current that follows the throttle", weight=0.8, fact=KEY
        )
