"""What instruments should read: rigid-body kinematics of the others' signals, on one grid.

Axes are forward, right, down; the world's z points down. Signals are interpolated by cubic splines through
the samples as they were logged, so that slow sources lose nothing below a fifth of their rate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.constants import g as GRAVITY
from scipy.special import ndtri

from flysid.dataset import FloatArray
from flysid.ingest.align import resample
from flysid.ingest.align.resample import RecordedSignal, Span
from flysid.ingest.kinematics.agreement import MotionRecord

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Columns = Mapping[str, FloatArray]

MIN_SECONDS = 5.0
"""Of a stretch that is compared."""
ANGLES = frozenset({"roll", "pitch", "yaw", "heading"})


@dataclass(frozen=True, eq=False)
class Grid:
    """Signals of one stretch at equal steps: name -> (N,); and the density of their white noise, 1/Hz."""

    dt_s: float
    columns: Columns
    noise: Mapping[str, float]

    def densities(self, *names: str) -> FloatArray:
        """(n,) of some signals."""
        return np.array([self.noise[name] for name in names])

    def stack(self, *names: str) -> FloatArray:
        """(N, n) some signals side by side."""
        return np.column_stack([self.columns[name] for name in names])


def gridded(series: Mapping[str, RecordedSignal], allowed: Sequence[Span] | None) -> list[Grid]:
    """All signals at the rate of the fastest, wherever none pauses and conditions hold."""
    series = {n: replace(s, x=np.unwrap(s.x)) if n in ANGLES else s for n, s in series.items()}
    periods = {name: resample.period_ns(s.t_ns) for name, s in series.items()}
    dt_ns = min(periods.values())
    spans: Sequence[Span] = allowed if allowed is not None else [(-resample.FOREVER, resample.FOREVER)]
    for own in series.values():
        gap_ns = resample.GAP_PERIODS * max(periods.values())  # what is fast is not looked at anyway
        spans = resample.intersect(spans, resample.spans_between_gaps(own.t_ns, gap_ns))
    long_enough = [s for s in spans if (s[1] - s[0]) * 1e-9 >= MIN_SECONDS]
    noise = {name: white_noise(own) for name, own in series.items()}
    return [Grid(dt_ns * 1e-9, _sample(series, span, dt_ns), noise) for span in long_enough]


def white_noise(series: RecordedSignal) -> float:
    """Spectral density of a signal's white noise, per Hz on both sides: what its fastest tenth holds."""
    from flysid.filters import power_density

    period = resample.period_ns(series.t_ns) * 1e-9
    frequency, power = power_density([np.diff(series.x)], period)
    omega = 2.0 * np.pi * frequency * period
    fast = omega > 0.8 * np.pi
    return float(np.median(0.5 * power[fast] / (2.0 - 2.0 * np.cos(omega[fast]))))


def _sample(series: Mapping[str, RecordedSignal], span: Span, dt_ns: float) -> Columns:
    from scipy.interpolate import CubicSpline

    steps = np.arange(0.0, float(span[1] - span[0] - 1), dt_ns)
    columns = {}
    for name, own in series.items():
        near = slice(
            max(0, int(np.searchsorted(own.t_ns, span[0])) - 1),
            int(np.searchsorted(own.t_ns, span[1])) + 1,
        )
        columns[name] = np.asarray(CubicSpline((own.t_ns[near] - span[0]).astype(float), own.x[near])(steps))
    return columns


def without_jumps(record: MotionRecord, source_s: float, *, rare: float = 1e-3) -> list[MotionRecord]:
    """The stretches between the jumps of an estimator that was reset.

    A jump stands for one or two periods of the slowest source, `source_s`. It is what noise does in one of
    a thousand records, measured by the median of the difference, here and in the whole record.

    `rare`: chance that noise of a whole record passes for a jump.
    """
    from scipy.ndimage import maximum_filter1d, median_filter

    off = record.measured - record.implied
    off = np.abs(off - np.median(off, axis=0))
    reach = max(1, round(source_s / record.dt_s))
    usual = np.maximum(median_filter(off, (7 * reach, 1)), np.median(off, axis=0))
    limit = ndtri(0.5 * rare / off.size) / ndtri(0.25)
    jumps = np.any(off > limit * usual, axis=1)
    free = ~maximum_filter1d(jumps, 4 * reach + 1)
    edges = np.flatnonzero(np.diff(free, prepend=False, append=False))
    return [
        replace(record, measured=record.measured[a:b], implied=record.implied[a:b], arm=record.arm[a:b])
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if (b - a) * record.dt_s >= MIN_SECONDS
    ]


