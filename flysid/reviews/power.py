"""Power and motors: what hovering takes and leaves, how motors share it, what the battery loses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from flysid.ingest.lake.motors import Motor, is_multicopter, read_motors
from flysid.reviews import battery_facts, drive, esc, motor_balance, thrust_loss
from flysid.reviews.battery import Battery, read_battery
from flysid.reviews.fact import Action, Change, Fact, Finding, Grade, Section, Shown
from flysid.reviews.hover import STATED, Hover, measure_hover
from flysid.reviews.limits import limit
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.remedies import remedy
from flysid.showing import significant


def review(flight: LoggedFlight) -> Section:
    """Section "Power and motors"."""
    battery = read_battery(flight)
    motors = _carrying(flight) if is_multicopter(flight) else _driving(flight, battery)
    of_battery = (*battery_facts.facts(flight, battery, remedy(flight, "current")), *_board_facts(flight))
    facts = (*motors.facts, *of_battery)
    shown = (*motors.shown, *battery_facts.picture(battery))
    if not flight.was_flown:
        return replace(motors, facts=facts, findings=(), actions=(), shown=shown)
    findings = (*motors.findings, *battery_facts.findings(of_battery))
    actions = (*motors.actions, *battery_facts.actions(of_battery))
    return replace(motors, facts=facts, findings=findings, actions=actions, shown=shown)


def _section(
    facts: tuple[Fact, ...],
    findings: tuple[Finding, ...],
    actions: tuple[Action, ...],
    shown: tuple[Shown, ...] = (),
) -> Section:
    return Section("power", "Power and motors", facts, findings, actions, shown)


def _carrying(flight: LoggedFlight) -> Section:
    """What a multicopter's motors show."""
    motors = read_motors(flight)
    balance = motor_balance.weigh(flight, motors)
    hover = measure_hover(flight)
    loss = thrust_loss.find_thrust_loss(flight, motors)
    facts = (
        *_hover_facts(flight, hover),
        *_range_facts(flight, motors if balance is not None else ()),
        *motor_balance.facts(balance, motors, remedy(flight, "motors")),
        *esc.facts(flight, motors),
        *thrust_loss.facts(loss),
    )
    level = replace(hover, share=float("nan")) if _saturates(facts) else hover
    findings = (
        *motor_balance.findings(balance),
        *_hover_findings(flight, level),
        *_range_findings(flight, facts),
        *esc.findings(facts),
        *thrust_loss.findings(loss),
    )
    actions = (*motor_balance.actions(balance), *_hover_actions(flight, level), *esc.actions(facts))
    return _section(facts, findings, actions, tuple(motor_balance.plan(balance)))


def _driving(flight: LoggedFlight, battery: Battery) -> Section:
    """What the motor of a plane or a rover shows."""
    facts = (*drive.facts(flight, battery), *esc.facts(flight, ()))
    stops = facts[0]
    findings = (*drive.findings(stops), *esc.findings(facts))
    return _section(facts, findings, tuple(drive.actions(stops)))


# ------------------------------------------------------------------------------------------- hovering


def _hover_facts(flight: LoggedFlight, hover: Hover) -> Iterator[Fact]:
    if not np.isfinite(hover.share):
        reason = "no steady flight in which the thrust is logged"
        yield Fact("power.hover_throttle", "hover throttle", missing=reason, remedy=remedy(flight, "motors"))
        return
    known = limit("power.hover")
    yield Fact(
        "power.hover_throttle",
        "hover throttle",
        hover.share,
        "",
        hover.interval,
        known.grade(hover.share),
        known.source,
        (hover.field,),
    )
    yield Fact("power.headroom", "full thrust over weight", 1.0 / hover.share, "", fields=(hover.field,))
    if np.isfinite(hover.stated) and hover.stated > 0.0:
        change = hover.share / hover.stated - 1.0
        name = STATED[flight.family]
        learns = "; the firmware learns it in flight" if hover.learns else ""
        yield Fact(
            "power.hover_change",
            f"hover throttle over {name}",
            100.0 * change,
            "%",
            grade=limit("power.hover_change").grade(abs(change)),
            note=f"{name} is {significant(hover.stated)}{learns}",
            fields=(hover.field,),
        )


def _hover_findings(flight: LoggedFlight, hover: Hover) -> Iterator[Finding]:
    if not np.isfinite(hover.share):
        return
    change = hover.share / hover.stated - 1.0 if hover.stated > 0.0 else 0.0
    changed = limit("power.hover_change").grade(abs(change))
    needs = limit("power.hover").grade(hover.share)
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
    if limit("power.hover_change").grade(abs(change)) is Grade.GOOD or low <= 0.0 <= high:
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
    known = limit("power.saturated")
    for key, label, shares in (
        ("power.saturated", "time with a motor at full", full),
        ("power.at_minimum", "time with a motor at its least", least),
    ):
        worst = int(np.argmax(shares))
        motor, command = spent[worst]
        highest = float(command.time_s[np.argmax(command.values)])
        yield Fact(
            key,
            label,
            100.0 * shares[worst],
            "%",
            grade=known.grade(shares[worst]),
            note=f"motor {motor.number}, the worst",
            fields=(motor.command.address,),
            at_s=highest if shares is full else None,
        )


def _saturates(facts: tuple[Fact, ...]) -> bool:
    """Whether motors were at full for so long that their mean is not what hovering takes."""
    full = next((fact for fact in facts if fact.key == "power.saturated"), None)
    return full is not None and full.grade.rank >= Grade.WATCH.rank


def _range_findings(flight: LoggedFlight, facts: tuple[Fact, ...]) -> Iterator[Finding]:
    words = {"power.saturated": "full thrust", "power.at_minimum": "its least"}
    if flight.family not in STATED:
        del words["power.at_minimum"]  # a racer dives with its motors idle
    for fact in facts:
        if fact.key in words and fact.grade.rank >= Grade.WATCH.rank and isinstance(fact.value, float):
            motor = fact.note.partition(",")[0]
            text = f"{motor.capitalize()} is at {words[fact.key]} {fact.value:.0f} % of the flight"
            yield Finding(text, Grade.WATCH, 0.5, fact.key, "the controller cannot do more there")


def _board_facts(flight: LoggedFlight) -> Iterator[Fact]:
    board = flight.quantity("POWR.Vcc", "system_power.voltage5v_v", "POWER_STATUS.Vcc", unit="V", stated="V")
    if board is None:
        return
    flown = board.where(flight.flying(board.time_s))
    if len(flown) < 10:
        return
    ripple = float(np.ptp(np.percentile(flown.values, [0.5, 99.5])))
    known = limit("power.board_ripple")
    yield Fact(
        "power.board_ripple",
        "ripple of the board's supply",
        ripple,
        "V",
        grade=known.grade(ripple),
        note=known.source,
        fields=(board.address,),
        at_s=float(flown.time_s[np.argmin(flown.values)]),
    )
