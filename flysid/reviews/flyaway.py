"""A flyaway: a vehicle that holds a position moves away from it, further and further."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.lake.attitude import is_fresh
from flysid.ingest.lake.motors import is_multicopter
from flysid.reviews.fact import Fact, Finding
from flysid.reviews.figures import fact_of, limit
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.motor_loss import first_lasting
from flysid.reviews.pairs import Pair, pairs

KEY = "happened.flyaway"
HOLDS_POSITION = (*range(6, 22), 35, 36)
"""Of INAV's navState (navigationPersistentId_e): position hold, way home and waypoints, with their pauses.

In others, such as an emergency landing (22 to 24), a launch or a cruise, its target is that of another time.
"""


@dataclass(frozen=True)
class Flyaway:
    """When it began, how far it went, and the field of the position."""

    at_s: float
    away_m: float
    field: str

    @property
    def fact(self) -> Fact:
        """For the page."""
        return fact_of(KEY, self.away_m, (self.field,), at_s=self.at_s)

    @property
    def finding(self) -> Finding:
        """The sentence of it."""
        text = f"Flew away from its target from {self.at_s:.0f} s on: {self.away_m:.0f} m"
        more = "a wrong heading or position turns the controller against itself: compass, then GPS"
        return Finding(text, limit(KEY).grade(self.away_m), 0.95, KEY, more)


def find_flyaway(flight: LoggedFlight, *, lasts_s: float = 3.0, away: float = 0.5) -> Flyaway | None:
    """The first time it flew away from the position that it was to hold; None where it never did.

    `lasts_s`: it moves away for so long: a turn at a waypoint takes less.
    `away`: share of the figure's limit that it moves in that time: a vehicle that is late for its target
        gains on it.
    """
    if not is_multicopter(flight):
        return None
    held = {pair.axis: pair for pair in pairs(flight) if pair.loop.key == "position"}
    if not {"north", "east"} <= held.keys():
        return None
    north, east = held["north"], held["east"]
    time_s = north.measured.time_s
    now, before = (_distance(north, east, time_s, late_s) for late_s in (0.0, lasts_s))
    bound = limit(KEY).watch
    navigates = flight.quantity("main.navState")
    holds = flight.flying(time_s)
    if navigates is not None:
        holds &= np.isin(navigates.held(time_s), HOLDS_POSITION)
    going = holds & (now >= bound) & (now - before >= away * bound)
    at = first_lasting(going, max(2, round(lasts_s * north.measured.rate_hz)))
    if at is None:
        return None
    later = holds & (time_s >= time_s[at]) & np.isfinite(now)
    return Flyaway(float(time_s[at]) - lasts_s, float(now[later].max()), north.measured.address)


def _distance(north: Pair, east: Pair, time_s: FloatArray, late_s: float) -> FloatArray:
    """(n,) m from the target of each time to where the vehicle was so long before; NaN for unknown."""
    apart = [pair.measured.at(time_s - late_s) - pair.setpoint.held(time_s) for pair in (north, east)]
    fresh = is_fresh(north.setpoint.time_s, time_s) & is_fresh(east.setpoint.time_s, time_s)
    return np.where(fresh, np.hypot(*apart), np.nan)
