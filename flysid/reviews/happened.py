"""What happened: modes, arming, failsafes, parameter changes, impacts, and how the flight ended."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.ingest.lake.events import Event, events
from flysid.reviews.attitude import tilt_error
from flysid.reviews.causes import Cause, plain_words, rank_causes
from flysid.reviews.crash import Crash, acceleration, find_crash
from flysid.reviews.fact import Fact, Finding, Grade, Section, Table
from flysid.reviews.logged import LoggedFlight

ROWS = 60
"""Of the table: a page that a person reads."""
BOOKKEEPING = ("STAT_", "SR0_", "SR1_", "SR2_", "SR3_", "MIS_TOTAL", "COMPASS_OFS", "BARO", "INS_", "CAL_")
"""Parameters that a firmware writes itself."""
APART_DEG = 20.0
"""Of the commanded tilt: ArduPilot's crash check takes 30, so that this comes first."""
LASTING_S = 0.3
JUST_S = 0.5
"""Before a failsafe the vehicle still flew, although it may have been disarmed by it."""


def review(flight: LoggedFlight) -> Section:
    """Section "What happened"."""
    stated_events = events(flight.log)
    crash = find_crash(flight)
    causes = rank_causes(flight, _begin(flight, crash), stated_events) if _ended_badly(flight, crash) else []
    facts = tuple(_facts(flight, stated_events, crash, causes))
    findings = tuple(_findings(flight, stated_events, crash, causes))
    return Section(
        "happened", "What happened", facts, findings, (), tuple(_tables(flight, stated_events, crash, causes))
    )


def _ended_badly(flight: LoggedFlight, crash: Crash | None) -> bool:
    return crash is not None or np.isfinite(flight.ends_s)


def _begin(flight: LoggedFlight, crash: Crash | None) -> float:
    return flight.ends_s if crash is None else min(crash.begins_s, flight.ends_s)


def _seconds(flight: LoggedFlight, event: Event) -> float:
    return flight.clock.seconds(event.boot, event.time_ns)


# ------------------------------------------------------------------------------------------- facts


def _facts(
    flight: LoggedFlight, stated_events: Sequence[Event], crash: Crash | None, causes: Sequence[Cause]
) -> Iterator[Fact]:
    modes = [event.text for event in stated_events if event.kind == "mode"]
    if modes:
        yield Fact("happened.modes", "flight modes", ", ".join(dict.fromkeys(modes)))
    else:
        yield Fact("happened.modes", "flight modes", missing="the log states no mode")
    if flight.flown.seconds:
        spans = "; ".join(f"{clock_words(a)} to {clock_words(b)}" for a, b in flight.air_s[:5])
        yield Fact("happened.air", "in the air", spans)
    failsafes = _failsafes(flight, stated_events)
    words = "; ".join(f"{text} at {at_s:.1f} s" for at_s, text in failsafes[:3])
    first_s = failsafes[0][0] if failsafes else None
    grade = Grade.WATCH if failsafes else Grade.GOOD
    yield Fact("happened.failsafes", "failsafes and errors", words or "none", grade=grade, at_s=first_s)
    changed = _changed_in_the_air(flight, stated_events)
    value = "; ".join(event.text for event in changed[:3]) or "none"
    yield Fact("happened.parameter_changes", "parameters changed in the air", value)
    yield from _departure(flight)
    yield from _impact(flight, crash)
    if crash is not None and np.isfinite(crash.tipped_s):
        yield Fact(
            "happened.tipped_over", "tipped over", crash.tipped_s, "s", grade=Grade.BAD, at_s=crash.tipped_s
        )
    if _ended_badly(flight, crash):
        likely = f"{causes[0].name}: {causes[0].evidence}" if causes else None
        missing = "" if causes else "nothing in the ten seconds before speaks for one cause"
        yield Fact("happened.cause", "likely cause", likely, grade=Grade.BAD, missing=missing)


def _departure(flight: LoggedFlight) -> Iterator[Fact]:
    """When the tilt first left its command for good reason or bad."""
    error = tilt_error(flight)
    if error is None:
        return
    inside = np.zeros(len(error), dtype=bool)
    for first, last in flight.air_s:
        inside |= (error.time_s >= first) & (error.time_s <= last)
    flown = error.where(inside)
    if len(flown) < 10:
        return
    need = max(1, round(LASTING_S * flown.rate_hz))
    away = np.convolve(flown.values > APART_DEG, np.ones(need), "valid") >= need
    fields = (flown.address,)
    label = f"first {APART_DEG:.0f} deg away from the commanded tilt"
    if away.any():
        at_s = float(flown.time_s[np.argmax(away)])
        yield Fact("happened.departure", label, at_s, "s", None, Grade.WATCH, "", fields, at_s)
    else:
        most = float(flown.values.max())
        text = f"never; at most {most:.0f} deg"
        yield Fact("happened.departure", label, text, "", None, Grade.GOOD, "", fields)


def _impact(flight: LoggedFlight, crash: Crash | None) -> Iterator[Fact]:
    if crash is not None:
        yield Fact(
            "happened.impact",
            "hardest impact",
            crash.impact_m_s2,
            "m/s2",
            grade=Grade.BAD,
            fields=(crash.field,),
            at_s=crash.impact_s,
        )
        return
    felt = acceleration(flight)
    if felt is None:
        return
    flown = felt.where(flight.flying(felt.time_s))
    if len(flown):
        at = int(np.argmax(flown.values))
        value, at_s = float(flown.values[at]), float(flown.time_s[at])
        yield Fact(
            "happened.impact", "largest acceleration", value, "m/s2", fields=(felt.address,), at_s=at_s
        )


# ------------------------------------------------------------------------------------------- events


