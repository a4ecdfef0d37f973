"""Section "Tracking": how each loop follows its setpoint, saturates or oscillates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from flysid.loops.judged import Judged
from flysid.reviews.fact import Fact, Grade, Section, Shown
from flysid.reviews.figures import Row, absent, fact_of, limit, rate_lag_limit
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.oscillation import FASTEST_HZ, Oscillation
from flysid.reviews.pairs import LOOPS
from flysid.reviews.remedies import remedy
from flysid.reviews.tracked import MS, PERCENT, Followed, Tracked, track
from flysid.reviews.tracking_actions import actions
from flysid.reviews.tracking_findings import findings
from flysid.reviews.tracking_pictures import chain, modes, motions


def review(flight: LoggedFlight) -> Section:
    """How the loops follow their setpoints.

    Raises
    ------
    RecipeError : a stream is in the log under a unit of another kind.
    """
    if not flight.was_flown:
        fact = absent("tracking.rate", "the vehicle did not fly in this log")
        return Section("tracking", "Tracking", (fact,))
    tracked = track(flight)
    shown: tuple[Shown, ...] = (*motions(tracked), *chain(tracked), *modes(tracked))
    found = tuple(findings(tracked)), tuple(actions(tracked))
    return Section("tracking", "Tracking", tuple(_facts(tracked)), *found, shown)


# ------------------------------------------------------------------------------------------- facts


def _facts(tracked: Tracked) -> Iterator[Fact]:
    for followed in tracked.followed:
        yield from _facts_of(followed, tracked.flight)
    yield from _absent(tracked)
    for axis, shaken in tracked.oscillations.items():
        yield from _oscillation_facts(axis, shaken)
    for held in tracked.controllers:
        grade, key = limit("tracking.at_limit").grade(held.share), "tracking.controller_{axis}_at_limit"
        yield fact_of(key, PERCENT * held.share, (held.address,), grade=grade, axis=held.axis)
    for judged in tracked.judged:
        yield from _margin_facts(judged)


def _facts_of(followed: Followed, flight: LoggedFlight) -> Iterator[Fact]:
    pair, lag, rows = followed.pair, followed.lag, followed.rows
    name, what = followed.name, f"{pair.loop.title} {pair.axis}"
    worst = int(np.argmax(np.abs(np.where(rows.counts, rows.measured - rows.setpoint, 0.0))))
    at_s = float(rows.time_s[worst])
    error = fact_of("tracking.{pair}_rms", followed.rms, pair.fields, at_s=at_s, pair=name, what=what)
    yield replace(error, unit=pair.loop.unit)
    if not lag.is_known or lag.interval is None:
        needed = (pair.remedy or remedy(flight, pair.loop.key)) if followed.is_slow else ""
        yield absent("tracking.{pair}_lag", lag.why, needed, pair.fields, pair=name, what=what)
    else:
        low, high = (MS * edge for edge in lag.interval)
        bound = rate_lag_limit(pair.axis) if pair.loop.key == "rate" else Row()
        share = f"it explains {PERCENT * lag.explained:.0f} % of the motion"
        yield fact_of(
            "tracking.{pair}_lag",
            MS * lag.seconds,
            pair.fields,
            interval=(low, high),
            note="; ".join(filter(None, (share, bound.source))),
            grade=bound.grade(low),
            pair=name,
            what=what,
        )
    beyond = followed.overshoot
    if beyond is not None:
        percent, interval = (None, None) if beyond.interval is None else (beyond.percent, beyond.interval)
        key, why = "tracking.{pair}_overshoot", beyond.why
        yield fact_of(key, percent, pair.fields, interval=interval, missing=why, pair=name, what=what)


def _absent(tracked: Tracked) -> Iterator[Fact]:
    """Loops that the firmware has and the log does not show."""
    held = {followed.pair.loop.key for followed in tracked.followed}
    for loop in LOOPS:
        needed = remedy(tracked.flight, loop.key)
        if loop.key not in held and needed:
            missing = "no setpoint of it is in the log while it flies"
            yield absent("tracking.{loop}", missing, needed, loop=loop.key, title=loop.title)


def _oscillation_facts(axis: str, shaken: Oscillation) -> Iterator[Fact]:
    fields, at_s, key = (shaken.address,), shaken.at_s, "tracking.oscillation_{axis}"
    share = f"in {PERCENT * shaken.share:.0f} % of the flight" if shaken.rms else ""
    grade = Grade.WATCH if shaken.rms else Grade.GOOD
    yield fact_of(key, shaken.rms, fields, at_s=at_s, note=share, grade=grade, axis=axis)
    if shaken.rms and shaken.is_unfolded:
        yield fact_of(f"{key}_frequency", shaken.frequency_hz, fields, at_s=at_s, axis=axis)
    elif shaken.rms:
        missing = f"it cannot be told from {shaken.rate_hz:.0f} Hz: {shaken.candidates}"
        faster = f"a gyro logged at {2.0 * FASTEST_HZ:.0f} Hz or more"
        yield absent(f"{key}_frequency", missing, faster, fields, axis=axis)


def _margin_facts(judged: Judged) -> Iterator[Fact]:
    m = judged.margins
    if m is None:
        yield absent("tracking.{axis}_margins", judged.refused, judged.hint, axis=judged.axis)
        return
    figures = {
        "crossover": m.crossover_hz,
        "phase_margin": m.phase_deg,
        "gain_margin": m.gain_db,
        "delay_margin": m.delay_ms,
        "sensitivity": m.ms,
        "bandwidth": m.bandwidth_hz,
    }
    for name, figure in figures.items():
        key = f"tracking.{{axis}}_{name}"
        if figure.value is not None:
            interval, grade = (figure.low, figure.high), limit(key).grade(figure.high)
            yield fact_of(key, figure.value, interval=interval, grade=grade, axis=judged.axis)
        else:
            unit = limit(key).unit
            least = f"at least {figure.low:.1f} {unit}" if np.isfinite(figure.low) else figure.why
            yield replace(absent(key, least, axis=judged.axis), unit=unit)