def highest_hz(series: Mapping[str, RecordedSignal], *, good_to: float = 0.2) -> float:
    """Up to where splines through all of the signals are good.

    `good_to`: of a source's rate: a cubic spline through samples loses less than 1 % of what is slower.
    """
    slowest = max(resample.period_ns(s.t_ns) for s in series.values())
    return good_to * 1e9 / slowest


def slope(values: FloatArray, dt_s: float) -> FloatArray:
    """(N, n) central differences."""
    return np.asarray(np.gradient(values, dt_s, axis=0))


def attitude(grid: Grid) -> Rotation:
    """N rotations from the body's axes to the world's."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("ZYX", grid.stack("yaw", "pitch", "roll"))


def turning(rotations: Rotation, dt_s: float) -> FloatArray:
    """(N, 3) body rates of an attitude, central differences on the group."""
    steps = (rotations[:-1].inv() * rotations[1:]).as_rotvec() / dt_s
    return np.vstack([steps[:1], 0.5 * (steps[:-1] + steps[1:]), steps[-1:]])


def gyro(grid: Grid) -> MotionRecord:
    """A gyro against the attitude."""
    measured = grid.stack("p", "q", "r")
    noise = grid.densities("roll", "pitch", "yaw")
    implied = turning(attitude(grid), grid.dt_s)
    return MotionRecord(grid.dt_s, measured, implied, _no_arm(measured), noise, np.zeros(3))


def accelerometer(grid: Grid) -> MotionRecord:
    """An accelerometer against velocity and attitude; lever arms along the body's axes, metres."""
    felt = slope(grid.stack("v_north", "v_east", "v_down"), grid.dt_s) - np.array([0.0, 0.0, GRAVITY])
    rates = grid.stack("p", "q", "r")
    rising = slope(rates, grid.dt_s)
    arms = []
    for axis in np.eye(3):
        along = np.broadcast_to(axis, rates.shape)
        arms.append(np.cross(rising, along) + np.cross(rates, np.cross(rates, along)))
    to_body = attitude(grid).inv()
    noise = np.mean(to_body.as_matrix() ** 2, axis=0) @ grid.densities("v_north", "v_east", "v_down")
    tilted = GRAVITY**2 * np.array([*grid.densities("pitch", "roll"), 0.0])
    return MotionRecord(
        grid.dt_s, grid.stack("f_x", "f_y", "f_z"), to_body.apply(felt), np.stack(arms, axis=2), noise, tilted
    )


def velocity(grid: Grid) -> MotionRecord:
    """A velocity in the world against the position."""
    measured = grid.stack("v_north", "v_east", "v_down")
    implied = slope(grid.stack("north", "east", "down"), grid.dt_s)
    noise = grid.densities("north", "east", "down")
    return MotionRecord(grid.dt_s, measured, implied, _no_arm(measured), noise, np.zeros(3))


def heading_velocity(grid: Grid) -> MotionRecord:
    """A velocity along and to the right of the heading against the position."""
    measured = grid.stack("v_forward", "v_right")
    north, east = slope(grid.stack("north", "east"), grid.dt_s).T
    heading = grid.columns["heading"]
    forward = north * np.cos(heading) + east * np.sin(heading)
    right = east * np.cos(heading) - north * np.sin(heading)
    noise = np.full(2, np.mean(grid.densities("north", "east")))
    return MotionRecord(
        grid.dt_s, measured, np.column_stack([forward, right]), _no_arm(measured), noise, np.zeros(2)
    )


def _no_arm(measured: FloatArray) -> FloatArray:
    return np.empty((*measured.shape, 0))


INSTRUMENTS: Mapping[str, Callable[[Grid], MotionRecord]] = {
    "gyro": gyro,
    "accelerometer": accelerometer,
    "velocity": velocity,
    "heading_velocity": heading_velocity,
}
"""By the channel of `quantities.toml`."""
