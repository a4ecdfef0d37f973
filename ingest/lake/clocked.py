"""A log on one clock: columns in one unit, when it was flown, its parameters.

Whoever judges a flight reads through here, so that all of them mean the same second, the same unit and the
same flight.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import RecipeError
from flysid.facts.clock import LogClock, log_clock
from flysid.facts.vehicle import firmware_of
from flysid.flight import Damage, split_address
from flysid.ingest.align.recipe import SignalSpec, Source
from flysid.ingest.align.signals import Loaded, Log, find_source, load_source
from flysid.ingest.align.things import find_stream, things_of
from flysid.ingest.align.transforms import TRANSFORMS
from flysid.ingest.lake.attitude_lost import failures
from flysid.ingest.lake.events import settings
from flysid.ingest.lake.failures import Mishap
from flysid.ingest.lake.flown import Flown, flown_of
from flysid.ingest.lake.headers import header_of

BoolArray = npt.NDArray[np.bool_]
CLOSED = 255
"""The blackbox's event at the end of a log (FLIGHT_LOG_EVENT_LOG_END)."""


MOST = {
    "": 1e9,
    "1": 1e6,
    "m/s/s": 5e3,
    "deg/s": 3e4,
    "rad/s": 5e2,
    "deg": 1e6,
    "rad": 1e4,
    "m": 1e6,
    "m/s": 1e3,
    "V": 1e3,
    "A": 5e3,
    "Ah": 1e3,
    "rpm": 5e5,
    "Gauss": 1e2,
}
"""Unit -> more than a vehicle can reach: a value beyond it is a firmware's word for none, as 4294967 m."""


@dataclass(frozen=True, eq=False)
class Column:
    """One field of a log over time, finite values only.

    `address`: `STREAM.FIELD`, where it was found.
    `unit`: of the values; "" for a number.
    `time_s`: (N,) on the log's clock, rising.
    `values`: (N,)
    """

    address: str
    unit: str
    time_s: FloatArray
    values: FloatArray

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def period_s(self) -> float:
        """From sample to sample, as most are; NaN of fewer than two."""
        return float(np.median(np.diff(self.time_s))) if len(self) > 1 else float("nan")

    @property
    def covered_s(self) -> float:
        """Time that the samples stand for; 0 of fewer than two."""
        return len(self) * self.period_s if len(self) > 1 else 0.0

    @property
    def rate_hz(self) -> float:
        """Samples a second, as most are; 0 of fewer than two."""
        return 1.0 / self.period_s if len(self) > 1 and self.period_s > 0.0 else 0.0

    def where(self, kept: BoolArray) -> Column:
        """Some of the samples."""
        return Column(self.address, self.unit, self.time_s[kept], self.values[kept])

    def at(self, time_s: FloatArray) -> FloatArray:
        """(n,) at other times, between samples by a straight line; NaN outside of them."""
        if not len(self):
            return np.full(len(time_s), np.nan)
        return np.interp(time_s, self.time_s, self.values, left=np.nan, right=np.nan)

    def held(self, time_s: FloatArray) -> FloatArray:
        """(n,) the last value at other times, as a setpoint or a state is in force; NaN before the first."""
        if not len(self):
            return np.full(len(time_s), np.nan)
        place = np.searchsorted(self.time_s, time_s, side="right") - 1
        return np.where(place >= 0, self.values[np.maximum(place, 0)], np.nan)

    def pieces(self, periods: float = 4.0) -> list[Column]:
        """Stretches without a pause longer than this many periods."""
        cuts = np.flatnonzero(np.diff(self.time_s) > periods * self.period_s) + 1
        edges = [0, *cuts.tolist(), len(self)]
        parts = [slice(a, b) for a, b in pairwise(edges) if b - a > 1]
        return [Column(self.address, self.unit, self.time_s[p], self.values[p]) for p in parts]


def join_spans(spans: Iterable[tuple[float, float]], pause_s: float = 2.0) -> tuple[tuple[float, float], ...]:
    """Spans in their order, those as one between which the pause is shorter.

    >>> join_spans([(0.0, 4.0), (5.0, 6.0), (8.5, 9.0)])
    ((0.0, 6.0), (8.5, 9.0))
    """
    joined: list[tuple[float, float]] = []
    for first, last in spans:
        if joined and first - joined[-1][1] < pause_s:
            first = joined.pop()[0]
        joined.append((first, last))
    return tuple(joined)


