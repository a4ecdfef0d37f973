"""Measurements of a flight's loops: error, lag, overshoot, oscillation, saturation and margins."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import DataError
from flysid.ingest.lake.motors import read_motors
from flysid.loops.betaflight import AXES
from flysid.loops.judged import Judged
from flysid.model.polynomials import Z95
from flysid.model.threads import on_one_thread
from flysid.reviews.follow import TURN_DEG, Counting, Lag, Together, at_rows, lag_of, on_grid
from flysid.reviews.logged import Column, LoggedFlight
from flysid.reviews.oscillation import Oscillation, fastest_gyro, oscillation
from flysid.reviews.pairs import Pair, in_control, pairs, recipe_of

MS = 1000.0
PERCENT = 100.0
LEAST_ROWS = 3


@dataclass(frozen=True)
class Overshoot:
    """Percent of a step beyond it, with its 95 % interval; `why` it is not known where it is NaN."""

    percent: float = float("nan")
    interval: tuple[float, float] | None = None
    why: str = ""


@dataclass(frozen=True)
class AtLimit:
    """Share of the time in the air that a controller's output stands at its limit."""

    axis: str
    address: str
    share: float


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
    def moved(self) -> float:
        """Standard deviation of the setpoint in the air, in its unit."""
        return float(np.std(self.rows.setpoint[self.rows.counts]))

    @property
    def is_slow(self) -> bool:
        """Logged too slowly to show how it follows."""
        return self.pair.rate_hz < self.pair.min_rate_hz


@dataclass(frozen=True, eq=False)
class Tracked:
    """Everything that the section states of a flight.

    `resting`: of every motor the share of the time at its minimum, where some axis oscillates.
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
    """Measure the loops of a flight."""
    judged = flight.judged  # first: it takes most memory, and of the pairs below nothing is held yet
    counts = in_control(flight)
    controllers = tuple(controller_limits(flight, counts))  # it adds terms up, before the pairs are held
    held = list(pairs(flight))
    followed = tuple(found for pair in held if (found := _follow(pair, counts)) is not None)
    shaken = dict(_oscillations(flight, held, counts))
    return Tracked(
        flight,
        followed,
        shaken,
        tuple(resting_motors(flight, counts)) if any(found.rms for found in shaken.values()) else (),
        controllers,
        judged,
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
    angle = pair.setpoint
    turned = np.gradient(np.unwrap(angle.values, period=TURN_DEG), angle.time_s)
    return Column(angle.address, "deg/s", angle.time_s, np.nan_to_num(turned, posinf=0.0, neginf=0.0))


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


def overshoot(
    pair: Pair, counts: Counting, *, fastest_hz: float = 125.0, taps: int = 60, widest: float = 30.0
) -> Overshoot:
    """Of a loop, within the longest lag that is looked for.

    `fastest_hz`, `taps`: what the response is resolved to: it has to be cheap.
    `widest`: percent to either side: an interval beyond determines nothing.
    """
    from flysid.model.step_response import step_response

    together = on_grid(pair, counts, fastest_hz=fastest_hz)
    period = 1.0 / min(pair.rate_hz, fastest_hz)
    segments = tuple(
        Segment(together.setpoint[run, None], together.measured[run, None])
        for run in together.flown
        if run.stop - run.start > taps
    )
    if not segments:
        return Overshoot(why="too little flight without a pause")
    unit = pair.loop.unit
    data = Dataset(period, (Signal("setpoint", unit),), (Signal("measured", unit),), segments)
    try:
        found = step_response(data, horizon_s=0.6 * pair.search_s, most_taps=taps, rounds=2, anyway=True)
    except DataError as error:
        return Overshoot(why=error.message)
    top = int(np.argmax(found.step))
    beyond, reach = (100.0 * float(part) for part in (found.step[top] - 1.0, Z95 * found.error[top]))
    if reach > widest:
        return Overshoot(why=f"between {beyond - reach:.0f} and {beyond + reach:.0f} %")
    return Overshoot(max(beyond, 0.0), (max(beyond - reach, 0.0), max(beyond + reach, 0.0)))


def controller_limits(flight: LoggedFlight, counts: Counting) -> list[AtLimit]:
    """Of the rate controllers of roll, pitch and yaw, as far as a log states output and limit."""
    found = []
    for k, axis in enumerate(AXES):
        output = _output(flight, axis, k)
        if output is None:
            continue
        column, limit = output
        values = column.values[counts(column.time_s)]
        if len(values):
            found.append(
                AtLimit(axis, column.address, float(np.mean(np.abs(values) >= limit * (1.0 - 1e-6))))
            )
    return found


def resting_motors(flight: LoggedFlight, counts: Counting, *, least: float = 0.001) -> list[float]:
    """Of every motor the share of the time in the air that its command is its minimum.

    `least`: share of the range up to which a command is the minimum.
    """
    flown = [motor.command.values[counts(motor.command.time_s)] for motor in read_motors(flight)]
    return [float(np.mean(values <= least)) for values in flown if len(values)]


def _output(flight: LoggedFlight, axis: str, place: int) -> tuple[Column, float] | None:
    """A controller's output and its limit."""
    if flight.has("main"):
        name = "pidsum_limit_yaw" if axis == "yaw" else "pidsum_limit"
        thousandths = flight.parameters.get(name)
        if thousandths is None:
            return None
        output = flight.signal(recipe_of("betaflight-rate").signals[f"{axis}_pid_sum"])
        return (output, 0.1 * thousandths) if output is not None else None
    output = flight.quantity(
        f"RATE.{axis[0].upper()}Out",
        f"vehicle_torque_setpoint.xyz[{place}]",
        f"actuator_controls_0.control[{place}]",
    )
    return (output, 1.0) if output is not None else None
