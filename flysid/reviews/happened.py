"""What happened: modes, arming, failsafes, parameter changes, impacts, and how the flight ended."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.facts.modes import family_of
from flysid.ingest.lake.attitude import tilt_error
from flysid.ingest.lake.crash import Crash, acceleration, find_crash
from flysid.ingest.lake.events import Event, events
from flysid.ingest.lake.failures import plain_words
from flysid.ingest.lake.motors import read_motors
from flysid.reviews.causes import Cause, rank_causes
from flysid.reviews.fact import Fact, Finding, Grade, Section, Table
from flysid.reviews.failures import Failure, stated_failures
from flysid.reviews.figures import absent, fact_of
from flysid.reviews.flyaway import Flyaway, find_flyaway
from flysid.reviews.landing import HardLanding, find_hard_landing
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.motor_loss import first_lasting
from flysid.showing import clock

ROWS = 60
"""Of the table: a page that a person reads."""
BOOKKEEPING = ("STAT_", "SR0_", "SR1_", "SR2_", "SR3_", "MIS_TOTAL", "COMPASS_OFS", "BARO", "INS_", "CAL_")
"""Parameters that a firmware writes itself."""
APART_DEG = 20.0
"""Of the commanded tilt: ArduPilot's crash check takes 30, so that this comes first."""
LASTING_S = 0.3
LIKELY = 0.7
"""Weight of a cause that the headline names."""
JUST_S = 0.5
"""Before a failsafe the vehicle still flew, although it may have been disarmed by it."""


def review(flight: LoggedFlight) -> Section:
    """Section "What happened"."""
    story = Story(flight, tuple(events(flight.log)))
    findings = tuple(_findings(story)) if flight.was_flown else ()
    return Section("happened", "What happened", tuple(_facts(story)), findings, (), tuple(_tables(story)))


@dataclass(frozen=True)
class Story:
    """What a log states of its flight, and how the flight ended."""

    flight: LoggedFlight
    events: tuple[Event, ...]

    @cached_property
    def failures(self) -> list[Failure]:
        """That the log states."""
        return stated_failures(self.flight, self.events)

    @cached_property
    def crash(self) -> Crash | None:
        """By its sensors."""
        return find_crash(self.flight)

    @cached_property
    def landing(self) -> HardLanding | None:
        """A hard one, where it did not crash."""
        return find_hard_landing(self.flight) if self.crash is None else None

    @cached_property
    def flyaway(self) -> Flyaway | None:
        """From the position that it was to hold, before anything ended the flight."""
        return find_flyaway(self.flight)

    @property
    def ended_badly(self) -> bool:
        """By its sensors, or by the log's own words."""
        return self.crash is not None or bool(np.isfinite(self.flight.ends_s))

    @property
    def begins_s(self) -> float:
        """When it went wrong; infinite where it did not."""
        return self.flight.ends_s if self.crash is None else min(self.crash.begins_s, self.flight.ends_s)

    @cached_property
    def causes(self) -> list[Cause]:
        """The likeliest first."""
        return self.causes_before(self.begins_s) if self.ended_badly else []

    def causes_before(self, time_s: float) -> list[Cause]:
        """What the seconds before a time speak for."""
        return rank_causes(self.flight, time_s, self.events, self.failures)

    def seconds(self, event: Event) -> float:
        """Of an event, on the log's clock."""
        return self.flight.clock.seconds(event.boot, event.time_ns)

    @cached_property
    def changed(self) -> list[Event]:
        """Changes of parameters that somebody made while it flew."""
        found = [e for e in self.events if e.kind == "parameter" and not e.text.startswith(BOOKKEEPING)]
        times = np.array([self.seconds(event) for event in found])
        return [event for event, flying in zip(found, self.flight.flying(times), strict=True) if flying]


# ------------------------------------------------------------------------------------------- facts


