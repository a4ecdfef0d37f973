"""What to change of the gains, from what the log shows of them: at most by a factor of two.

A loop that oscillates gets half of its gains, as ArduPilot's and PX4's guides to a first flight say. A loop
whose margin is surely thin gets the largest gains that leave it one, predicted from the plant that this very
flight measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from flysid.errors import DataError
from flysid.loops.judged import Judged
from flysid.loops.margins import Margins, margins
from flysid.reviews.fact import Action, Grade
from flysid.reviews.figures import PHASE_MARGIN, limit
from flysid.reviews.rate_gains import scaled_gains
from flysid.reviews.tracked import Tracked
from flysid.reviews.tracking_findings import oscillating

FACTORS = (0.9, 0.8, 0.7, 0.6, 0.5)
HALF = 0.5


def actions(tracked: Tracked) -> Iterator[Action]:
    """None where the log cannot tell."""
    shaken = oscillating(tracked)
    if shaken:
        yield from _calm(tracked, list(shaken))
        return
    for judged in tracked.judged:
        yield from _widen(tracked, judged)


def _calm(tracked: Tracked, axes: Sequence[str]) -> Iterator[Action]:
    """Half the gains, where the frequency is known, or motors stand at their limits."""
    worst = max((tracked.oscillations[axis] for axis in axes), key=lambda found: found.rms)
    at_limit = max(tracked.resting, default=0.0)
    if not worst.is_unfolded and at_limit < limit("tracking.at_limit").watch:
        return
    changes = [change for axis in axes for change in scaled_gains(tracked.flight, axis, HALF)]
    if not changes:
        return
    seen = f"at {worst.frequency_hz:.0f} Hz" if worst.is_unfolded else f"at {worst.candidates}"
    names = " and ".join(axes)
    yield Action(
        f"Halve the rate gains of {names}",
        f"the rate swings by {worst.rms:.0f} deg/s {seen} while its setpoint is quiet",
        tuple(changes),
        "the gain margin grows by 6 dB",
        "it follows later and gives way more to gusts; raise them again in small steps",
        0.9,
        f"tracking.oscillation_{max(axes, key=lambda axis: tracked.oscillations[axis].rms)}",
    )


def _widen(tracked: Tracked, judged: Judged) -> Iterator[Action]:
    """Lower P and D, where the phase margin is surely bad."""
    now = judged.margins
    if now is None or now.phase_deg.value is None:
        return
    if limit(PHASE_MARGIN).grade(now.phase_deg.high) is not Grade.BAD:
        return
    found = _largest(judged)
    if found is None:
        return
    factor, then = found
    changes = scaled_gains(tracked.flight, judged.axis, factor, integral=False)
    if changes:
        yield Action(
            f"Lower P and D of the {judged.axis} rate",
            f"its phase margin is {now.phase_deg.said('.0f', ' deg')}",
            tuple(changes),
            _in_words(then),
            "it follows a little later",
            0.6,
            f"tracking.{judged.axis}_phase_margin",
        )


def _in_words(found: Margins) -> str:
    phase, crossover = found.phase_deg.said(".0f", " deg"), found.crossover_hz.said(".1f", " Hz")
    return f"phase margin {phase}, crossover {crossover}"


def _largest(judged: Judged) -> tuple[float, Margins] | None:
    """The largest factor on P and D after which the margin is no longer thin, and the margins then."""
    assert judged.loop is not None
    assert judged.controller is not None
    now = judged.controller
    for factor in FACTORS:
        try:
            then = margins(judged.loop, replace(now, p=factor * now.p, d=factor * now.d))
        except DataError:
            return None
        phase = then.phase_deg.value
        if phase is not None and np.isfinite(phase) and phase >= limit(PHASE_MARGIN).watch:
            return factor, then
    return None
