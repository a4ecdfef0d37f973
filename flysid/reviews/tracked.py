"""What is measured of a flight's loops: errors, lags, overshoot, oscillation, limits and margins."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.loops.betaflight import AXES
from flysid.loops.judged import Judged
from flysid.model.threads import on_one_thread
from flysid.reviews.follow import TURN_DEG, Counting, Lag, Together, at_rows, lag_of, on_grid
from flysid.reviews.logged import Column, LoggedFlight
from flysid.reviews.oscillation import Oscillation, fastest_gyro, oscillation
from flysid.reviews.overshoot import Overshoot, overshoot
from flysid.reviews.pairs import Pair, in_control, pairs
from flysid.reviews.saturation import AtLimit, controller_limits, resting_motors

MS = 1000.0
PERCENT = 100.0
LEAST_ROWS = 3


@dataclass(frozen=True, eq=False)
class Followed:
    """A pair and what came of it: at the measurement's rows, on a grid, and in figures."""

    pair: Pair
    rows: Together
    grid: Together
    rms: float
    lag: Lag
    overshoot: Overshoot | None = None

    @property
    def name(self) -> str:
        """Of its facts: "rate_roll"."""
        return f"{self.pair.loop.key}_{self.pair.axis}"

    @property
    def is_slow(self) -> bool:
        """Logged too slowly to show how it follows."""
        return self.pair.rate_hz < self.pair.min_rate_hz


@dataclass(frozen=True, eq=False)
class Tracked:
    """Everything that the section states of a flight.

    Attributes
    ----------
    resting : of every motor the share of the time at its minimum, where some axis oscillates.
    """

    flight: LoggedFlight
    followed: tuple[Followed, ...]
    oscillations: Mapping[str, Oscillation]
    resting: tuple[float, ...]
    controllers: tuple[AtLimit, ...]
    judged: tuple[Judged, ...]

    def of(self, loop: str, axis: str) -> Followed | None:
        """One pair; None where the log does not hold it."""
        wanted = f"{loop}_{axis}"
        return next((found for found in self.followed if found.name == wanted), None)


@on_one_thread
def track(flight: LoggedFlight) -> Tracked:
    """Measure it."""
    counts = in_control(flight)
    held = list(pairs(flight))
    followed = tuple(found for pair in held if (found := _follow(pair, counts)) is not None)
    shaken = dict(_oscillations(flight, held, counts))
    return Tracked(
        flight,
        followed,
        shaken,
        tuple(resting_motors(flight, counts)) if any(found.rms for found in shaken.values()) else (),
        tuple(controller_limits(flight, counts)),
        flight.judged,
    )


def _oscillations(
    flight: LoggedFlight, held: Sequence[Pair], counts: Counting
) -> Iterator[tuple[str, Oscillation]]:
    """Of every axis whose gyro is logged long enough, beside a setpoint of the rate or of the angle."""
    rates = {pair.axis: pair for pair in held if pair.loop.key == "rate"}
    angles = {pair.axis: pair for pair in held if pair.loop.key == "attitude"}
    for axis in AXES:
        rate = rates.get(axis)
        gyro = fastest_gyro(flight, axis, rate.measured if rate is not None else None)
        setpoint = rate.setpoint if rate is not None else _slope(angles.get(axis))
        if gyro is None or setpoint is None:
            continue
        shaken = oscillation(gyro, setpoint, counts)
        if shaken is not None:
            yield axis, shaken


def _slope(pair: Pair | None) -> Column | None:
    """How fast the setpoint of an angle turns."""
    if pair is None or len(pair.setpoint) < LEAST_ROWS:
        return None
    asked = pair.setpoint
    turned = np.gradient(np.unwrap(asked.values, period=TURN_DEG), asked.time_s)
    return Column(asked.address, "deg/s", asked.time_s, np.nan_to_num(turned, posinf=0.0, neginf=0.0))


def _follow(pair: Pair, counts: Counting) -> Followed | None:
    """None of a pair that was never logged in the air."""
    rows = at_rows(pair, counts)
    if not rows.counts.any():
        return None
    grid = on_grid(pair, counts)
    rms = float(np.sqrt(np.mean(rows.error**2)))
    slow = pair.rate_hz < pair.min_rate_hz
    lag = _too_slow(pair) if slow else lag_of(grid, pair.search_s)
    is_inner = pair.loop.key == "rate" and pair.axis != "yaw"
    steps = overshoot(pair, counts) if is_inner and lag.is_known else None
    return Followed(pair, rows, grid, rms, lag, steps)


def _too_slow(pair: Pair) -> Lag:
    rate = pair.rate_hz
    return Lag(
        why=f"logged at {rate:.0f} Hz, which shows nothing above {0.5 * rate:.0f} Hz; "
        f"{pair.min_rate_hz:.0f} Hz are needed"
    )
