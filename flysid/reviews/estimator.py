"""Estimator and sensors: do the measurements agree with what the autopilot believes, and with each other?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.reviews import gps, sensors
from flysid.reviews.fact import Fact, Finding, Grade, Section
from flysid.reviews.limits import limit
from flysid.reviews.logged import Column, LoggedFlight

RATIOS = {
    "velocity": ("SV", "vel_test_ratio", "gps_hvel[0]", "velocity_variance"),
    "position": ("SP", "pos_test_ratio", "gps_hpos[0]", "pos_horiz_variance"),
    "height": ("SH", "hgt_test_ratio", "baro_vpos", "pos_vert_variance"),
    "compass": ("SM", "hdg_test_ratio", "heading", "compass_variance"),
}
"""What is measured -> its field in XKF4 and NKF4, and in each of the other messages."""
MESSAGES = ("XKF4", "NKF4", "estimator_status", "estimator_innovation_test_ratios", "EKF_STATUS_REPORT")
LEAST = 5
SETTLED_S = 2.0
"""From take-off and to landing: the estimate takes in what it could not see on the ground, and bumps."""


def review(flight: LoggedFlight) -> Section:
    """Section "Estimator and sensors"."""
    receiver = gps.read_receiver(flight)
    ratios = tuple(_ratio_facts(flight))
    of_gps = tuple(gps.facts(receiver))
    of_sensors = tuple(sensors.facts(flight))
    found: tuple[Finding, ...] = ()
    if flight.was_flown:
        found = (
            *_findings(ratios, of_gps),
            *gps.findings(of_gps, receiver),
            *sensors.findings(of_sensors, flight),
        )
    actions = tuple(sensors.actions(of_sensors)) if flight.was_flown else ()
    facts = (*ratios, *of_gps, *of_sensors)
    return Section("estimator", "Estimator and sensors", facts, found, actions)


def _ratio_facts(flight: LoggedFlight) -> Iterator[Fact]:
    logged = [name for name in MESSAGES if flight.has(name)]
    if not logged:
        remedy = {"ardupilot": "LOG_BITMASK with NTUN (EKF)", "px4": "SDLOG_PROFILE 1"}.get(flight.family, "")
        yield Fact(
            "estimator.test_ratio", "largest test ratio", missing="no estimator is logged", remedy=remedy
        )
        return
    known = limit("estimator.test_ratio")
    worst: Fact | None = None
    for kind in RATIOS:
        column = _ratio(flight, kind, logged)
        if column is None:
            continue
        value = float(np.percentile(column.values, 99.5))
        at_s = float(column.time_s[np.argmax(column.values)])
        label = f"{kind} test ratio"
        fields = (column.address,)
        fact = Fact(
            f"estimator.{kind}_ratio", label, value, "", None, known.grade(value), known.source, fields, at_s
        )
        yield fact
        if worst is None or value > float(worst.value or 0.0):
            worst = fact
    if worst is not None:
        yield Fact(
            "estimator.test_ratio",
            "largest test ratio",
            worst.value,
            "",
            grade=worst.grade,
            note=f"{worst.label.partition(' ')[0]}; {known.source}",
            fields=worst.fields,
            at_s=worst.at_s,
        )


def _ratio(flight: LoggedFlight, kind: str, logged: Sequence[str]) -> Column | None:
    """The ratio of one measurement in the air, of the first estimator; None where it is not used."""
    of_ardupilot, of_status, of_innovations, of_mavlink = RATIOS[kind]
    names = {
        "XKF4": of_ardupilot,
        "NKF4": of_ardupilot,
        "estimator_status": of_status,
        "estimator_innovation_test_ratios": of_innovations,
        "EKF_STATUS_REPORT": of_mavlink,
    }
    for message in logged:
        thing = flight.things(message)[0]
        column = flight.quantity(f"{thing}.{names[message]}", unit="1")
        if column is None:
            continue
        flown = column.where(
            flight.flying(column.time_s + SETTLED_S) & flight.flying(column.time_s - SETTLED_S)
        )
        if len(flown) >= LEAST and flown.values.max() > 0.0:
            return flown
    return None


def _findings(ratios: Sequence[Fact], of_gps: Sequence[Fact]) -> Iterator[Finding]:
    worst = next((fact for fact in ratios if fact.key == "estimator.test_ratio"), None)
    if worst is None or not isinstance(worst.value, float):
        return
    what = worst.note.partition(";")[0]
    if worst.grade is Grade.GOOD:
        text = f"The estimator agrees with its sensors: largest test ratio {worst.value:.2f}"
        yield Finding(text, Grade.GOOD, 0.2, worst.key, worst.note)
        return
    of_receiver = what in ("position", "velocity") and gps.is_disturbed(of_gps)
    verb = "rejects" if worst.grade is Grade.BAD else "doubts"
    whose = "its compass" if what == "compass" else f"the measured {what}"
    text = f"The estimator {verb} {whose}: test ratio {worst.value:.1f}"
    if worst.at_s is not None:
        text = f"{text} at {worst.at_s:.0f} s"
    yield Finding(
        text,
        worst.grade,
        0.3 if of_receiver else 0.8 if worst.grade is Grade.BAD else 0.45,
        worst.key,
        limit("estimator.test_ratio").source,
    )
