"""Estimator and sensors: do the measurements agree with what the autopilot believes, and with each other?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.reviews import gps, sensors
from flysid.reviews.fact import Fact, Finding, Grade, Section
from flysid.reviews.figures import absent, actions_of, exceeded, fact_of, findings_of, limit
from flysid.reviews.logged import Column, LoggedFlight
from flysid.reviews.remedies import remedy

RATIOS = {
    "XKF4": ("SV", "SP", "SH", "SM"),
    "NKF4": ("SV", "SP", "SH", "SM"),
    "estimator_status": ("vel_test_ratio", "pos_test_ratio", "hgt_test_ratio", "hdg_test_ratio"),
    "estimator_innovation_test_ratios": ("gps_hvel[0]", "gps_hpos[0]", "baro_vpos", "heading"),
    "EKF_STATUS_REPORT": (
        "velocity_variance",
        "pos_horiz_variance",
        "pos_vert_variance",
        "compass_variance",
    ),
}
"""Message -> its fields of `KINDS`; the first message that the log holds counts."""
KINDS = ("velocity", "position", "height", "compass")
LEAST = 5
SETTLED_S = 2.0
"""From take-off and to landing: the estimate takes in what it could not see on the ground, and bumps."""


def review(flight: LoggedFlight) -> Section:
    """Section "Estimator and sensors"."""
    receiver = gps.read_receiver(flight)
    ratios = tuple(_ratio_facts(flight))
    of_gps = tuple(gps.facts(receiver))
    facts = (*ratios, *of_gps, *sensors.facts(flight))
    if not flight.was_flown:
        return Section("estimator", "Estimator and sensors", facts)
    of_compass = exceeded(facts).keys() & {"estimator.compass_change"}
    plain = [fact for fact in facts if not (of_compass and fact.key == "estimator.field_change")]
    findings = (
        *_findings(ratios, of_gps),
        *gps.findings(of_gps, receiver),
        *sensors.findings(facts, flight),
        *findings_of(plain),
    )
    return Section("estimator", "Estimator and sensors", facts, findings, tuple(actions_of(facts)))


def _ratio_facts(flight: LoggedFlight) -> Iterator[Fact]:
    logged = [name for name in RATIOS if flight.has(name)]
    if not logged:
        yield absent("estimator.test_ratio", "no estimator is logged", remedy(flight, "estimator"))
        return
    worst: tuple[float, str, Column] | None = None
    for k, kind in enumerate(KINDS):
        column = _ratio(flight, k, logged)
        if column is None:
            continue
        value = float(np.percentile(column.values, 99.5))
        at_s = float(column.time_s[np.argmax(column.values)])
        yield fact_of("estimator.{kind}_ratio", value, (column.address,), at_s=at_s, kind=kind)
        if worst is None or value > worst[0]:
            worst = value, kind, column
    if worst is not None:
        value, kind, column = worst
        at_s = float(column.time_s[np.argmax(column.values)])
        yield fact_of("estimator.test_ratio", value, (column.address,), at_s=at_s, note=kind)


def _ratio(flight: LoggedFlight, k: int, logged: Sequence[str]) -> Column | None:
    """The ratio of one measurement in the air, of the first estimator; None where it is not used."""
    for message in logged:
        thing = flight.things(message)[0]
        column = flight.quantity(f"{thing}.{RATIOS[message][k]}", unit="1")
        if column is None:
            continue
        settled = flight.flying(column.time_s + SETTLED_S) & flight.flying(column.time_s - SETTLED_S)
        flown = column.where(settled)
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