def _facts(story: Story) -> Iterator[Fact]:
    flight, crash, failures = story.flight, story.crash, story.failures
    modes = [event.text for event in story.events if event.kind == "mode"]
    if modes:
        yield fact_of("happened.modes", ", ".join(dict.fromkeys(modes)))
    else:
        yield absent("happened.modes", "the log states no mode")
    if flight.flown.seconds:
        yield fact_of("happened.air", "; ".join(f"{clock(a)} to {clock(b)}" for a, b in flight.air_s[:5]))
    words = "; ".join(f"{failure.words} at {failure.at_s:.1f} s" for failure in failures[:3]) or "none"
    first_s = failures[0].at_s if failures else None
    grade = Grade.WATCH if failures else Grade.GOOD
    yield fact_of("happened.failsafes", words, grade=grade, at_s=first_s)
    yield fact_of("happened.parameter_changes", "; ".join(e.text for e in story.changed[:3]) or "none")
    yield from _departure(flight)
    yield from [story.flyaway.fact] if story.flyaway else ()
    yield from _impact(story)
    if crash is not None and np.isfinite(crash.tipped_s):
        yield fact_of("happened.tipped_over", crash.tipped_s, grade=Grade.BAD, at_s=crash.tipped_s)
    if story.ended_badly:
        likely = f"{story.causes[0].name}: {story.causes[0].evidence}" if story.causes else None
        missing = "" if story.causes else "nothing in the ten seconds before speaks for one cause"
        yield fact_of("happened.cause", likely, grade=Grade.BAD, missing=missing)


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
    at = first_lasting(flown.values > APART_DEG, max(1, round(LASTING_S * flown.rate_hz)))
    at_s = None if at is None else float(flown.time_s[at])
    value = f"never; at most {float(flown.values.max()):.0f} deg" if at_s is None else at_s
    grade = Grade.GOOD if at_s is None else Grade.WATCH
    yield fact_of("happened.departure", value, (flown.address,), grade=grade, at_s=at_s, degrees=APART_DEG)


def _impact(story: Story) -> Iterator[Fact]:
    key, crash, landing = "happened.impact", story.crash, story.landing
    if crash is not None and np.isfinite(crash.impact_s):
        fields, at_s = (crash.field,), crash.impact_s
        which = "hardest impact"
        yield fact_of(key, crash.impact_m_s2, fields, at_s=at_s, grade=Grade.BAD, which=which)
        return
    if landing is not None:
        fields, at_s, note = (landing.field,), landing.at_s, "at touch-down"
        grade = landing.grade
        yield fact_of("happened.landing", landing.impact_m_s2, fields, at_s=at_s, note=note, grade=grade)
    felt = acceleration(story.flight)
    flown = None if felt is None else felt.where(story.flight.flying(felt.time_s))
    if flown is not None and len(flown):
        at = int(np.argmax(flown.values))
        value, at_s = float(flown.values[at]), float(flown.time_s[at])
        yield fact_of(key, value, (flown.address,), at_s=at_s, which="largest acceleration")


# ------------------------------------------------------------------------------------------- findings


def _findings(story: Story) -> Iterator[Finding]:
    flight, crash, landing = story.flight, story.crash, story.landing
    likely = f"likely cause: {story.causes[0].evidence}" if story.causes else "the cause is not determined"
    named = f": {story.causes[0].name}" if story.causes and story.causes[0].weight >= LIKELY else ""
    if crash is not None:
        evidence = "happened.impact" if np.isfinite(crash.impact_s) else "happened.departure"
        yield Finding(f"{_crash_words(crash)}{named}", Grade.BAD, 1.0, evidence, likely)
    elif story.ended_badly:
        last = next(
            m for m in flight.failures if m.ends and flight.clock.seconds(m.boot, m.span[0]) == flight.ends_s
        )
        way = "drive" if _drives(flight) else "flight"
        text = f"The {way} ended badly at {flight.ends_s:.0f} s{named or f': {last.what}'}"
        more = f"{last.what}; {likely}" if named else likely
        yield Finding(text, Grade.BAD, 1.0, "happened.cause", more)
    yield from [story.flyaway.finding] if story.flyaway else ()
    yield from _failure_finding(story)
    if landing is not None:
        grade = landing.grade
        text = f"Landed hard at {landing.at_s:.0f} s: {landing.impact_m_s2:.0f} m/s2"
        more = f"sinking at {landing.sink_m_s:.1f} m/s" if np.isfinite(landing.sink_m_s) else ""
        yield Finding(text, grade, 0.75, "happened.landing", more)
    if crash is None and _ends_in_the_air(story):
        yield _cut_off(story)


def _crash_words(crash: Crash) -> str:
    """ "Tipped over at 35 s, impact 392 m/s2 at 35.8 s"."""
    if not np.isfinite(crash.impact_s):
        return f"Crashed at {crash.begins_s:.0f} s: {crash.words}"
    impact = f"impact {crash.impact_m_s2:.0f} m/s2 at {crash.impact_s:.1f} s"
    tipped = np.isfinite(crash.tipped_s)
    return f"Tipped over at {crash.tipped_s:.0f} s, {impact}" if tipped else f"Crashed: {impact}"


