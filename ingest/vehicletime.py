"""Vehicle time of messages, whether they carry it or not, from their order in the file.

Each system keeps its own clock: the time since boot that its autopilot (component 1 where it has one) states.
These messages are knots. Any other message of the system lies between the knots before and after it in the
file, at the place that its arrival (or, without arrival times, its position) gives it. This needs no global
fit, holds at any slope (0.92 to 27 have been seen), and a burst on the link cannot reorder anything.

Messages that carry a time are believed where it agrees with the knots: MAVLink's `time_usec` counts from
boot in some messages and from 1970 in others, and a companion computer counts from its own boot. A system
without a clock (a ground station), or with one that disagrees and no autopilot, is placed on the clock of
the main vehicle. A format with a single source of messages (DataFlash) is one system.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from flysid.ingest.clock import (
    SECOND_NS,
    IntArray,
    UtcFit,
    back_steps,
    is_outlier,
    split_points,
    wrap_points,
)

LONG_PERIOD_NS = 86400 * SECOND_NS
UNIX_NS = 10**18  # 2001: a clock that counts from boot does not get there
AGREES_NS = 5 * SECOND_NS
OUTLIER_NS = 10 * SECOND_NS
AUTOPILOT_COMPONENT = 1
Source = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Clocked:
    """The messages of one stream in one batch that carry a time.

    Attributes
    ----------
    source : (system, component, message id).
    field : which field the time comes from.
    rows : (n,) positions among the batch's frames, rising.
    time_ns : (n,) the stated time.
    is_boot_clock : the field counts from boot by definition; others are knots only where no such field is.
    period_ns : where the field wraps (32 bits of microseconds last 71 minutes); 0 for 64 bits.
    """

    source: Source
    field: str
    rows: IntArray
    time_ns: IntArray
    is_boot_clock: bool = True
    period_ns: int = 0


@dataclass(frozen=True, eq=False)
class Knots:
    """One system's clock within a batch: rising rows, with time and boot."""

    rows: IntArray
    time_ns: IntArray
    boots: IntArray


@dataclass
class _System:
    """What is remembered of a system between batches."""

    component: int
    boot: int = 0
    last: dict[Source, int] = field(default_factory=dict)
    knot: tuple[int, int] | None = None  # arrival (or row), time
    fit: UtcFit = field(default_factory=UtcFit)


