"""Settings that differ between one flight and the next, without what firmwares write themselves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from flysid.ingest.lake.events import written
from flysid.reviews.logged import LoggedFlight
from flysid.showing import first_of, significant

WRITTEN = (
    "Field *",
    "Log start datetime",
    "vbatref",
    "rc_smoothing_active_cutoffs",
    "STAT_*",
    "SYS_NUM_RESETS",
    "*_GND_*",
    "BARO*_ALT_*",
    "COMPASS_DEC*",
    "COM_FLIGHT_UUID",
    "LND_FLIGHT_T_*",
    "CAL_*",
    "SENS_DPRES_OFF",
    "INS_*OFFS_*",
    "INS_GYR*_CALTEMP",
    "MIS_TOTAL",
    "FENCE_TOTAL",
    "RALLY_TOTAL",
)
"""Patterns of names whose values a firmware changes by itself, from flight to flight."""
SHOWN = 6
DIGITS = 6


@dataclass(frozen=True)
class Difference:
    """What a flight flew otherwise than the one before it: name -> old and new."""

    flight: str
    settings: Mapping[str, tuple[str, str]]

    @property
    def words(self) -> str:
        """For people."""
        every = [f"{name} {_short(old)} -> {_short(new)}" for name, (old, new) in self.settings.items()]
        return first_of(every, SHOWN)

    def to_dict(self) -> dict[str, object]:
        """For JSON."""
        changed = {name: {"from": old, "to": new} for name, (old, new) in self.settings.items()}
        return {"flight": self.flight, "settings": changed}


def differences(flights: Sequence[tuple[str, LoggedFlight]]) -> Iterator[Difference]:
    """Of every flight from the one before it, in their order; flights that state nothing are passed over."""
    before: Mapping[str, str] = {}
    for name, flight in flights:
        stated = _settings(flight)
        if before and stated:
            changed = {
                key: (before.get(key, "-"), stated.get(key, "-"))
                for key in sorted(before.keys() | stated.keys())
                if before.get(key) != stated.get(key)
            }
            if changed:
                yield Difference(name, changed)
        before = stated or before


def _short(text: str) -> str:
    """A number in few digits; other texts as they are."""
    try:
        return significant(float(text), DIGITS)
    except ValueError:
        return text


def _settings(flight: LoggedFlight) -> dict[str, str]:
    stated: Mapping[str, str] = flight.headers or {
        name: written(value) for name, value in flight.parameters.items()
    }
    return {
        name: value
        for name, value in stated.items()
        if not any(fnmatchcase(name, pattern) for pattern in WRITTEN)
    }