def _drives(flight: LoggedFlight) -> bool:
    """Whether it stays on the ground or the water."""
    return flight.family == "ardupilot" and family_of(flight.info.get("vehicle", "")) == "rover"


def _failure_finding(story: Story) -> Iterator[Finding]:
    """The first failure in the air, before it crashed: grave where the firmware acted on it."""
    flight = story.flight
    flying = flight.flying(np.array([failure.at_s for failure in story.failures]) - JUST_S)
    flown = [f for f, flew in zip(story.failures, flying, strict=True) if flew and f.at_s < story.begins_s]
    if not flown:
        return
    first = next((failure for failure in flown if failure.mode), flown[0])
    acted = first.stated or bool(first.mode)
    others = [f"{f.words} at {f.at_s:.0f} s" for f in flown if f is not first]
    grade, weight = (Grade.BAD, 0.85) if acted else (Grade.WATCH, 0.6)
    yield Finding(first.sentence, grade, weight, "happened.failsafes", "; ".join(others[:2]))


def _ends_in_the_air(story: Story) -> bool:
    """Whether the log stops while it flies, as far as the log states when it flies."""
    flight = story.flight
    if flight.flown.spans is None or not flight.air_s:
        return False
    lasts = max(last for _, last in flight.air_s) >= flight.duration_s - 0.5
    if flight.family in ("ardupilot", "px4"):
        return lasts
    return lasts and flight.has("main") and not flight.is_closed and _carries(flight)


def _carries(flight: LoggedFlight) -> bool:
    """Whether the motors still carry the vehicle in the last moment: a racer is disarmed on the ground."""
    motors = read_motors(flight)
    if not motors:
        return False
    times = motors[0].command.time_s
    mean = np.mean([motor.command.at(times) for motor in motors], axis=0)
    end = times > times[-1] - JUST_S
    return bool(np.nanmedian(mean[end]) > 0.5 * np.nanmedian(mean))


def _cut_off(story: Story) -> Finding:
    at_s = story.flight.duration_s
    where = "on the way" if _drives(story.flight) else "in the air"
    causes = [c for c in story.causes_before(at_s) if c.weight >= LIKELY]
    if causes:
        text = f"The log ends {where} at {at_s:.0f} s: {causes[0].name}"
        return Finding(text, Grade.BAD, 0.95, "happened.air", causes[0].evidence)
    text = f"The log ends {where} at {at_s:.0f} s: its power was lost, or the log was cut"
    return Finding(
        text, Grade.PLAIN, 0.4, "happened.air", "not determined: nothing before speaks for one of them"
    )


# ------------------------------------------------------------------------------------------- tables


def _tables(story: Story) -> Iterator[Table]:
    flight, crash = story.flight, story.crash
    lines = [
        (story.seconds(event), event.kind, plain_words(event.text))
        for event in story.events
        if event.kind != "parameter" and "logger" not in event.text.lower()
    ]
    lines += [(story.seconds(event), "parameter", event.text) for event in story.changed]
    for first, last in flight.air_s if flight.flown.seconds else ():
        lines += [(first, "flight", "in the air"), (last, "flight", "on the ground, or the end of the log")]
    lines += [(flight.clock.seconds(m.boot, m.span[0]), "failure", m.what) for m in flight.failures]
    if crash is not None:
        if np.isfinite(crash.tipped_s):
            lines.append((crash.tipped_s, "crash", "tipped over"))
        if np.isfinite(crash.impact_s):
            lines.append((crash.impact_s, "crash", f"impact {crash.impact_m_s2:.0f} m/s2"))
    if lines:
        yield _event_table(sorted(lines, key=lambda line: line[0])[:ROWS])
    if story.causes:
        rows = tuple((f"{i}", cause.name, cause.evidence) for i, cause in enumerate(story.causes, 1))
        yield Table("Likely causes", ("rank", "cause", "evidence"), rows)


def _event_table(lines: Sequence[tuple[float, str, str]]) -> Table:
    rows = tuple((f"{max(0.0, at_s):.1f} s", kind, text) for at_s, kind, text in lines)
    return Table("Events", ("time", "kind", "what"), rows, tuple(at_s for at_s, _, _ in lines))
