"""Limits of a log: time flown, and what was lost."""

from __future__ import annotations

from collections.abc import Iterator

from flysid.facts.losses import lost_words
from flysid.reviews.fact import Fact, Finding, Grade, Section
from flysid.reviews.figures import absent, fact_of
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.remedies import remedy
from flysid.showing import significant


def review(flight: LoggedFlight) -> Section:
    """Section "What this log can show"."""
    findings: tuple[Finding, ...] = ()
    if not flight.was_flown:
        ground = f"{significant(flight.duration_s)} s on the ground"
        text = "The vehicle did not fly in this log"
        findings = (Finding(text, Grade.WATCH, 1.0, "trust.flown", ground),)
    return Section("trust", "What this log can show", tuple(_facts(flight)), findings)


def _facts(flight: LoggedFlight) -> Iterator[Fact]:
    yield fact_of("trust.duration", flight.duration_s)
    seconds = flight.flown.seconds
    if seconds is None:
        needed = remedy(flight, "arming", "log when the vehicle is armed")
        yield absent("trust.flown", "the log states neither arming nor landing", needed)
    else:
        yield fact_of("trust.flown", seconds, note="; ".join(flight.flown.never))
    lost = lost_words(flight.damage)
    yield fact_of("trust.lost", lost or "nothing", grade=Grade.WATCH if lost else Grade.GOOD)
