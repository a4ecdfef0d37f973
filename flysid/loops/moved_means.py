"""What moves in a Betaflight law, as it would have moved in a flight under other settings.

D grows with quick motions, the integral relaxes while the setpoint moves, and what each comes to on average
depends on the error. Another controller leaves another error, so that the averages of the flight do not hold
under it: with P doubled the integral of a simulated flight came to 0.30 of its gain, and not to 0.47.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.loops.axis_flight import AxisFlight, axis_flight
from flysid.loops.betaflight import AXES, BetaflightLaw, Conditions
from flysid.loops.controller import Controller
from flysid.loops.flown_axis import Turning
from flysid.loops.law_parts import Means
from flysid.loops.rebuilt import rebuild

ROUNDS = 2
"""Of averages and controller, each from the other; a third one changes no digit that is printed."""
GRID_HZ = 500.0
LOWEST_HZ = 1e-3


def conditions_under(
    log: Any, axis: str, flown: Mapping[str, str], new: Mapping[str, str], seen: Conditions, turning: Turning
) -> Conditions:
    """What the gains of a flight would have depended on under other settings.

    `flown`, `new`: settings of the header, and the other ones.
    `seen`: what they did depend on.
    `turning`: the plant that fits.
    """
    old_law, law = (BetaflightLaw.of(settings, axis) for settings in (flown, new))
    forward = seen.forward
    if forward is not None and seen.forward_gain:
        forward = (forward[0], forward[1] * (law.f / seen.forward_gain))
    limit = law.limits[list(AXES).index(axis)]
    other = replace(seen, forward=forward, forward_gain=law.f, output_limit=limit, means=None)
    if not law.changes_in_flight or not law.step_s:
        return other
    flight = axis_flight(log, axis, flown, old_law)
    old = old_law.controller(seen)
    other = replace(other, means=_means(law, flight, flight.rows.rate))
    for _ in range(ROUNDS):
        rate = _rate_under(flight, turning, old, law.controller(other))
        other = replace(other, means=_means(law, flight, rate))
    return other


def _means(law: BetaflightLaw, flight: AxisFlight, rate: FloatArray) -> Means:
    return rebuild(law, replace(flight.rows, rate=rate), law.step_s * flight.slower).means


def _rate_under(flight: AxisFlight, turning: Turning, old: Controller, new: Controller) -> FloatArray:
    """(N,) deg/s at the rows of a flight: its sticks' part by the other loop, the rest by its sensitivity."""
    time, rows = flight.time, flight.rows
    grid = np.arange(time[0], time[-1], 1.0 / GRID_HZ)
    asked, turned = (np.fft.rfft(np.interp(grid, time, own)) for own in (rows.setpoint, rows.rate))
    f = np.maximum(np.asarray(np.fft.rfftfreq(len(grid), 1.0 / GRID_HZ), dtype=np.float64), LOWEST_HZ)
    g = turning.response(f, 1.0 / GRID_HZ)
    before, after = (1.0 + g * own.feedback(f) for own in (old, new))
    rest = turned - g * old.reference(f) / before * asked
    under = g * new.reference(f) / after * asked + before / after * rest
    return np.asarray(rows.rate + np.interp(time, grid, np.fft.irfft(under - turned, len(grid))))
