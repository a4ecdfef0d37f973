"""Findings about tracking, in one short sentence each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.reviews.fact import OSCILLATION, Finding, Grade
from flysid.reviews.figures import PHASE_MARGIN, limit, rate_lag_limit
from flysid.reviews.lines import capital
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.oscillation import Oscillation
from flysid.reviews.shaking import accelerometer_level
from flysid.reviews.tracked import MS, PERCENT, Followed, Tracked
from flysid.showing import list_words, significant

LEVEL = ("roll", "pitch")
ANGLE_GAINS = {
    "roll": ("MC_ROLL_P", "ATC_ANG_RLL_P", "STB_RLL_P"),
    "pitch": ("MC_PITCH_P", "ATC_ANG_PIT_P", "STB_PIT_P"),
    "yaw": ("MC_YAW_P", "ATC_ANG_YAW_P", "STB_YAW_P"),
}
"""The gain of an angle loop, rad/s per rad: the loop takes about its inverse."""


def findings(tracked: Tracked) -> Iterator[Finding]:
    """In no order."""
    shaken = list(_oscillating(tracked))
    late = list(_late(tracked))
    missed = list(_missing(tracked))
    yield from (*shaken, *late, *missed)
    yield from _thin_margins(tracked)
    if not shaken:
        yield from _at_limits(tracked)
        yield from _following(tracked, {axis for finding in (*late, *missed) for axis in _axes_in(finding)})


def _axes_in(finding: Finding) -> list[str]:
    return [axis for axis in ("roll", "pitch", "yaw") if axis in finding.text.lower()]


# ------------------------------------------------------------------------------------ what is wrong


def oscillating(tracked: Tracked, *, often: float = 0.1) -> dict[str, Oscillation]:
    """Axes that oscillate often enough to be worth a sentence. `often`: share of the flight."""
    return {axis: found for axis, found in tracked.oscillations.items() if found.share >= often}


def _oscillating(tracked: Tracked) -> Iterator[Finding]:
    shaken = oscillating(tracked)
    if not shaken:
        return
    worst_axis = max(shaken, key=lambda axis: shaken[axis].rms)
    worst = shaken[worst_axis]
    where = f"in {list_words(list(shaken))}"
    size = f"{significant(worst.rms, 2)} deg/s"
    gyro = f"{worst.rate_hz:.0f} Hz"
    words = f"Oscillates {where}, {size}"
    more = f"its frequency cannot be told from {gyro}: {worst.candidates}"
    if worst.is_unfolded:
        words = f"Oscillates {where} at {significant(worst.frequency_hz, 2)} Hz, {size}"
        more = f"in {PERCENT * worst.share:.0f} % of the flight, while the setpoint is quiet"
    resting = [share for share in tracked.resting if share >= limit("tracking.at_limit").watch]
    if resting:
        more += f"; motors at their minimum {_span(resting)} % of the time"
    most = 0.5
    grade, weight = Grade.BAD if worst.share >= most else Grade.WATCH, 1.0
    slow = worst.is_unfolded and worst.frequency_hz < LOOPS_HZ
    if not slow and _vibrates(tracked.flight):
        words = words.replace("Oscillates", "Shakes")
        more = f"vibration, or an oscillation: {more}"
        grade, weight = Grade.WATCH, 0.5
    yield Finding(words, grade, weight, f"tracking.oscillation_{worst_axis}", more, OSCILLATION)


LOOPS_HZ = 20.0
"""Loops that ring do so below it; vehicles' own motors and frames shake above."""


def _vibrates(flight: LoggedFlight) -> bool:
    """Whether the accelerometer shakes beyond its limit, which a loop that oscillates slowly does not do."""
    return any(fact.grade.rank >= Grade.WATCH.rank for fact in accelerometer_level(flight))


def _span(shares: Sequence[float]) -> str:
    low, high = (f"{PERCENT * share:.0f}" for share in (min(shares), max(shares)))
    return low if low == high else f"{low} to {high}"


def _late(tracked: Tracked) -> Iterator[Finding]:
    """Rates that come later than pilots accept, angles later than the angle loop's own gain makes them."""
    graded: dict[Grade, list[Followed]] = {}
    for followed in tracked.followed:
        if followed.pair.loop.key == "rate" and followed.lag.interval is not None:
            grade = rate_lag_limit(followed.pair.axis).grade(MS * followed.lag.interval[0])
            graded.setdefault(grade, []).append(followed)
    known = {followed.pair.axis for found in graded.values() for followed in found}
    for grade in (Grade.BAD, Grade.WATCH):
        if found := graded.get(grade):
            yield _late_finding(found, grade, "rate", rate_lag_limit(found[0].pair.axis).source)
    late: dict[Grade, list[Followed]] = {}
    for followed in tracked.followed:
        expected = expected_lag_s(tracked, followed)
        if followed.pair.axis in known or expected is None or followed.lag.interval is None:
            continue
        grade = limit("tracking.angle_lag").grade(followed.lag.interval[0] / expected)
        late.setdefault(grade, []).append(followed)
    for grade in (Grade.BAD, Grade.WATCH):
        if found := late.get(grade):
            own = expected_lag_s(tracked, found[0]) or np.nan
            yield _late_finding(found, grade, "", f"the angle loop's gain alone makes {MS * own:.0f} ms")


