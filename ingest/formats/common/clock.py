"""Vehicle time: boots, outliers, and a robust map to UTC. Plain arrays in, plain arrays out.

A vehicle's clock counts from its boot. It steps back when the vehicle reboots, it may carry single absurd
values, and arrival times at the ground jitter by seconds against it. So order in the file is trusted first,
the vehicle's own counter second, arrival times last.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from flysid.flight import ClockMap

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]

SECOND_NS = 1_000_000_000
UNIX_NS = 10**18
"""In 2001: a time beyond it counts from 1970, no clock that counts from boot gets there."""
BACK_STEP_NS = 1 * SECOND_NS
JUMP_NS = 3600 * SECOND_NS
LEAP_NS = 10 * SECOND_NS
SIDE = 3
MAX_KNOTS = 1 << 16


def is_outlier(time_ns: IntArray, tolerance_ns: int = BACK_STEP_NS) -> BoolArray:
    """(n,) True where a value fits neither the three values before it nor the three after it.

    Between the medians of both sides is right where time rises, whatever the gap. Where the median falls (a
    reboot) a value must go on from the left or lead to the right. At the ends a value must lie within an
    hour of its one side.
    """
    count = len(time_ns)
    flagged = np.zeros(count, dtype=np.bool_)
    if count < 2 * SIDE + 1:
        return flagged
    steps = np.diff(time_ns)
    ends = np.concatenate([steps[:SIDE], steps[-SIDE:]])
    if not (steps < -tolerance_ns).any() and not (ends > JUMP_NS).any():
        return flagged
    median = _median_of_three(time_ns[:-2], time_ns[1:-1], time_ns[2:])
    left = median[: -SIDE - 1]
    right = median[SIDE + 1 :]
    middle = time_ns[SIDE:-SIDE]
    low = middle < left - tolerance_ns
    high = middle > right + tolerance_ns
    flagged[SIDE:-SIDE] = np.where(left <= right, low | high, low & high)
    flagged[:SIDE] = np.abs(time_ns[:SIDE] - median[SIDE]) > JUMP_NS
    flagged[-SIDE:] = np.abs(time_ns[-SIDE:] - median[-SIDE - 1]) > JUMP_NS
    return flagged


def _median_of_three(a: IntArray, b: IntArray, c: IntArray) -> IntArray:
    return np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))


def out_of_place(time_ns: IntArray, tolerance_ns: int) -> BoolArray:
    """(n,) True where the times of one clock, read in order, are absurd: as `is_outlier` finds, or zero.

    A zero is one of a clock that was not set, unless the next time that is set is near zero.
    """
    flagged = is_outlier(time_ns, tolerance_ns)
    zero = time_ns == 0
    if zero.any() and not zero.all():
        is_set = np.flatnonzero(~zero)
        near = np.minimum(np.searchsorted(is_set, np.flatnonzero(zero)), len(is_set) - 1)
        flagged[zero] |= time_ns[is_set[near]] > tolerance_ns
    return flagged


@dataclass(frozen=True)
class Fall:
    """A clock that steps back: last position before, first position after, and by how much."""

    before: int
    after: int
    size_ns: int


@dataclass(frozen=True)
class Extent:
    """From where to where a stream stands, and the usual step of its time."""

    first: int
    last: int
    step_ns: int


def usual_step(time_ns: IntArray) -> int:
    """The median of the steps forward; 0 where there is none."""
    steps = np.diff(time_ns)
    forward = steps[steps > 0]
    return int(np.median(forward)) if len(forward) else 0


def back_steps(time_ns: IntArray) -> IntArray:
    """Indices i before which a stream's clock began anew.

    It steps back, and goes on by its usual steps until it is past where it was. Messages that are only late
    end with a leap ahead instead: within a few messages where the step was more than a second, as the link of
    a vehicle that began anew may break off too.
    """
    steps = np.diff(time_ns)
    back = np.flatnonzero(steps < 0) + 1
    if not len(back):
        return back
    usual = 1.5 * usual_step(time_ns)
    follows = (
        np.append(steps, np.inf)[back] <= usual
    )  # the next message, too, is where it would be after a reboot
    long = steps[back - 1] < -BACK_STEP_NS
    found = back[long | follows]
    return np.array([i for i in found.tolist() if not _is_late(time_ns, i, usual)], dtype=np.int64)


def _is_late(time_ns: IntArray, at: int, usual_ns: float) -> bool:
    """Whether the clock leaps past its readings before `at`."""
    is_long = time_ns[at] < time_ns[at - 1] - BACK_STEP_NS
    after = time_ns[at : at + SIDE + 1] if is_long else time_ns[at:]
    past = np.flatnonzero(after > time_ns[at - 1])
    return bool(len(past) and after[past[0]] - after[past[0] - 1] > usual_ns)


def wrap_points(counter_ns: IntArray, period_ns: int) -> IntArray:
    """Indices i where a counter of that period starts again at zero: two high values, then two low ones."""
    margin = 3600 * SECOND_NS
    high = counter_ns > period_ns - margin
    low = counter_ns < margin
    return np.flatnonzero(high[:-3] & high[1:-2] & low[2:-1] & low[3:]) + 2


def split_points(falls: list[Fall], streams: list[Extent]) -> list[int]:
    """Positions where boots begin, from the falls of several streams.

    Overlapping falls tell of the same reboot. Half of the streams must have seen it, of those that could:
    they stand on both sides, and their steps are shorter than the fall. What one stream saw alone is its own
    fault.
    """
    splits: list[int] = []
    group: list[Fall] = []
    for fall in [*sorted(falls, key=lambda f: f.after), Fall(1 << 62, 1 << 62, 0)]:
        if group and fall.before >= group[0].after:
            at = group[0].after
            size = max(f.size_ns for f in group)
            able = sum(s.first < at <= s.last and s.step_ns <= size for s in streams)
            if 2 * len(group) >= able:
                splits.append(at)
            group = []
        group.append(fall)
    return splits


def leaps(time_ns: IntArray, arrival_ns: IntArray, least_ns: int, *, memory: int = 256) -> IntArray:
    """Indices i before which a clock leapt ahead of the arrivals by more than `least_ns`.

    What the arrivals explain is their step times the rate of this record: replays run up to 27 times as fast.
    Messages may come late, and what was late catches up; but none comes early, so that only a clock that
    leapt is ahead of all its earlier readings.

    Parameters
    ----------
    memory : messages before that it must be ahead of: further back, the rate is not known well enough.
    """
    steps = np.diff(time_ns)
    if not (steps > least_ns).any():
        return np.empty(0, np.int64)
    rate = _usual_rate(arrival_ns, time_ns)
    least = max(max(rate, 1.0) * least_ns, 2 * usual_step(time_ns))
    beyond = steps - rate * np.maximum(np.diff(arrival_ns), 0)
    ahead = np.append(0.0, np.cumsum(beyond))
    found = np.flatnonzero((steps > least) & (beyond > least)) + 1
    leapt = [
        ahead[i : i + SIDE].min() - ahead[max(i - memory, 0) : i].max() > beyond[i - 1] / 2 for i in found
    ]
    return found[np.array(leapt, dtype=np.bool_)]


def _usual_rate(x: IntArray, y: IntArray, *, parts: int = 20) -> float:
    """How fast y rises with x: the median between pairs a part of the record apart. 1.0 where x stands still.

    A leap bends one of these in `parts`; the fewer there are, the less does what came late.
    """
    apart = max(1, len(x) // parts)
    run = (x[apart:] - x[:-apart]).astype(np.float64)
    rise = (y[apart:] - y[:-apart])[run > 0]
    return max(float(np.median(rise / run[run > 0])), 0.0) if len(rise) else 1.0


def settings(time_ns: IntArray, utc_ns: IntArray, *, memory: int = 256) -> IntArray:
    """Indices i before which somebody set the clock that says the UTC: it leaps, either way, and stays.

    Messages may come late, but none comes early: the least delay so far is a floor, which only a clock that
    is set leaves. One that is set back says times below the floor; one that is set ahead comes no more down
    to it. A link that delays all messages alike from one moment on looks as the latter does, and is cut like
    it. A floor that moves by less than a second is left to the fit: links that queue up do as much.

    Parameters
    ----------
    memory : messages on either side that must show it, too: what bends slowly is no clock that was set.
    """
    left = (utc_ns - utc_ns[0]) - _usual_rate(time_ns, utc_ns, parts=8) * (time_ns - time_ns[0])
    found: list[int] = []
    parts = [(0, len(left))]
    while parts:
        start, stop = parts.pop()
        at = _setting_within(left[start:stop], utc_ns[start:stop], memory)
        if at:
            found.append(start + at)
            parts += [(start, start + at), (start + at, stop)]
    return np.array(sorted(found), dtype=np.int64)


def _setting_within(left: FloatArray, utc_ns: IntArray, memory: int) -> int:
    """Where the floor of these delays moves most; 0 where it does not.

    Behind a clock that was set ahead all places look alike, and so do those before one that was set back:
    there, the first and the last one are meant. What was held up comes at once: a part that lasts no longer
    than the floor moves may have been late as a whole, but not by more than links are.
    """
    steps = np.diff(left)
    places = np.flatnonzero(np.abs(steps) > BACK_STEP_NS / 2) + 1
    places = places[(places >= SIDE) & (places <= len(left) - SIDE)]
    if not len(places):
        return 0
    before = np.minimum.accumulate(left)
    behind = np.minimum.accumulate(left[::-1])[::-1]
    moved = behind[places] - before[places - 1]
    near = _least_of(left, memory)[places] - _least_of(left[::-1], memory)[len(left) - places]
    sizes = np.where(moved * near > 0, np.minimum(np.abs(moved), np.abs(near)), 0.0)
    lasts = np.where(moved > 0, utc_ns[-1] - utc_ns[places], utc_ns[places - 1] - utc_ns[0])
    sizes[(lasts <= sizes) & (sizes < LEAP_NS)] = 0.0
    best = float(sizes.max())
    if best <= BACK_STEP_NS:
        return 0
    alike = places[sizes > best / 2]
    return int(alike[0] if moved[sizes.argmax()] > 0 else alike[-1])


def _least_of(values: FloatArray, width: int) -> FloatArray:
    """(n,) the least of the values at [i, i + width), of those there are: spans double up to it."""
    least = np.concatenate([values, np.full(width, np.inf)])
    span = 1
    while 2 * span <= width:
        least = np.minimum(least[:-span], least[span:])
        span *= 2
    rest = width - span
    found: FloatArray = np.minimum(least[: len(values)], least[rest : rest + len(values)])
    return found


def interpolate(at: IntArray, knots: IntArray, values: IntArray, slope: float) -> IntArray:
    """Values at `at` by straight lines between knots (rising), and with `slope` beyond them.

    Works in integers around the left knot, so that nanoseconds since 1970 do not lose digits.
    """
    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 1)
    right = np.minimum(left + 1, len(knots) - 1)
    span = np.maximum(knots[right] - knots[left], 1)
    offset = at - knots[left]
    between = offset / span * (values[right] - values[left])
    outside = (offset < 0) | (right == left)
    return values[left] + np.where(outside, offset * slope, between).astype(np.int64)


@dataclass
class UtcFit:
    """Collects pairs (vehicle time, UTC) of each boot and fits one straight line per boot.

    The slope is the median of the slopes between points half a record apart, the offset the median
    residual (Theil 1950, Sen 1968, on n/2 pairs): half of the pairs may be wrong. Where the UTC was set anew
    within a boot, the longest part alone is taken, as no line fits two.
    """

    first_ns: dict[int, int] = field(default_factory=dict)
    last_ns: dict[int, int] = field(default_factory=dict)
    _pairs: dict[int, list[tuple[IntArray, IntArray]]] = field(default_factory=dict)
    _held: dict[int, int] = field(default_factory=dict)  # pairs of each boot
    _fitted: dict[int, tuple[int, float, int]] = field(default_factory=dict)  # until more pairs come
    _set: dict[int, tuple[int, ...]] = field(default_factory=dict)  # by how much the UTC was set, as fitted

    def add(self, boot: int, vehicle_ns: IntArray, utc_ns: IntArray | None = None) -> None:
        """More pairs of a boot, in order; `utc_ns` None where nothing anchors them."""
        if not len(vehicle_ns):
            return
        low = int(vehicle_ns.min())
        high = int(vehicle_ns.max())
        self.first_ns[boot] = min(low, self.first_ns.get(boot, low))
        self.last_ns[boot] = max(high, self.last_ns.get(boot, high))
        if utc_ns is not None:
            self.anchor(boot, vehicle_ns, utc_ns)

    def anchor(self, boot: int, vehicle_ns: IntArray, utc_ns: IntArray, *, knots_per_fit: int = 4000) -> None:
        """Pairs of a boot whose span is known from elsewhere.

        Some are kept: copies, as a view would keep the whole batch; and every other one of them again where
        they become many.
        """
        self._fitted.pop(boot, None)
        every = max(1, len(vehicle_ns) // knots_per_fit)
        kept = self._pairs.setdefault(boot, [])
        kept.append((vehicle_ns[::every].copy(), utc_ns[::every].copy()))
        self._held[boot] = self._held.get(boot, 0) + len(kept[-1][0])
        if self._held[boot] > MAX_KNOTS:
            vehicle, utc = (np.concatenate(parts)[::2].copy() for parts in zip(*kept, strict=True))
            self._pairs[boot], self._held[boot] = [(vehicle, utc)], len(vehicle)

    def slope(self, boot: int) -> float:
        """UTC seconds per vehicle second so far; 1.0 where unknown."""
        fitted = self._fit(boot)
        return fitted[1] if fitted else 1.0

    def set_by(self, boot: int) -> tuple[int, ...]:
        """Nanoseconds by which the UTC leapt each time that it was set within a boot."""
        self._fit(boot)
        return self._set.get(boot, ())

    def clocks(self) -> tuple[ClockMap, ...]:
        """One map per boot, in order."""
        maps = []
        for boot in sorted(self.first_ns):
            offset, slope, residual = self._fit(boot) or (None, 1.0, None)
            maps.append(ClockMap(boot, self.first_ns[boot], self.last_ns[boot], offset, slope, residual))
        return tuple(maps)

    def _fit(self, boot: int) -> tuple[int, float, int] | None:
        pairs = self._pairs.get(boot)
        if not pairs:
            return None
        if boot not in self._fitted:
            vehicle, utc = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
            at = settings(vehicle, utc)
            self._set[boot] = tuple(int(step) for step in np.diff(utc)[at - 1] - np.diff(vehicle)[at - 1])
            edges = [0, *at.tolist(), len(utc)]
            start, stop = max(pairwise(edges), key=lambda edge: edge[1] - edge[0])
            self._fitted[boot] = fit_line(vehicle[start:stop], utc[start:stop])
        return self._fitted[boot]


def fit_line(x: IntArray, y: IntArray) -> tuple[int, float, int]:
    """Robust y = offset + slope x; returns (offset, slope, median absolute residual).

    The slope is 1.0 where x hardly moves or no positive slope fits.
    """
    half = len(x) // 2
    run = (x[half:] - x[: len(x) - half]).astype(np.float64) if half else np.empty(0)
    rise = (y[half:] - y[: len(y) - half]).astype(np.float64) if half else np.empty(0)
    moved = run > 0
    slope = float(np.median(rise[moved] / run[moved])) if moved.any() else 1.0
    if not (np.isfinite(slope) and slope > 0):
        slope = 1.0
    x0 = int(x[0])
    y0 = int(y[0])
    residual = (y - y0) - slope * (x - x0)
    offset = float(np.median(residual))
    spread = float(np.median(np.abs(residual - offset)))
    return y0 + round(offset) - round(slope * x0), slope, round(spread)


def last_good(values: IntArray, is_bad: BoolArray) -> IntArray:
    """Every bad value replaced by the last good one before it, or by the first good one."""
    if not is_bad.any() or is_bad.all():
        return values
    index = np.maximum.accumulate(np.where(is_bad, -1, np.arange(len(values))))
    filled: IntArray = values[np.where(index < 0, int(np.argmin(is_bad)), index)]
    return filled
