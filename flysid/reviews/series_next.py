"""What to try next: other P and D for the vehicle that the flights of a series measured, and what they bring.

The margins are those of the plant of all flights together. The lag is predicted with the differences between
the flights (`flysid.loops.prediction`). The proposal is the quickest that keeps the margin and does not make
the motors noisier by much.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.errors import DataError
from flysid.loops.controller import Controller
from flysid.loops.margins import Margins, flight_curves, margins, margins_across
from flysid.loops.prediction import Prediction, predict
from flysid.loops.stick_response import Loop
from flysid.reviews.fact import Action, Change
from flysid.reviews.figures import PHASE_MARGIN, limit
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.rate_gains import scaled_gains

STEPS = (0.8, 0.9, 1.0, 1.1, 1.25)
"""Factors on P and on D that are looked at: a tuner's next step, not a leap."""
LEAST_FLIGHTS = 3
LAG_AT_HZ = 3.0


@dataclass(frozen=True, eq=False)
class _Tried:
    p: float
    d: float
    controller: Controller
    margins: Margins

    @property
    def phase_deg(self) -> float:
        return self.margins.phase_deg.value or 0.0

    @property
    def crossover_hz(self) -> float:
        return self.margins.crossover_hz.value or 0.0


def try_next(axis: str, loops: Sequence[Loop], latest: LoggedFlight, controller: Controller) -> Action | None:
    """The next gains of an axis; None where the flights do not tell, or the present ones serve best.

    `loops`: of flights under any gains, three or more.
    `latest`, `controller`: the flight whose gains are changed, and what it flew.
    """
    if len(loops) < LEAST_FLIGHTS:
        return None
    together = Loop(loops[0].f, tuple(blocks for loop in loops for blocks in loop.blocks))
    tried = list(_tries(loops, together, controller))
    now = next((one for one in tried if one.p == one.d == 1.0), None)
    if now is None:
        return None
    best = _choose(tried, now)
    if best is None or best is now:
        return None
    changes = _changes(latest, axis, best)
    if not changes:
        return None
    return Action(
        f"Try other gains in {axis}",
        _reason(now, best),
        tuple(changes),
        _predicted(loops, now, best),
        _risk(now, best),
        0.5,
        f"tracking.{axis}_phase_margin",
    )


def _tries(loops: Sequence[Loop], together: Loop, controller: Controller) -> Iterator[_Tried]:
    """Nothing where the present gains have no margins; intervals hold the scatter between flights."""
    try:
        present = margins(together, controller)
    except DataError:
        return
    curves = flight_curves(loops)
    for p in STEPS:
        for d in STEPS:
            changed = replace(controller, p=p * controller.p, d=d * controller.d)
            try:
                found = margins_across(together, changed, curves, present) or margins(together, changed)
            except DataError:
                continue
            if found.phase_deg.value is not None and found.crossover_hz.value is not None:
                yield _Tried(p, d, changed, found)


def _choose(
    tried: Sequence[_Tried], now: _Tried, *, noisier: float = 1.2, gain: float = 0.05
) -> _Tried | None:
    """The quickest with enough margin; of a thin one that cannot be had, the largest margin.

    `noisier`: the noise on the motors may grow by this factor.
    `gain`: share of the crossover, or of the margin, below which a change is not worth a flight.
    """
    wanted = limit(PHASE_MARGIN).watch
    noise = now.margins.noise.value or np.inf
    quiet = [one for one in tried if (one.margins.noise.value or 0.0) <= noisier * noise]
    enough = [one for one in quiet if one.phase_deg >= wanted]
    if now.phase_deg >= wanted:
        best = max(enough, key=lambda one: one.crossover_hz)
        return best if best.crossover_hz >= (1.0 + gain) * now.crossover_hz else now
    if enough:
        return max(enough, key=lambda one: one.crossover_hz)
    best = max(quiet, key=lambda one: one.phase_deg, default=now)
    return best if best.phase_deg >= (1.0 + gain) * now.phase_deg else now


def _changes(latest: LoggedFlight, axis: str, best: _Tried) -> list[Change]:
    found = scaled_gains(latest, axis, best.p, integral=False, slope=False) if best.p != 1.0 else []
    if best.d != 1.0:
        found += scaled_gains(latest, axis, best.d, integral=False, proportional=False)
    return found


def _reason(now: _Tried, best: _Tried) -> str:
    phase = f"{now.phase_deg:.0f} deg of phase margin"
    wanted = limit(PHASE_MARGIN)
    if now.phase_deg < wanted.watch:
        return f"over all flights the latest gains leave {phase}, less than {wanted.watch:.0f}"
    kept = f"{best.phase_deg:.0f}"
    return f"over all flights the latest gains leave {phase}; a quicker loop still has {kept}"


def _risk(now: _Tried, best: _Tried) -> str:
    before, after = now.margins.noise.value, best.margins.noise.value
    noise = (
        f"{100.0 * (after / before - 1.0):+.0f} % noise on the motors" if before and after else "warm motors"
    )
    return f"{noise}: land after a minute and feel them"


def _predicted(loops: Sequence[Loop], now: _Tried, best: _Tried) -> str:
    phase = f"phase margin {now.phase_deg:.0f} -> {best.margins.phase_deg.said('.0f', ' deg')}"
    crossover = f"crossover {now.crossover_hz:.1f} -> {best.margins.crossover_hz.said('.1f', ' Hz')}"
    before, after = (predict(loops, one.controller) for one in (now, best))
    lag, interval = _lag_change(before, after)
    low, high = interval
    return f"{phase}, {crossover}, lag at {LAG_AT_HZ:g} Hz {lag:+.1f} ms [{low:+.1f}, {high:+.1f}]"


def _lag_change(before: Prediction, after: Prediction) -> tuple[float, tuple[float, float]]:
    """How much later a motion of `LAG_AT_HZ` comes, ms: of the same plants, whose own error cancels."""
    k = int(np.argmin(np.abs(before.f - LAG_AT_HZ)))
    late = -1e3 / (2.0 * np.pi * before.f[k])
    change = late * float(np.angle(after.response[k] / before.response[k]))
    drawn = late * np.angle(after.draws[:, k] / before.draws[:, k])
    low, high = np.quantile(drawn, (0.025, 0.975))
    return change, (float(low), float(high))
