"""Power and motors: hover throttle and headroom, motor balance, battery sag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from flysid.ingest.lake.motors import Motor, is_multicopter, read_motors
from flysid.reviews import battery_facts, motor_balance, motor_loss
from flysid.reviews.battery import Battery, read_battery
from flysid.reviews.fact import Action, Change, Fact, Finding, Grade, Section
from flysid.reviews.figures import absent, actions_of, exceeded, fact_of, findings_of, limit
from flysid.reviews.hover import STATED, Hover, measure_hover
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.remedies import remedy
from flysid.showing import significant

TITLE = "Power and motors"


def review(flight: LoggedFlight) -> Section:
    """Section "Power and motors"."""
    battery = read_battery(flight)
    parts = _carrying(flight) if is_multicopter(flight) else _driving(flight, battery)
    of_battery = battery_facts.facts(flight, battery, remedy(flight, "current"))
    facts = (*parts.facts, *of_battery, *_board_facts(flight))
    shown = (*parts.shown, *battery_facts.picture(battery))
    if not flight.was_flown:
        return replace(parts, facts=facts, findings=(), actions=(), shown=shown)
    findings = (*parts.findings, *battery_facts.findings(of_battery), *findings_of(facts))
    actions = (*parts.actions, *actions_of(facts), *battery_facts.actions(of_battery))
    return replace(parts, facts=facts, findings=findings, actions=actions, shown=shown)


def _carrying(flight: LoggedFlight) -> Section:
    """What a multicopter's motors show."""
    motors = read_motors(flight)
    balance = motor_balance.weigh(flight, motors)
    hover = measure_hover(flight)
    loss = motor_loss.find_thrust_loss(flight, motors)
    facts = (
        *_hover_facts(flight, hover),
        *_range_facts(flight, motors if balance is not None else ()),
        *motor_balance.facts(balance, motors, remedy(flight, "motors")),
        *motor_loss.esc_facts(flight, motors),
        *([loss.fact] if loss else []),
    )
    # where motors are at full for long, their mean is not what hovering takes
    level = replace(hover, share=np.nan) if "power.saturated" in exceeded(facts) else hover
    findings = (
        *motor_balance.findings(balance),
        *_hover_findings(flight, level),
        *_range_findings(flight, facts),
        *([loss.finding] if loss else []),
    )
    actions = (*motor_balance.actions(balance), *_hover_actions(flight, level))
    return Section("power", TITLE, facts, findings, actions, tuple(motor_balance.plan(balance)))


def _driving(flight: LoggedFlight, battery: Battery) -> Section:
    """What the motor of a plane or a rover shows."""
    facts = (motor_loss.motor_stop(flight, battery), *motor_loss.esc_facts(flight, ()))
    return Section("power", TITLE, facts)


# ------------------------------------------------------------------------------------------- hovering


def _hover_facts(flight: LoggedFlight, hover: Hover) -> Iterator[Fact]:
    if not np.isfinite(hover.share):
        reason = "no steady flight in which the thrust is logged"
        yield absent("power.hover_throttle", reason, remedy(flight, "motors"))
        return
    fields = (hover.field,)
    yield fact_of("power.hover_throttle", hover.share, fields, interval=hover.interval)
    yield fact_of("power.headroom", 1.0 / hover.share, fields)
    if np.isfinite(hover.stated) and hover.stated > 0.0:
        change = 100.0 * (hover.share / hover.stated - 1.0)
        name, grade = STATED[flight.family], limit("power.hover_change").grade(abs(change))
        learns = "; the firmware learns it in flight" if hover.learns else ""
        note = f"{name} is {significant(hover.stated)}{learns}"
        yield fact_of("power.hover_change", change, fields, note=note, grade=grade, name=name)


