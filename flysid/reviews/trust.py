"""What a log can be trusted with: how long it flew, what was lost, and how fast it was logged."""

from __future__ import annotations

from collections.abc import Iterator

from flysid.facts.losses import lost_words
from flysid.reviews.fact import Fact, Finding, Grade, Section
from flysid.reviews.logged import LoggedFlight
from flysid.showing import significant


def review(flight: LoggedFlight) -> Section:
    """Section "What this log can show"."""
    facts = tuple(_facts(flight))
    return Section("trust", "What this log can show", facts, tuple(_findings(flight)))


def _facts(flight: LoggedFlight) -> Iterator[Fact]:
    yield Fact("trust.duration", "length of the log", flight.duration_s, "s")
    seconds = flight.flown.seconds
    if seconds is None:
        yield Fact(
            "trust.flown",
            "time in the air",
            missing="the log states neither arming nor landing",
            remedy=ARMING.get(flight.family, "log when the vehicle is armed"),
        )
    else:
        yield Fact("trust.flown", "time in the air", seconds, "s", note="; ".join(flight.flown.never))
    lost = lost_words(flight.damage)
    yield Fact("trust.lost", "lost", lost or "nothing", grade=Grade.WATCH if lost else Grade.GOOD)


ARMING = {
    "ardupilot": "LOG_BITMASK with EV and ARM messages: they are there by default",
    "px4": "log vehicle_status and vehicle_land_detected: they are there by default",
    "betaflight": "the slow frames of the blackbox, which hold flightModeFlags",
}
"""Firmware -> what states that a vehicle is armed."""


def _findings(flight: LoggedFlight) -> Iterator[Finding]:
    if not flight.was_flown:
        yield Finding(
            "The vehicle did not fly in this log",
            Grade.WATCH,
            1.0,
            "trust.flown",
            f"{significant(flight.duration_s)} s on the ground",
        )
