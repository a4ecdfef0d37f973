"""Hard landings: the acceleration at touch-down and the sink rate before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.ingest.lake.attitude import sink_speed
from flysid.ingest.lake.crash import acceleration
from flysid.reviews.fact import Grade
from flysid.reviews.figures import limit
from flysid.reviews.logged import Column, LoggedFlight

FAMILIES = ("ardupilot", "px4", "inav")
"""Racers are dropped on the ground on purpose."""
BEFORE_S, AFTER_S = 3.0, 1.5
"""Around the moment from which on the log states that it is on the ground: it takes so long to notice."""
DISARMED_S = 10.0
"""INAV's logs state no landing, only that the vehicle was disarmed: so long after it, at most."""
OUTSTANDING = 2.0
"""The blow over what 99.9 % of the flight feel less than."""
STOPS_S = 0.35
"""The ground takes the sinking away in so short a time; no controller does."""
STANDING = 0.2
"""Of the speed of sinking is left then."""


@dataclass(frozen=True)
class HardLanding:
    """A landing that was a blow.

    `at_s`: on the log's clock.
    `impact_m_s2`: what the accelerometer felt at most.
    `sink_m_s`: how fast it sank just before; NaN where the log does not show it.
    `field`: of the accelerometer.
    """

    at_s: float
    impact_m_s2: float
    sink_m_s: float
    field: str

    @property
    def grade(self) -> Grade:
        """By its blow or its speed, the worse: an accelerometer that is logged slowly misses the blow."""
        known = {"happened.landing": self.impact_m_s2, "happened.sink": self.sink_m_s}
        grades = [limit(name).grade(value) for name, value in known.items()]
        return max(grades, key=lambda grade: grade.rank)


def find_hard_landing(flight: LoggedFlight) -> HardLanding | None:
    """The hardest landing of a log that passes a limit; None where all were soft, or none is seen."""
    if flight.family not in FAMILIES or not flight.flown.seconds or np.isfinite(flight.ends_s):
        return None
    felt = acceleration(flight)
    if felt is None:
        return None
    sinking = sink_speed(flight)
    before_s = DISARMED_S if flight.family == "inav" else BEFORE_S
    usual = _usual(flight, felt, before_s)
    lands_s = [last for _, last in flight.air_s if _is_down(flight, last)]
    found = [_touch_down(felt, sinking, (last_s - before_s, last_s + AFTER_S), usual) for last_s in lands_s]
    hard = [landing for landing in found if landing is not None and landing.grade is not Grade.GOOD]
    return max(hard, key=lambda landing: landing.impact_m_s2, default=None)


def _is_down(flight: LoggedFlight, last_s: float) -> bool:
    """Whether the vehicle landed, rather than that its log stopped."""
    return last_s < flight.duration_s - 0.5 or flight.is_closed


def _usual(flight: LoggedFlight, felt: Column, before_s: float) -> float:
    """What 99.9 % of the flight stay below: a vehicle that shakes feels blows all the time."""
    flown = felt.where(flight.flying(felt.time_s + before_s))
    return float(np.percentile(flown.values, 99.9)) if len(flown) else 0.0


def _touch_down(
    felt: Column, sinking: Column | None, span_s: tuple[float, float], usual: float
) -> HardLanding | None:
    """What a landing felt like; a blow that does not stand out in its flight only counts by the sinking."""
    inside = felt.where((felt.time_s >= span_s[0]) & (felt.time_s <= span_s[1]))
    if not len(inside):
        return None
    at = int(np.argmax(inside.values))
    stop = _abrupt_stop(sinking, span_s) if sinking is not None else None
    if stop is None and inside.values[at] < OUTSTANDING * usual:
        return None
    at_s, sink = stop or (float(inside.time_s[at]), float("nan"))
    return HardLanding(at_s, float(inside.values[at]), sink, felt.address)


def _abrupt_stop(sinking: Column, span_s: tuple[float, float]) -> tuple[float, float] | None:
    """When the sinking ended at once, and how fast it was; None where it faded."""
    near = sinking.where((sinking.time_s >= span_s[0]) & (sinking.time_s <= span_s[1]))
    if len(near) < 3 or near.period_s > STOPS_S:
        return None
    later = near.at(near.time_s + STOPS_S)
    stops = np.flatnonzero((near.values > 0.5) & (later < STANDING * near.values))
    if not len(stops):
        return None
    fastest = int(stops[np.argmax(near.values[stops])])
    return float(near.time_s[fastest]), float(near.values[fastest])