def expected_lag_s(tracked: Tracked, followed: Followed) -> float | None:
    """Of an angle: the inverse of its loop's gain; None of other loops, or where the log states no gain."""
    if followed.pair.loop.key != "attitude":
        return None
    stated = tracked.flight.parameters
    gains = (stated.get(name, 0.0) for name in ANGLE_GAINS[followed.pair.axis])
    return next((1.0 / gain for gain in gains if gain > 0.0), None)


def _late_finding(found: Sequence[Followed], grade: Grade, noun: str, why: str) -> Finding:
    worst = max(found, key=lambda followed: followed.lag.seconds)
    axes = list_words([followed.pair.axis for followed in found])
    verb = "follow" if len(found) > 1 else "follows"
    subject = f"{axes} {noun}{'s' if noun and len(found) > 1 else ''}".rstrip()
    words = f"{capital(subject)} {verb} {MS * worst.lag.seconds:.0f} ms late"
    return Finding(words, grade, 0.7, f"tracking.{worst.name}_lag", why)


def _missing(
    tracked: Tracked, *, least_deg: float = 5.0, share: float = 0.5, still: float = 0.01
) -> Iterator[Finding]:
    """Angles that miss their setpoint by much, and by much of what the setpoint moves.

    `still`: of the error. A setpoint that moves by less is in force in no loop, as a plane's is not that is
        steered by hand.
    """
    for followed in tracked.followed:
        if followed.pair.loop.key != "attitude" or followed.rms < least_deg:
            continue
        if still * followed.rms < followed.moved <= followed.rms / share:
            yield Finding(
                f"{capital(followed.pair.axis)} misses its setpoint by {significant(followed.rms, 2)} deg",
                Grade.WATCH,
                0.8,
                f"tracking.{followed.name}_rms",
                f"root mean square; the setpoint moves by {significant(followed.moved, 2)} deg",
            )


def _thin_margins(tracked: Tracked) -> Iterator[Finding]:
    """Only where the whole interval lies below the limit."""
    for judged in tracked.judged:
        phase = judged.margins.phase_deg if judged.margins is not None else None
        if phase is None or phase.value is None:
            continue
        grade = limit(PHASE_MARGIN).grade(phase.high)
        if grade is not Grade.GOOD:
            yield Finding(
                f"{capital(judged.axis)} has {phase.value:.0f} deg of phase margin",
                grade,
                0.2,
                f"tracking.{judged.axis}_phase_margin",
                f"between {phase.low:.0f} and {phase.high:.0f} deg; {limit(PHASE_MARGIN).source}",
            )


def _at_limits(tracked: Tracked) -> Iterator[Finding]:
    bounds = limit("tracking.at_limit")
    for held in tracked.controllers:
        if held.share >= bounds.watch:
            words = f"The {held.axis} controller is at its limit {PERCENT * held.share:.0f} % of the time"
            key = f"tracking.controller_{held.axis}_at_limit"
            yield Finding(words, bounds.grade(held.share), 0.5, key, bounds.source)


# ------------------------------------------------------------------------------------ what is right


def _following(tracked: Tracked, bad: set[str]) -> Iterator[Finding]:
    """Roll and pitch, where both are known and nothing speaks against them."""
    if bad & set(LEVEL):
        return
    rates = _known(tracked, "rate")
    angles = _known(tracked, "attitude")
    if rates:
        late = f"the rates {_range_ms(rates)} ms late"
        more = f"the angles {_range_ms(angles)} ms" if angles else ""
        yield Finding(
            f"Roll and pitch follow well, {late}", Grade.GOOD, 0.6, f"tracking.{rates[0].name}_lag", more
        )
    elif angles:
        error = significant(max(found.rms for found in angles), 2)
        slow = [f for f in (tracked.of("rate", axis) for axis in LEVEL) if f is not None and f.is_slow]
        more = f"the rate loop cannot be judged at {slow[0].pair.rate_hz:.0f} Hz" if slow else ""
        words = f"Roll and pitch follow within {error} deg, {_range_ms(angles)} ms late"
        yield Finding(words, Grade.GOOD, 0.5, f"tracking.{angles[0].name}_lag", more)


def _known(tracked: Tracked, loop: str) -> list[Followed]:
    found = [tracked.of(loop, axis) for axis in LEVEL]
    known = [followed for followed in found if followed is not None and followed.lag.is_known]
    return known if len(known) == len(LEVEL) else []


def _range_ms(found: Sequence[Followed]) -> str:
    low, high = (f"{MS * max(end(f.lag.seconds for f in found), 0.0):.0f}" for end in (min, max))
    return low if low == high else f"{low} to {high}"
