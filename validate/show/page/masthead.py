"""What stands above the verdict: whose flights these are, when they were flown, how long, how fast."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from flysid.catalogue import FlightFacts
from flysid.escaping import one_line
from flysid.facts.losses import lines_of_flights
from flysid.showing import first_of, rough_duration, significant

NAMES_SHOWN = 3
FIRMWARE = ("firmware", "software", "ver_sw")


def masthead(flights: Sequence[FlightFacts], rates_hz: Sequence[float]) -> list[str]:
    """Logs, vehicle, firmware, dates, duration, losses and rate; what the logs do not say is left out."""
    if not flights:
        return []
    names = [one_line(f.log) for f in flights]
    count = f"{len(names)} log{'s' if len(names) > 1 else ''}"
    vehicle = _all(flights, ("vehicle", "autopilot"))
    facts = [
        f"{count}: {first_of(names, NAMES_SHOWN)}",
        vehicle,
        _all(flights, FIRMWARE),
        dates([f.start_utc_ns for f in flights if f.start_utc_ns is not None]),
        f"{rough_duration(sum(f.duration_s for f in flights))} in total",
        _lost(flights),
        " and ".join(significant(r) for r in rates_hz) + " Hz",
    ]
    return [fact for fact in facts if fact]


def _lost(flights: Sequence[FlightFacts]) -> str:
    """What the logs lack: "lost: 2 bad checksums"; flight by flight where there are several; or ""."""
    lines = lines_of_flights({f.id: f.lacks for f in flights}, NAMES_SHOWN)
    if len(flights) == 1:
        lines = [f.lacks for f in flights if f.lacks]
    return f"lost: {one_line('; '.join(lines))}" if lines else ""


def dates(starts_ns: Sequence[int]) -> str:
    """ "22 Nov 2026", or the first and the last day; "" where no log knows."""
    days = sorted({datetime.fromtimestamp(ns * 1e-9, UTC).date() for ns in starts_ns})
    said = [f"{day.day} {day:%b %Y}" for day in days]
    return "" if not said else said[0] if len(said) == 1 else f"{said[0]} to {said[-1]}"


def _all(flights: Sequence[FlightFacts], keys: Sequence[str]) -> str:
    """What the logs say under the first of the keys that they have."""
    said = [next((f.info[k] for k in keys if f.info.get(k)), "") for f in flights]
    return ", ".join(one_line(text) for text in list(dict.fromkeys(filter(None, said)))[:NAMES_SHOWN])