def _failsafes(flight: LoggedFlight, stated_events: Sequence[Event]) -> list[tuple[float, str]]:
    """When, and what: by the firmware's state, and by its messages where the state stays silent."""
    found = [(flight.clock.seconds(m.boot, m.span[0]), m.what) for m in flight.mishaps]
    messages = [(_seconds(flight, event), event.text) for event in stated_events if event.kind == "message"]
    for i, (at_s, text) in enumerate(messages):
        words = plain_words(text)
        if (
            "failsafe" not in text.lower()
            or "prearm" in text.lower()
            or not any(word in words.lower() for word in ("activated", "on", "failsafe:"))
        ):
            continue
        reason = next((t for s, t in reversed(messages[:i]) if at_s - s < 1.0), "")
        found.append((at_s, plain_words(reason) if "failsafe" not in reason.lower() and reason else words))
    return sorted(found)


def _changed_in_the_air(flight: LoggedFlight, stated_events: Sequence[Event]) -> list[Event]:
    """Changes of parameters that somebody made while it flew."""
    changed = [e for e in stated_events if e.kind == "parameter" and not e.text.startswith(BOOKKEEPING)]
    times = np.array([_seconds(flight, event) for event in changed])
    return [event for event, flying in zip(changed, flight.flying(times), strict=True) if flying]


def clock_words(seconds: float) -> str:
    """ "1:08" for 68 s."""
    return f"{int(seconds // 60)}:{int(seconds % 60):02d}"


# ------------------------------------------------------------------------------------------- findings


def _findings(
    flight: LoggedFlight, stated_events: Sequence[Event], crash: Crash | None, causes: Sequence[Cause]
) -> Iterator[Finding]:
    if not flight.was_flown:
        return
    likely = f"likely cause: {causes[0].evidence}" if causes else "the cause is not determined"
    if crash is not None:
        impact = f"impact {crash.impact_m_s2:.0f} m/s2 at {crash.impact_s:.1f} s"
        tipped = np.isfinite(crash.tipped_s)
        text = f"Tipped over at {crash.tipped_s:.0f} s, {impact}" if tipped else f"Crashed: {impact}"
        yield Finding(text, Grade.BAD, 1.0, "happened.impact", likely)
    elif np.isfinite(flight.ends_s):
        last = next(m for m in flight.mishaps if flight.clock.seconds(m.boot, m.span[0]) == flight.ends_s)
        text = f"The flight ended badly at {flight.ends_s:.0f} s: {last.what}"
        yield Finding(text, Grade.BAD, 1.0, "happened.cause", likely)
    stated = _failsafes(flight, stated_events)
    flying = flight.flying(np.array([at_s for at_s, _ in stated]) - JUST_S)
    begins_s = _begin(flight, crash)
    failsafes = [found for found, flew in zip(stated, flying, strict=True) if flew and found[0] < begins_s]
    if failsafes:
        at_s, text = failsafes[0]
        yield Finding(f"Failsafe at {at_s:.0f} s: {text}", Grade.WATCH, 0.6, "happened.failsafes")
    if _ends_in_the_air(flight) and crash is None:
        yield from _cut_off(flight, stated_events)


def _ends_in_the_air(flight: LoggedFlight) -> bool:
    """Whether the log stops while it flies, as far as the log states when it flies."""
    if flight.family not in ("ardupilot", "px4") or flight.flown.spans is None or not flight.air_s:
        return False
    return max(last for _, last in flight.air_s) >= flight.duration_s - 0.5


def _cut_off(flight: LoggedFlight, stated_events: Sequence[Event]) -> Iterator[Finding]:
    causes = [c for c in rank_causes(flight, flight.duration_s, stated_events) if c.weight >= 0.7]
    at_s = flight.duration_s
    if causes:
        text = f"The log ends in the air at {at_s:.0f} s: {causes[0].name}"
        yield Finding(text, Grade.BAD, 0.95, "happened.air", causes[0].evidence)
    else:
        more = "power lost, a crash, or a log that was cut: not determined"
        yield Finding(f"The log ends in the air at {at_s:.0f} s", Grade.PLAIN, 0.4, "happened.air", more)


# ------------------------------------------------------------------------------------------- tables


def _tables(
    flight: LoggedFlight, stated_events: Sequence[Event], crash: Crash | None, causes: Sequence[Cause]
) -> Iterator[Table]:
    lines = [
        (_seconds(flight, event), event.kind, plain_words(event.text))
        for event in stated_events
        if event.kind != "parameter" and "logger" not in event.text.lower()
    ]
    lines += [
        (_seconds(flight, event), "parameter", event.text)
        for event in _changed_in_the_air(flight, stated_events)
    ]
    for first, last in flight.air_s if flight.flown.seconds else ():
        lines += [(first, "flight", "in the air"), (last, "flight", "on the ground, or the end of the log")]
    lines += [(flight.clock.seconds(m.boot, m.span[0]), "failsafe", m.what) for m in flight.mishaps]
    if crash is not None:
        if np.isfinite(crash.tipped_s):
            lines.append((crash.tipped_s, "crash", "tipped over"))
        lines.append((crash.impact_s, "crash", f"impact {crash.impact_m_s2:.0f} m/s2"))
    if lines:
        lines = sorted(lines, key=lambda line: line[0])
        shown = lines[:ROWS]
        rows = tuple((f"{max(0.0, at_s):.1f} s", kind, text) for at_s, kind, text in shown)
        yield Table("Events", ("time", "kind", "what"), rows, tuple(at_s for at_s, _, _ in shown))
    if causes:
        rows = tuple((f"{i}", cause.name, cause.evidence) for i, cause in enumerate(causes, 1))
        yield Table("Likely causes", ("rank", "cause", "evidence"), rows)