@dataclass
class VehicleTime:
    """Gives every frame its vehicle time, batch after batch.

    Parameters
    ----------
    vehicles : systems known to be vehicles (filled by the reader from heartbeats).
    """

    vehicles: set[int] = field(default_factory=set)
    main: int | None = None
    outliers: dict[Source, int] = field(default_factory=dict)
    sources: dict[Source, str] = field(default_factory=dict)
    _systems: dict[int, _System] = field(default_factory=dict)
    _wraps: dict[Source, int] = field(default_factory=dict)

    def unwrapped(self, stream: Clocked) -> Clocked:
        """The stream with wraps of its own counter undone, those of earlier batches included.

        Counters that wrap within minutes are left to `settle`, which knows the time to the second.
        """
        if stream.period_ns < LONG_PERIOD_NS:
            return stream
        wraps = wrap_points(stream.time_ns, stream.period_ns)
        before = self._wraps.get(stream.source, 0)
        if not len(wraps) and not before:
            return stream
        self._wraps[stream.source] = before + len(wraps)
        count = before + np.searchsorted(wraps, np.arange(len(stream.rows)), side="right")
        return replace(stream, time_ns=stream.time_ns + count * stream.period_ns)

    def place(
        self, systems: npt.NDArray[np.uint8], clocked: list[Clocked], arrival: IntArray, *, utc: bool
    ) -> tuple[IntArray, IntArray]:
        """Vehicle time and boot of every frame of a batch, before a stream's own times are put in.

        Parameters
        ----------
        systems : (n,) system of every frame, in file order.
        clocked : all streams that carry a time.
        arrival : (n,) arrival in nanoseconds UTC, or positions where `utc` is False.
        """
        knots = {system: self._knots(system, clocked, arrival, utc) for system in _clock_owners(clocked)}
        if self.main is None or (self.main not in self.vehicles and self.vehicles & set(knots)):
            self.main = self._choose_main(knots)
        time_ns, boots = arrival.copy(), np.zeros(len(arrival), dtype=np.int64)
        for system in np.unique(systems).tolist():
            rows = np.flatnonzero(systems == system)
            owner = self._owner(system)
            if owner is not None:
                time_ns[rows], boots[rows] = self._between(owner, rows, knots.get(owner), arrival, utc)
        return time_ns, boots

    def settle(self, stream: Clocked, placed_ns: IntArray) -> IntArray:
        """The times of a stream: its own where they agree with `placed_ns`, otherwise those.

        Rows that disagree alone are counted as outliers, unless they say 0 ("not set").
        """
        own = stream.time_ns
        if stream.period_ns:
            own = own + np.rint((placed_ns - own) / stream.period_ns).astype(np.int64) * stream.period_ns
        apart = np.abs(own - placed_ns)
        is_set = stream.time_ns > 0
        if stream.source not in self.sources:
            agrees = is_set.any() and np.median(apart[is_set]) <= AGREES_NS
            self.sources[stream.source] = stream.field if agrees else "arrival-mapped"
        if self.sources[stream.source] != stream.field:
            return placed_ns
        wrong = apart > OUTLIER_NS
        count = int((wrong & is_set).sum())
        if count:
            self.outliers[stream.source] = self.outliers.get(stream.source, 0) + count
        return np.where(wrong, placed_ns, own)

    def source_of(self, source: Source) -> str:
        """How a stream without a time field of its own was placed."""
        return "arrival" if self._owner(source[0]) is None else "arrival-mapped"

    def fit(self) -> UtcFit:
        """The main vehicle's pairs of vehicle time and UTC; empty where nothing carries a clock."""
        return self._systems[self.main].fit if self.main in self._systems else UtcFit()

    def _owner(self, system: int) -> int | None:
        """Whose clock a system is placed on."""
        if system in self._systems and (system in self.vehicles or system == self.main):
            return system
        return self.main

    def _choose_main(self, knots: dict[int, Knots]) -> int | None:
        known = [s for s in knots if s in self.vehicles] or list(knots)
        return max(known, key=lambda s: (len(knots[s].rows), -s), default=self.main)

    def _knots(self, system: int, clocked: list[Clocked], arrival: IntArray, utc: bool) -> Knots:
        """The knots of a system in this batch; splits boots and feeds the fit to UTC."""
        state = self._systems.get(system)
        if state is None:
            state = self._systems[system] = _System(_clock_component(system, clocked))
        streams = _clock_streams(system, state.component, clocked)
        good = [_without_outliers(s) for s in streams]
        splits = split_points([i for s in good for i in self._steps(state, s)], len(good))
        rows = np.concatenate([s.rows for s in good]) if good else np.empty(0, np.int64)
        order = np.argsort(rows, kind="stable")
        rows = rows[order]
        times = np.concatenate([s.time_ns for s in good])[order] if good else rows
        boots = state.boot + np.searchsorted(np.array(splits, dtype=np.int64), rows, side="right")
        for boot in np.unique(boots).tolist():
            inside = boots == boot
            times[inside] = np.maximum.accumulate(times[inside])
            state.fit.add(boot, times[inside], arrival[rows[inside]] if utc else None)
        state.boot += len(splits)
        return Knots(rows, times, boots)

    def _steps(self, state: _System, stream: Clocked) -> list[tuple[int, int]]:
        """Intervals of positions in which a stream steps back, the step from the last batch included."""
        steps = back_steps(stream.time_ns).tolist()
        intervals = [(int(stream.rows[i - 1]), int(stream.rows[i])) for i in steps]
        last = state.last.get(stream.source)
        if last is not None and stream.time_ns[0] < last - SECOND_NS:
            intervals.append((-1, int(stream.rows[0])))
        state.last[stream.source] = int(stream.time_ns[-1])
        return intervals

    def _between(
        self, owner: int, rows: IntArray, knots: Knots | None, arrival: IntArray, utc: bool
    ) -> tuple[IntArray, IntArray]:
        """Time and boot of frames between the knots of `owner`."""
        state = self._systems[owner]
        slope = 1.0 / state.fit.slope(state.boot) if utc else 0.0
        if knots is None or not len(knots.rows):
            at, time = state.knot or (int(arrival[0]), 0)
            ahead = ((arrival[rows] - at) * slope).astype(np.int64)
            return time + np.maximum(ahead, 0), np.full(len(rows), state.boot, dtype=np.int64)
        after = np.searchsorted(knots.rows, rows, side="right")
        left, right = np.maximum(after - 1, 0), np.minimum(after, len(knots.rows) - 1)
        boots = np.where(after == 0, knots.boots[0], knots.boots[left])
        left = np.where(after == 0, 0, left)
        right = np.where(knots.boots[right] == boots, right, left)
        start, stop = arrival[knots.rows[left]], arrival[knots.rows[right]]
        share = np.clip((arrival[rows] - start) / np.maximum(stop - start, 1), 0.0, 1.0)
        step = knots.time_ns[right] - knots.time_ns[left]
        beyond = ((arrival[rows] - start) * slope).astype(np.int64)
        inside = (right > left) & (after > 0)
        beyond = np.where(after == 0, np.minimum(beyond, 0), np.maximum(beyond, 0))
        time_ns = knots.time_ns[left] + np.where(inside, (share * step).astype(np.int64), beyond)
        state.knot = (int(arrival[knots.rows[-1]]), int(knots.time_ns[-1]))
        return time_ns, boots


def _clock_owners(clocked: list[Clocked]) -> list[int]:
    return sorted({stream.source[0] for stream in clocked})


def _clock_component(system: int, clocked: list[Clocked]) -> int:
    """The component whose messages are a system's clock: the autopilot, else whoever says the time most."""
    counts: dict[int, int] = {}
    for stream in clocked:
        if stream.source[0] == system:
            weight = len(stream.rows) * (1000 if stream.is_boot_clock else 1)
            counts[stream.source[1]] = counts.get(stream.source[1], 0) + weight
    if AUTOPILOT_COMPONENT in counts:
        return AUTOPILOT_COMPONENT
    return max(counts, key=lambda component: (counts[component], -component))


def _clock_streams(system: int, component: int, clocked: list[Clocked]) -> list[Clocked]:
    """The streams that serve as knots: time since boot, or failing that any time that is not UNIX time."""
    own = [s for s in clocked if s.source[:2] == (system, component)]
    return [s for s in own if s.is_boot_clock] or [s for s in own if 0 < int(np.median(s.time_ns)) < UNIX_NS]


def _without_outliers(stream: Clocked) -> Clocked:
    keep = ~is_outlier(stream.time_ns)
    if keep.all() or not keep.any():
        return stream
    return replace(stream, rows=stream.rows[keep], time_ns=stream.time_ns[keep])
