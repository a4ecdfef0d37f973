"""Section "Tracking": how every loop follows its setpoint, what stands at its limit, and what oscillates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flysid.loops.judged import Judged
from flysid.reviews.fact import Fact, Grade, Section, Shown
from flysid.reviews.limits import limit, rate_lag_limit
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
        fact = Fact("tracking.rate", "how it follows", missing="the vehicle did not fly in this log")
        return Section("tracking", "Tracking", (fact,))
    tracked = track(flight)
    shown: tuple[Shown, ...] = (*motions(tracked), *chain(tracked), *modes(tracked))
    return Section(
        "tracking",
        "Tracking",
        tuple(_facts(tracked)),
        tuple(findings(tracked)),
        tuple(actions(tracked)),
        shown,
    )


# ------------------------------------------------------------------------------------------- facts


def _facts(tracked: Tracked) -> Iterator[Fact]:
    for followed in tracked.followed:
        yield from _facts_of(followed, tracked.flight)
    yield from _absent(tracked)
    for axis, shaken in tracked.oscillations.items():
        yield from _oscillation_facts(axis, shaken)
    yield from _limit_facts(tracked)
    for judged in tracked.judged:
        yield from _margin_facts(judged)


def _facts_of(followed: Followed, flight: LoggedFlight) -> Iterator[Fact]:
    pair, lag = followed.pair, followed.lag
    loop = pair.loop
    what = f"{loop.title} {pair.axis}"
    worst = int(
        np.argmax(
            np.abs(np.where(followed.rows.counts, followed.rows.measured - followed.rows.setpoint, 0.0))
        )
    )
    yield Fact(
        f"tracking.{followed.name}_rms",
        f"{what}: error, root mean square",
        followed.rms,
        loop.unit,
        fields=pair.fields,
        at_s=float(followed.rows.time_s[worst]),
    )
    help_words = pair.remedy or remedy(flight, loop.key)
    label = f"{what}: lag"
    key = f"tracking.{followed.name}_lag"
    if not lag.is_known or lag.interval is None:
        needed = help_words if followed.is_slow else ""
        yield Fact(key, label, missing=lag.why, remedy=needed, fields=pair.fields)
    else:
        low, high = (MS * edge for edge in lag.interval)
        grade, note = Grade.PLAIN, f"it explains {PERCENT * lag.explained:.0f} % of the motion"
        if loop.key == "rate":
            bounds = rate_lag_limit(pair.axis)
            grade = bounds.grade(low)
            note += f"; {bounds.source}"
        yield Fact(key, label, MS * lag.seconds, "ms", (low, high), grade, note, pair.fields)
    if followed.overshoot is not None:
        beyond = followed.overshoot
        known = beyond.interval is not None
        yield Fact(
            f"tracking.{followed.name}_overshoot",
            f"{what}: overshoot of a step",
            beyond.percent if known else None,
            "%",
            beyond.interval,
            missing=beyond.why,
            fields=pair.fields,
        )


def _absent(tracked: Tracked) -> Iterator[Fact]:
    """Loops that the firmware has and the log does not show."""
    held = {followed.pair.loop.key for followed in tracked.followed}
    for loop in LOOPS:
        needed = remedy(tracked.flight, loop.key)
        if loop.key not in held and needed:
            yield Fact(
                f"tracking.{loop.key}",
                f"{loop.title}: how it follows",
                missing="no setpoint of it is in the log while it flies",
                remedy=needed,
            )


def _oscillation_facts(axis: str, shaken: Oscillation) -> Iterator[Fact]:
    fields = (shaken.address,)
    share = f"in {PERCENT * shaken.share:.0f} % of the flight" if shaken.rms else ""
    grade = Grade.WATCH if shaken.rms else Grade.GOOD
    key = f"tracking.oscillation_{axis}"
    label = f"{axis}: oscillation by itself, root mean square"
    yield Fact(key, label, shaken.rms, "deg/s", None, grade, share, fields, shaken.at_s)
    if not shaken.rms:
        return
    label = f"{axis}: its frequency"
    if shaken.is_unfolded:
        yield Fact(f"{key}_frequency", label, shaken.frequency_hz, "Hz", fields=fields, at_s=shaken.at_s)
    else:
        missing = f"it cannot be told from {shaken.rate_hz:.0f} Hz: {shaken.candidates}"
        faster = f"a gyro logged at {2.0 * FASTEST_HZ:.0f} Hz or more"
        yield Fact(f"{key}_frequency", label, missing=missing, remedy=faster, fields=fields)


def _limit_facts(tracked: Tracked) -> Iterator[Fact]:
    for held in tracked.controllers:
        yield Fact(
            f"tracking.controller_{held.axis}_at_limit",
            f"{held.axis}: rate controller at its limit",
            PERCENT * held.share,
            "%",
            grade=limit("tracking.at_limit").grade(held.share),
            fields=(held.address,),
        )


def _margin_facts(judged: Judged) -> Iterator[Fact]:
    stem = f"tracking.{judged.axis}"
    m = judged.margins
    if m is None:
        yield Fact(f"{stem}_margins", f"{judged.axis}: margins", missing=judged.refused, remedy=judged.hint)
        return
    figures = (
        ("crossover", "crossover", m.crossover_hz, "Hz"),
        ("phase_margin", "phase margin", m.phase_deg, "deg"),
        ("gain_margin", "gain margin", m.gain_db, "dB"),
        ("delay_margin", "delay margin", m.delay_ms, "ms"),
        ("sensitivity", "peak sensitivity Ms", m.ms, ""),
        ("bandwidth", "bandwidth", m.bandwidth_hz, "Hz"),
    )
    for key, label, figure, unit in figures:
        grade, note = Grade.PLAIN, ""
        if key == "phase_margin" and figure.value is not None:
            grade = limit("tracking.phase_margin").grade(figure.high)
            note = limit("tracking.phase_margin").source
        missing = ""
        if figure.value is None:
            missing = f"at least {figure.low:.1f} {unit}" if np.isfinite(figure.low) else figure.why
        yield Fact(
            f"{stem}_{key}",
            f"{judged.axis}: {label}",
            figure.value,
            unit,
            (figure.low, figure.high) if figure.value is not None else None,
            grade,
            note,
            missing=missing,
        )