def _hover_findings(flight: LoggedFlight, hover: Hover) -> Iterator[Finding]:
    if not np.isfinite(hover.share):
        return
    change = hover.share / hover.stated - 1.0 if hover.stated > 0.0 else 0.0
    changed = limit("power.hover_change").grade(100.0 * abs(change))
    needs = limit("power.hover_throttle").grade(hover.share)
    text = f"Hovering takes {hover.share:.2f} of full thrust"
    if changed is not Grade.GOOD:
        name = STATED[flight.family]
        words = f"{text}, {abs(100.0 * change):.0f} % {'more' if change > 0.0 else 'less'} than {name} says"
        grade = needs if needs is Grade.BAD else Grade.WATCH
        more = f"{name} is {hover.stated:.2f}: another load, battery or propeller than it was set with"
        yield Finding(words, grade, 0.65, "power.hover_change", more)
        return
    more = "little is left to climb and to hold the attitude" if needs is not Grade.GOOD else ""
    yield Finding(text, needs, 0.6 if more else 0.3, "power.hover_throttle", more)


def _hover_actions(flight: LoggedFlight, hover: Hover) -> Iterator[Action]:
    if hover.learns or not (np.isfinite(hover.share) and hover.stated > 0.0):
        return
    change = hover.share / hover.stated - 1.0
    low, high = (edge / hover.stated - 1.0 for edge in hover.interval)
    if limit("power.hover_change").grade(100.0 * abs(change)) is Grade.GOOD or low <= 0.0 <= high:
        return
    name = STATED[flight.family]
    way = "drop" if change > 0.0 else "jump"
    new = float(np.clip(round(hover.share, 2), 0.5 * hover.stated, 2.0 * hover.stated))
    yield Action(
        "Tell the controller the hover thrust",
        f"hovering takes {hover.share:.2f}, {name} says {hover.stated:.2f}",
        (Change(name, hover.stated, new),),
        f"no {way} when altitude control takes over: {abs(100.0 * change):.0f} % of the weight",
        "the throttle stick's middle moves with it where altitude is not held",
        0.55,
        "power.hover_change",
    )


# ------------------------------------------------------------------------------------------- the range


def _range_facts(flight: LoggedFlight, motors: tuple[Motor, ...]) -> Iterator[Fact]:
    """How long a motor was at its end, of the worst one; 0.1 % of the range count as the end."""
    spent = [(motor, motor.command.where(flight.flying(motor.command.time_s))) for motor in motors]
    spent = [(motor, command) for motor, command in spent if len(command)]
    if not spent:
        return
    full = [float(np.mean(command.values >= 0.999)) for _, command in spent]
    least = [float(np.mean(command.values <= max(0.001, command.values.min()))) for _, command in spent]
    for key, shares in (("power.saturated", full), ("power.at_minimum", least)):
        worst = int(np.argmax(shares))
        motor, command = spent[worst]
        at_s = float(command.time_s[np.argmax(command.values)]) if shares is full else None
        note = f"motor {motor.number}, the worst"
        yield fact_of(key, 100.0 * shares[worst], (motor.command.address,), note=note, at_s=at_s)


def _range_findings(flight: LoggedFlight, facts: tuple[Fact, ...]) -> Iterator[Finding]:
    words = {"power.saturated": "full thrust", "power.at_minimum": "its least"}
    if flight.family not in STATED:
        del words["power.at_minimum"]  # a racer dives with its motors idle
    for key, fact in exceeded(facts).items():
        if key in words:
            motor = fact.note.partition(",")[0]
            text = f"{motor.capitalize()} is at {words[key]} {fact.value:.0f} % of the flight"
            yield Finding(text, Grade.WATCH, 0.5, key, "the controller cannot do more there")


def _board_facts(flight: LoggedFlight) -> Iterator[Fact]:
    board = flight.quantity("POWR.Vcc", "system_power.voltage5v_v", "POWER_STATUS.Vcc", unit="V", stated="V")
    flown = None if board is None else board.where(flight.flying(board.time_s))
    if flown is not None and len(flown) >= 10:
        ripple = float(np.ptp(np.percentile(flown.values, [0.5, 99.5])))
        at_s = float(flown.time_s[np.argmin(flown.values)])
        yield fact_of("power.board_ripple", ripple, (flown.address,), at_s=at_s)