@dataclass(frozen=True, eq=False)
class ClockedLog:
    """A log on its one clock.

    `log`: as alignment reads it.
    `damage`: what could not be read of it, and what was lost before it was written.
    `file`: name of the log, where it is not the flight's id.
    `read`: every column that was read, by its address: what a page shows as evidence.
    `stamps`: times of every stream as they were last read: its columns share them.
    `crashed_s`: when it crashed by its sensors, on the log's clock: see `crash.end_at_crash`.

    >>> import flysid
    >>> from flysid.ingest.align.signals import FlightLog
    >>> flight = ClockedLog(FlightLog(flysid.read("sample_logs/01-multisine-seed1.tlog")))
    >>> flight.family, round(flight.column("ATTITUDE.roll", unit="deg").rate_hz)
    ('ardupilot', 50)
    """

    log: Log
    damage: Damage = Damage()  # noqa: RUF009 - frozen
    file: str = ""
    read: dict[str, Column] = field(default_factory=dict)
    stamps: dict[str, FloatArray] = field(default_factory=dict)
    crashed_s: float = float("inf")

    @property
    def name(self) -> str:
        """Of the log."""
        return self.file or self.log.name

    @property
    def info(self) -> Mapping[str, str]:
        """Facts about the vehicle."""
        return self.log.info

    @cached_property
    def family(self) -> str:
        """Firmware: "ardupilot", "px4", "betaflight", "inav", "crazyflie"; "" where the log does not say."""
        return firmware_of(self.info)

    @cached_property
    def clock(self) -> LogClock:
        """The one axis of time of this log."""
        return log_clock(self.log.clocks)

    @cached_property
    def duration_s(self) -> float:
        """From the log's beginning to its end, boots behind one another."""
        return 1e-9 * sum(c.last_ns - c.first_ns for c in self.log.clocks)

    @cached_property
    def flown(self) -> Flown:
        """When it was in the air, as far as the log states it."""
        return flown_of(self.log)

    @cached_property
    def failures(self) -> tuple[Mishap, ...]:
        """All that went wrong by the log's own words and by its attitude."""
        return tuple(failures(self.log))

    @cached_property
    def ends_s(self) -> float:
        """When the flight ended badly, on the log's clock: what follows says nothing of how it flies."""
        final = [self.clock.seconds(m.boot, m.span[0]) for m in self.failures if m.ends]
        return min([*final, self.crashed_s])

    @cached_property
    def air_s(self) -> tuple[tuple[float, float], ...]:
        """Spans in the air on the log's clock; the whole log where it does not state any.

        A pause below two seconds is a bounce, or the seam of two recordings in one file: it is one flight.
        """
        if self.flown.spans is None:
            return ((0.0, self.duration_s),)
        return join_spans(
            (self.clock.seconds(boot, first), self.clock.seconds(boot, last))
            for boot, spans in sorted(self.flown.spans.items())
            for first, last in spans
        )

    @property
    def was_flown(self) -> bool:
        """Whether any of it was, or may have been, in the air."""
        return any(last > first for first, last in self.air_s)

    @cached_property
    def flight_s(self) -> float:
        """Seconds in the air before the flight ended badly; of all the log where it does not state them."""
        return sum(max(0.0, min(last, self.ends_s) - first) for first, last in self.air_s)

    def flying(self, time_s: FloatArray) -> BoolArray:
        """(n,) whether times on the log's clock lie in the air and before the flight ended badly."""
        inside = np.zeros(len(time_s), dtype=bool)
        for first, last in self.air_s:
            inside |= (time_s >= first) & (time_s <= last)
        return inside & (time_s < self.ends_s)

    @cached_property
    def parameters(self) -> Mapping[str, float]:
        """Parameters by name, as they were first in force; a header's settings that are numbers, too."""
        found: dict[str, float] = {}
        for stated in settings(self.log):
            if isinstance(stated.value, (int, float)):
                found.setdefault(stated.name, float(stated.value))
        return found

    @cached_property
    def whole_parameters(self) -> frozenset[str]:
        """Names of the parameters that the log types as whole numbers."""
        stream = self.stream("parameters")
        if not stream or "type" not in self.log.columns(stream):
            return frozenset()
        table = self.log.table(stream, ["name", "type"]).to_pydict()
        pairs = zip(table["name"], table["type"], strict=True)
        return frozenset(name for name, kind in pairs if "int" in str(kind))

    @cached_property
    def headers(self) -> Mapping[str, str]:
        """Settings of a blackbox header as text, by name; empty in other logs."""
        return header_of(self.log)

    @cached_property
    def is_closed(self) -> bool:
        """Whether a blackbox ends with the word of its firmware that it ends."""
        stream = self.stream("events")
        return bool(stream) and CLOSED in self.log.table(stream, ["event"])["event"].to_pylist()

    def has(self, message: str) -> bool:
        """Whether the log holds rows of a message, of one thing or several."""
        return bool(things_of(message, self.log.rows))

    def things(self, message: str) -> list[str]:
        """The streams of a message: `IMU[0]` and `IMU[1]` where it is of two things."""
        return things_of(message, self.log.rows)

    def column(self, *addresses: str, unit: str = "", stated: str = "") -> Column | None:
        """The first of several fields that the log holds; None where it holds none of them, or no value.

        `addresses`: `STREAM.FIELD`, an element of an array by `FIELD[i]`.
        `unit`: wanted; "" takes the values as the log scales them.
        `stated`: the unit where the log itself states none.
        Raises RecipeError: the field's unit is of another kind than the one that is wanted.
        """
        for address in addresses:
            stream, name = split_address(address)
            found = find_source((Source(stream, (name,), unit=stated),), self.log)
            if found is None:
                continue
            loaded = load_source(*found, unit, self.log, resolved=False)
            column = self._on_clock(loaded, f"{found[1]}.{name}", unit)
            if len(column):
                return column
        return None

    def quantity(self, *addresses: str, unit: str = "", stated: str = "") -> Column | None:
        """As `column`, but a field whose unit cannot be converted counts as absent."""
        try:
            return self.column(*addresses, unit=unit, stated=stated)
        except RecipeError:
            return None

    def signal(self, spec: SignalSpec) -> Column | None:
        """A signal of a recipe, from the first of its sources that has values; None where none has."""
        for source in spec.sources:
            found = find_source((source,), self.log)
            if found is None:
                continue
            try:
                loaded = load_source(*found, spec.unit, self.log, resolved=False)
            except RecipeError:
                continue  # a unit of another kind: the next source may fit
            of_turns = TRANSFORMS[source.transform].field_counts == (1, 4)
            name = source.transform if of_turns else "/".join(source.fields)
            column = self._on_clock(loaded, f"{found[1]}.{name}", spec.unit)
            if len(column):
                return column
        return None

    def _on_clock(self, loaded: Loaded, address: str, unit: str) -> Column:
        times: list[FloatArray] = [np.zeros(0)]
        values: list[FloatArray] = [np.zeros(0)]
        for boot, samples in sorted(loaded.boots.items()):
            finite = np.abs(samples.x) <= MOST.get(unit, MOST[""])  # which no NaN is
            start = self.clock.starts_s.get(boot, 0.0)
            begin = self.clock.begins_ns.get(boot, 0)
            times.append(np.asarray(start + (samples.t_ns[finite] - begin) * 1e-9, dtype=np.float64))
            values.append(samples.x[finite])
        stamps = np.concatenate(times)
        before = self.stamps.get(loaded.stream)
        if before is not None and np.array_equal(before, stamps):
            stamps = before
        self.stamps[loaded.stream] = stamps
        column = Column(address, unit, stamps, np.concatenate(values))
        self.read[address] = column
        return column

    def forget(self) -> None:
        """Keep no column that was read: whoever holds many logs has no room for all of theirs."""
        self.read.clear()
        self.stamps.clear()

    def stream(self, message: str) -> str:
        """The key of the one stream of a message; "" where there is none, or several things."""
        return find_stream(message, self.log.rows) or ""
