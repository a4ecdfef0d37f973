"""Vehicle time of messages, whether they carry it or not, from their order in the file.

Each system keeps its own clock: the time since boot that its autopilot (component 1 where it has one) states.
These messages are knots. Any other message of the system lies between the knots before and after it in the
file, at the place that its arrival (or, without arrival times, its position) gives it. This needs no global
fit, holds at any slope (0.92 to 27 have been seen), and a burst on the link cannot reorder anything.

Messages that carry a time are believed where it agrees with the knots: MAVLink's `time_usec` counts from
boot in some messages and from 1970 in others, and a companion computer counts from its own boot. A system
without a clock (a ground station), or with one that disagrees and no autopilot, is placed on the clock of
the main vehicle. A format with a single source of messages (DataFlash) is one system.

No clock is followed where it is absurd: single times that are years off, or zero, are counted and placed.
Where it begins anew, or leaps ahead of the arrivals, a boot ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from flysid.ingest.formats.common.clock import (
    BACK_STEP_NS,
    LEAP_NS,
    SECOND_NS,
    UNIX_NS,
    BoolArray,
    Extent,
    Fall,
    IntArray,
    UtcFit,
    back_steps,
    is_outlier,
    leaps,
    out_of_place,
    split_points,
    usual_step,
    wrap_points,
)

NO_TIME = -(1 << 63)
LONG_PERIOD_NS = 86400 * SECOND_NS
AGREES_NS = 5 * SECOND_NS
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
    """One system's clock within a batch: rising rows with their time.

    `splits` are the rows at which boots begin, counted on from `first_boot`; `whole` are the streams of
    which every row is a knot.
    """

    rows: IntArray
    time_ns: IntArray
    splits: tuple[int, ...]
    first_boot: int
    whole: frozenset[Source]

    def boots_of(self, rows: IntArray) -> IntArray:
        """The boot that each row belongs to."""
        if not self.splits:
            return np.full(len(rows), self.first_boot, dtype=np.int64)
        return self.first_boot + np.searchsorted(np.array(self.splits), rows, side="right")


@dataclass
class _System:
    """What is remembered of a system between batches."""

    component: int
    boot: int = 0
    last: dict[Source, int] = field(default_factory=dict)
    tail: tuple[IntArray, IntArray] = (np.empty(0, np.int64), np.empty(0, np.int64))  # arrivals, last times
    fit: UtcFit = field(default_factory=UtcFit)


@dataclass
class VehicleTime:
    """Gives every frame its vehicle time, batch after batch.

    Parameters
    ----------
    vehicles : systems known to be vehicles (filled by the reader from heartbeats).
    has_one_clock : every stated time is of one and the same clock, and zero is a time like others.
    memory : messages of the batch before that a leap at the start of one is judged by.

    Attributes
    ----------
    outliers, out_of_order : records per stream whose time was rejected; whose time runs backwards.
    leapt : by how much a system's clock leapt ahead where a boot begins: system -> boot -> ns.
    """

    vehicles: set[int] = field(default_factory=set)
    has_one_clock: bool = False
    memory: int = 256
    main: int | None = None
    outliers: dict[Source, int] = field(default_factory=dict)
    out_of_order: dict[Source, int] = field(default_factory=dict)
    leapt: dict[int, dict[int, int]] = field(default_factory=dict)
    sources: dict[Source, str] = field(default_factory=dict)
    _systems: dict[int, _System] = field(default_factory=dict)
    _wraps: dict[Source, int] = field(default_factory=dict)
    _knots: dict[int, Knots] = field(default_factory=dict)
    _placed: dict[int, tuple[IntArray, IntArray]] = field(default_factory=dict)
    _arrival: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    _utc: bool = False
    _last: dict[Source, tuple[int, int]] = field(default_factory=dict)

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

    def begin(self, clocked: list[Clocked], arrival: IntArray, *, utc: bool) -> None:
        """Take in the next batch.

        Parameters
        ----------
        clocked : all streams that carry a time (`unwrapped`).
        arrival : (n,) arrival of every message in nanoseconds UTC, or its position where `utc` is False.
        """
        self._arrival = arrival
        self._utc = utc
        owners = sorted({stream.source[0] for stream in clocked})
        self._knots = {system: self._make_knots(system, clocked) for system in owners}
        self._placed = {}
        if self.main is None or (self.main not in self.vehicles and self.vehicles & set(self._knots)):
            self.main = self._choose_main()

    def times(self, source: Source, rows: IntArray, stated: Clocked | None) -> tuple[IntArray, IntArray]:
        """Vehicle time and boot of the messages of one stream in the batch.

        Its own times are taken where they agree with their place among the knots. Rows that disagree alone
        are counted as outliers, unless they say 0 ("not set").
        """
        time_ns, boots = self._times(source, rows, stated)
        if len(rows) and stated is not None:
            last_ns, boot = self._last.get(source, (0, -1))
            back = int(((np.diff(time_ns) < 0) & (np.diff(boots) == 0)).sum())
            back += int(boots[0] == boot and time_ns[0] < last_ns)
            self._last[source] = int(time_ns[-1]), int(boots[-1])
            if back:
                self.out_of_order[source] = self.out_of_order.get(source, 0) + back
        return time_ns, boots

    def _times(self, source: Source, rows: IntArray, stated: Clocked | None) -> tuple[IntArray, IntArray]:
        owner = self._owner(source[0])
        if owner is None:
            return self._arrival[rows], np.zeros(len(rows), dtype=np.int64)
        knots = self._knots.get(owner)
        if stated is not None and owner == source[0] and knots is not None and source in knots.whole:
            self.sources.setdefault(source, stated.field)
            if self.sources[source] == stated.field:
                return stated.time_ns, knots.boots_of(rows)
        if owner not in self._placed:
            self._placed[owner] = self._between(owner, np.arange(len(self._arrival)), knots)
        placed_ns, boots = (values[rows] for values in self._placed[owner])
        return (placed_ns if stated is None else self._settle(stated, placed_ns)), boots

    def _settle(self, stream: Clocked, placed_ns: IntArray) -> IntArray:
        own = stream.time_ns
        if stream.period_ns:
            own = own + np.rint((placed_ns - own) / stream.period_ns).astype(np.int64) * stream.period_ns
        apart = np.abs(own - placed_ns)
        is_trusted = self.has_one_clock and stream.is_boot_clock
        is_set = (stream.time_ns > 0) | is_trusted
        if stream.source not in self.sources:
            agrees = is_trusted or (is_set.any() and np.median(apart[is_set]) <= AGREES_NS)
            self.sources[stream.source] = stream.field if agrees else "arrival-mapped"
        if self.sources[stream.source] != stream.field:
            return placed_ns
        wrong = apart > LEAP_NS
        count = int((wrong & is_set).sum())
        if count:
            self.outliers[stream.source] = self.outliers.get(stream.source, 0) + count
        return np.where(wrong, placed_ns, own)

    def source_of(self, source: Source) -> str:
        """Where a stream's times come from: its field, or how it was placed."""
        if source in self.sources:
            return self.sources[source]
        return "arrival" if self._owner(source[0]) is None else "arrival-mapped"

    def fit(self) -> UtcFit:
        """The main vehicle's pairs of vehicle time and UTC; empty where nothing carries a clock."""
        return self._systems[self.main].fit if self.main in self._systems else UtcFit()

    def _owner(self, system: int) -> int | None:
        """Whose clock a system is placed on."""
        if system in self._systems and (system in self.vehicles or system == self.main):
            return system
        return self.main

    def _choose_main(self) -> int | None:
        known = [s for s in self._knots if s in self.vehicles] or list(self._knots)
        return max(known, key=lambda s: (len(self._knots[s].rows), -s), default=self.main)

    def _make_knots(self, system: int, clocked: list[Clocked]) -> Knots:
        """The knots of a system in this batch; splits boots and feeds the fit to UTC."""
        state = self._systems.get(system)
        if state is None:
            state = self._systems[system] = _System(_clock_component(system, clocked))
        streams = _clock_streams(system, state.component, clocked)
        good = self._without_absurd(state, [_without_outliers(s) for s in streams])
        splits = _boots(state, [s for s in good if len(s.rows)])
        rows, times = self._in_order(good)
        splits = sorted({*splits, *self._leaps(system, state, rows, times, splits)})
        edges = [0, *np.searchsorted(rows, splits).tolist(), len(rows)]
        for number, (start, stop) in enumerate(pairwise(edges)):
            np.maximum.accumulate(times[start:stop], out=times[start:stop])
            arrival = self._arrival[rows[start:stop]] if self._utc else None
            state.fit.add(state.boot + number, times[start:stop], arrival)
        first_boot = state.boot
        state.boot = state.boot + len(splits)
        if len(rows):
            state.tail = self._arrival[rows[-self.memory :]], times[-self.memory :].copy()
        whole = frozenset(s.source for s, g in zip(streams, good, strict=True) if s is g)
        return Knots(rows, times, tuple(splits), first_boot, whole)

    def _in_order(self, streams: list[Clocked]) -> tuple[IntArray, IntArray]:
        """The rows that state a time, rising, and their times."""
        times = np.full(len(self._arrival), NO_TIME, dtype=np.int64)
        for stream in streams:
            times[stream.rows] = stream.time_ns
        rows = np.flatnonzero(times != NO_TIME)
        return rows, times[rows]

    def _without_absurd(self, state: _System, streams: list[Clocked]) -> list[Clocked]:
        """The streams without times that are absurd among those of all of them."""
        rows, times = self._in_order(streams)
        before = state.tail[1]
        wrong = out_of_place(np.concatenate([before, times]), LEAP_NS)[len(before) :] | (times >= UNIX_NS)
        if not wrong.any():
            return streams
        bad = np.zeros(len(self._arrival), dtype=np.bool_)
        bad[rows[wrong]] = True
        return [_pick(stream, ~bad[stream.rows]) for stream in streams]

    def _leaps(
        self, system: int, state: _System, rows: IntArray, times: IntArray, splits: list[int]
    ) -> list[int]:
        """Rows at which a system's clock leaps ahead of the arrivals."""
        if not self._utc or not len(rows):
            return []
        arrival = np.concatenate([state.tail[0], self._arrival[rows]])
        joined = np.concatenate([state.tail[1], times])
        found = leaps(joined, arrival, BACK_STEP_NS, memory=self.memory) - len(state.tail[0])
        found = found[found >= 0]
        steps = np.diff(joined)
        for at in found.tolist():
            boot = state.boot + int(np.searchsorted(splits, rows[at])) + 1
            self.leapt.setdefault(system, {})[boot] = int(steps[at + len(state.tail[0]) - 1])
        return [int(row) for row in rows[found]]

    def _between(self, owner: int, rows: IntArray, knots: Knots | None) -> tuple[IntArray, IntArray]:
        """Time and boot of messages between the knots of `owner`."""
        state = self._systems[owner]
        arrival = self._arrival
        slope = 1.0 / state.fit.slope(state.boot) if self._utc else 0.0
        if knots is None or not len(knots.rows):
            at, time = (int(a[-1]) for a in state.tail) if len(state.tail[0]) else (int(arrival[0]), 0)
            ahead = ((arrival[rows] - at) * slope).astype(np.int64)
            return time + np.maximum(ahead, 0), np.full(len(rows), state.boot, dtype=np.int64)
        after = np.searchsorted(knots.rows, rows, side="right")
        left = np.maximum(after - 1, 0)
        right = np.minimum(after, len(knots.rows) - 1)
        boots = knots.boots_of(np.maximum(rows, knots.rows[0]))
        right = np.where(knots.boots_of(knots.rows[right]) == boots, right, left)
        start = arrival[knots.rows[left]]
        stop = arrival[knots.rows[right]]
        share = np.clip((arrival[rows] - start) / np.maximum(stop - start, 1), 0.0, 1.0)
        step = knots.time_ns[right] - knots.time_ns[left]
        beyond = ((arrival[rows] - start) * slope).astype(np.int64)
        beyond = np.where(after == 0, np.minimum(beyond, 0), np.maximum(beyond, 0))
        inside = (right > left) & (after > 0)
        time_ns = knots.time_ns[left] + np.where(inside, (share * step).astype(np.int64), beyond)
        return time_ns, boots


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
    return stream if not keep.any() else _pick(stream, keep)


def _pick(stream: Clocked, keep: BoolArray) -> Clocked:
    """The rows of a stream to keep; the stream itself where that is all of them."""
    return stream if keep.all() else replace(stream, rows=stream.rows[keep], time_ns=stream.time_ns[keep])


def _boots(state: _System, streams: list[Clocked]) -> list[int]:
    """Rows at which boots begin, the step from the last batch included."""
    falls: list[Fall] = []
    joined = []
    for stream in streams:
        last = state.last.get(stream.source)
        rows = stream.rows
        times = stream.time_ns
        if last is not None:
            rows = np.append(-1, rows)
            times = np.append(last, times)
        state.last[stream.source] = int(times[-1])
        joined.append((rows, times))
        falls += [
            Fall(int(rows[i - 1]), int(rows[i]), int(times[i - 1] - times[i]))
            for i in back_steps(times).tolist()
        ]
    if not falls:
        return []
    extents = [Extent(int(rows[0]), int(rows[-1]), usual_step(times)) for rows, times in joined]
    return split_points(falls, extents)
