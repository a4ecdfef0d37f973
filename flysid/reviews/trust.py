"""Limits of a log: time flown, and what was lost."""

from __future__ import annotations

from collections.abc import Iterator

from flysid.facts.losses import lost_words
from flysid.ingest.excitation.enough import FLY_MORE, MIN_DURATION_S
from flysid.reviews.fact import Fact, Finding, Grade, Section
from flysid.reviews.figures import absent, fact_of, limit
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.remedies import remedy
from flysid.showing import significant


def review(flight: LoggedFlight) -> Section:
    """Section "What this log can show"."""
    return Section("trust", "What this log can show", tuple(_facts(flight)), tuple(_findings(flight)))


def _findings(flight: LoggedFlight) -> Iterator[Finding]:
    """What `flysid doctor` says of it, too: it did not fly, or too short."""
    if not flight.was_flown:
        ground = f"{significant(flight.duration_s)} s on the ground"
        yield Finding("The vehicle did not fly in this log", Grade.WATCH, 1.0, "trust.flown", ground)
        return
    flown_s, words = flight.flight_s, f"{significant(flight.flight_s)} s"
    if flight.flown.seconds is not None:
        words += " in the air"
    if flown_s < limit("tracking.rate").least_s:
        yield Finding(f"{words}: too short to judge", Grade.WATCH, 1.0, "trust.duration", FLY_MORE)
    elif flown_s < MIN_DURATION_S:
        text = f"{words}: too short to judge how it follows"
        yield Finding(text, Grade.WATCH, 0.3, "trust.duration", FLY_MORE)


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
