"""A recipe's source in a log -> times and values of one signal, in the unit the recipe wants.

Streams are resolved per vehicle: of several senders of one message, the autopilot (component 1 of the system
that logs most) is taken. Of several things of one message, as gyros are, none is: `IMU[0]` names one, and so
does `where = { I = 0 }`. Units come from the log's own metadata; where it states none, the recipe must.
"""

from __future__ import annotations

import difflib
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.errors import RecipeError
from flysid.flight import (
    BOOT,
    ROW_NUMBER,
    TIME,
    ClockMap,
    Flight,
    field_scale,
    field_unit,
    message_of,
    thing_of,
    why_several,
)
from flysid.flightwriter import int_values
from flysid.ingest.align.allowed import Allowed
from flysid.ingest.align.recipe import Recipe, SignalSpec, Source
from flysid.ingest.align.things import things_of, things_where
from flysid.ingest.align.transforms import TRANSFORMS
from flysid.ingest.align.values import (
    MOST_VALUES,
    Value,
    base_column,
    column_values,
    is_one_of,
    names_of,
    single_values,
    texts_of,
)
from flysid.ingest.formats.common.arrow_arrays import numeric
from flysid.ingest.formats.common.units import factor, is_known
from flysid.ingest.formats.keyed import key_fields
from flysid.sharing import Itself, once
from flysid.showing import one_of
from flysid.stretch import FloatArray

IntArray = npt.NDArray[np.int64]


class Log(Protocol):
    """What alignment needs of a flight, in memory or stored."""

    @property
    def name(self) -> str:
        """Identifies the flight."""
        ...

    @property
    def rows(self) -> Mapping[str, int]:
        """Number of rows of every stream, by key."""
        ...

    @property
    def info(self) -> Mapping[str, str]:
        """Facts about the vehicle."""
        ...

    @property
    def clocks(self) -> Sequence[ClockMap]:
        """One for every boot, in order; empty where nobody knows them."""
        ...

    @property
    def allowed(self) -> Allowed | None:
        """Where it may be used; None: everywhere."""
        ...

    def columns(self, stream: str) -> Sequence[str]:
        """Names of a stream's columns."""
        ...

    def keys(self, stream: str) -> Sequence[str]:
        """The fields that tell to which of several things a stream's rows belong; none where it has none."""
        ...

    def table(self, stream: str, columns: Sequence[str]) -> pa.Table:
        """Some columns of a stream; `stream` is a key."""
        ...


@dataclass(frozen=True)
class FlightLog:
    """A Flight in memory as a Log. `id` replaces the source's file name where it is given."""

    flight: Flight
    id: str = ""

    @property
    def name(self) -> str:
        return self.id or self.flight.source.name

    @property
    def rows(self) -> Mapping[str, int]:
        return {key: table.num_rows for key, table in self.flight.tables.items()}

    @property
    def info(self) -> Mapping[str, str]:
        return self.flight.info

    @property
    def clocks(self) -> Sequence[ClockMap]:
        return self.flight.clocks

    @property
    def allowed(self) -> None:
        return None

    def columns(self, stream: str) -> Sequence[str]:
        return list(self.flight.tables[stream].column_names)

    def keys(self, stream: str) -> Sequence[str]:
        return key_fields(self.flight.tables[stream].schema)

    def table(self, stream: str, columns: Sequence[str]) -> pa.Table:
        return self.flight.tables[stream].select(list(columns))


@dataclass(frozen=True, eq=False)
class Samples:
    """Values of one signal in one boot, as recorded: (N,) times in ns and (N,) values."""

    t_ns: IntArray
    x: FloatArray


@dataclass(frozen=True, eq=False)
class Loaded:
    """A signal of one flight.

    `boots`: boot number -> samples.
    `stream`, `field`: where it was found.
    `resolution`: smallest difference the source shows, in the signal's unit; 0 where it is not quantised.
    `notes`: what a user should know, e.g. that a unit is not the log's own.
    """

    boots: Mapping[int, Samples]
    stream: str
    field: str
    resolution: float = 0.0
    notes: tuple[str, ...] = ()


# ------------------------------------------------------------------------------------------- sources


def find_source(spec: Sequence[Source], log: Log) -> tuple[Source, str] | None:
    """The first of the alternatives that the log holds, and the key of its stream."""
    for source in spec:
        stream = _stream_of(source, log)
        if stream is None or not _has_fields(source, log.columns(stream)):
            continue
        if source.yaw is not None and find_source((source.yaw,), log) is None:
            continue
        return source, stream
    return None


def _stream_of(source: Source, log: Log) -> str | None:
    """The stream that a source means; None where there is none, or several and `where` does not say which."""
    things = things_of(source.stream, log.rows)
    keys = log.keys(things[0]) if things and source.where else ()
    wanted = {key: source.where[key] for key in keys if key in source.where}
    if wanted:
        named = [key for key, value in wanted.items() if isinstance(value, str)]
        table = log.table(things[0], named) if named else None
        names = {key: names_of(table, things[0], key, log.info) for key in named}
        things = things_where(wanted, things, keys, names)
    return things[0] if len(things) == 1 else None


def serves(log: Log, recipe: Recipe, channel: str) -> bool:
    """Whether a log holds a source of every signal of a channel."""
    return all(find_source(recipe.signals[s].sources, log) is not None for s in recipe.signals_of(channel))


def missing(signal: str, spec: Sequence[Source], logs: Sequence[Log]) -> RecipeError:
    """The error that says which sources no log holds, and what is near."""
    wanted = ", ".join(
        f"{s.stream}.{'/'.join([*s.fields, *s.where, *([s.time] if s.time else [])])}" for s in spec
    )
    streams = sorted({key for log in logs for key in log.rows})
    names = sorted({*streams, *map(message_of, streams)})
    near = [n for s in spec for n in difflib.get_close_matches(s.stream, names, n=2, cutoff=0.5)]
    flights = ", ".join(log.name for log in logs[:3]) + (", ..." if len(logs) > 3 else "")
    there = next((found for s in spec for log in logs if (found := _there(s, log))), ("", ""))
    hint = there[1] or ", ".join(dict.fromkeys(near)) or "streams logged: " + ", ".join(streams[:8])
    lacking = f"{there[0]}, in {flights}" if there[0] else f"not in {flights}"
    return RecipeError(f"signal {signal!r} needs {wanted}; {lacking}", hint=hint)


def _there(source: Source, log: Log) -> tuple[str, str]:
    """Of a source whose stream a log has and cannot use: what is wrong, "" for "not", and what to name."""
    things = things_of(source.stream, log.rows)
    if not things:
        return "", ""
    wanted = [*source.fields, *source.where, *([source.time] if source.time else [])]
    columns = [name for name in log.columns(things[0]) if name not in (TIME, BOOT)]
    lacking = next((name for name in wanted if not base_column(name, set(columns))), "")
    if lacking:
        return "", f"{things[0]} has no field {lacking!r}: {one_of(columns, lacking)}"
    if len(things) == 1:
        return "", f"{things[0]} is there" if thing_of(things[0]) else ""
    return why_several(source.stream, [message_of(key) for key in things])


def _has_fields(source: Source, columns: Sequence[str]) -> bool:
    names = set(columns)
    needed = [*source.fields, *source.where, *([source.time] if source.time else [])]
    return all(base_column(name, names) for name in needed)


# ------------------------------------------------------------------------------------------- values


def load_signal(name: str, spec: SignalSpec, log: Log) -> Loaded:
    """All samples of a signal in one log.

    Raises RecipeError: no source is in the log; a unit is missing, unknown or of another kind.
    """
    found = find_source(spec.sources, log)
    if found is None:
        raise missing(name, spec.sources, [log])
    try:
        return load_source(found[0], found[1], spec.unit, log)
    except RecipeError as error:
        raise RecipeError(f"signal {name!r}: {error.message}", path=log.name, hint=error.hint) from error


def _ask(source: Source, stream: str, unit: str, log: Log, *, resolved: bool = True) -> Hashable:
    return repr(source), stream, unit, Itself(log), resolved


@once(_ask)
def load_source(source: Source, stream: str, unit: str, log: Log, *, resolved: bool = True) -> Loaded:
    """The samples of one source, converted to `unit`, sign and scale applied; boots kept apart.

    `resolved`: its resolution is found too, which takes as long as all the rest.
    """
    rows = _read(source, stream, log)
    for column, wanted in source.where.items():
        rows, logged = _rows_where(column, wanted, rows, stream, log.info)
        if rows.num_rows == 0:
            told = f"no row of {stream} has {column} = {wanted}: {column} is {logged}"
            return Loaded({}, stream, "/".join(source.fields), notes=(told,))
    table = _in_order(source, _rows_timed(source, rows))
    boots = int_values(table[BOOT])
    t_ns = _times(source, table) - round(source.lag_s * 1e9)
    columns = _matrix(source, table)
    transform = TRANSFORMS[source.transform]
    gain, notes = gain_of(source, stream, unit, table)
    if untimed := rows.num_rows - table.num_rows:
        notes += (f"{stream}: rows without a {source.time}, left out: {untimed:,}",)
    yaw = _yaw_at(source.yaw, log, boots, t_ns) if source.yaw is not None else np.empty(0)
    values = np.empty(len(t_ns))
    runs = np.flatnonzero(np.diff(boots, prepend=boots[:1] - 1))  # millions of rows are of few boots
    of_boot = {int(boot): boots == boot for boot in np.unique(boots[runs])}
    for rows in of_boot.values():
        seconds = (t_ns[rows] - t_ns[rows][0]) * 1e-9
        values[rows] = gain * transform.apply(columns[rows], seconds, yaw[rows] if len(yaw) else yaw)
        if transform.wraps:
            values[rows] = np.unwrap(values[rows], period=2 * np.pi * factor("rad", unit))
    values = source.scale * values + source.offset
    return Loaded(
        boots={boot: Samples(t_ns[rows], values[rows]) for boot, rows in of_boot.items()},
        stream=stream,
        field="/".join(source.fields),
        resolution=_resolution(source, columns, values, gain) if resolved else 0.0,
        notes=notes,
    )


def _resolution(source: Source, columns: FloatArray, values: FloatArray, gain: float) -> float:
    elementwise = TRANSFORMS[source.transform].elementwise
    return quantum(values) if elementwise else _column_quantum(columns, gain * source.scale)


def quantum(values: FloatArray) -> float:
    """The step of a quantised signal: its smallest difference, if all others are multiples of it; else 0.

    Steps below a millionth of the range are the number format's, not the sensor's.
    """
    levels = np.unique(values[np.isfinite(values)])
    if len(levels) < 3:
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-7 * (levels[-1] - levels[0])]
    if len(steps) < 2 or (step := float(steps.min())) < 1e-6 * (levels[-1] - levels[0]):
        return 0.0
    multiples = steps / step
    off = np.abs(multiples - np.round(multiples))
    return float(np.median(steps / np.round(multiples))) if np.mean(off < 0.05) > 0.98 else 0.0


def _column_quantum(columns: FloatArray, gain: float) -> float:
    """Quantisation that a sum or rotation of columns inherits; 0 for quaternions and the like."""
    return abs(gain) * max((quantum(c) for c in columns.T[:2]), default=0.0) if columns.shape[1] == 2 else 0.0


def _read(source: Source, stream: str, log: Log) -> pa.Table:
    known = set(log.columns(stream))
    wanted = [*source.fields, *source.where, *([source.time] if source.time else [])]
    columns = dict.fromkeys(base_column(name, known) for name in wanted)
    return log.table(stream, [*dict.fromkeys([TIME, BOOT, *columns])])


def _rows_where(
    name: str, wanted: Value, table: pa.Table, stream: str, info: Mapping[str, str]
) -> tuple[pa.Table, str]:
    """The rows whose column has a value, which may be the name of a number; and what there is instead."""
    values = single_values(table, name, "'where'")
    names = names_of(table, stream, name, info)
    there = list(dict.fromkeys(texts_of(values, names)))
    listed = ", ".join(there[:MOST_VALUES]) + (", ..." if len(there) > MOST_VALUES else "")
    return table.filter(numeric(is_one_of(values, [wanted], names))), listed or "never logged"


def _matrix(source: Source, table: pa.Table) -> FloatArray:
    """(N, k) columns of a source as physical values."""
    parts = []
    for name in source.fields:
        values = column_values(table, name)
        if values.dtype.kind not in "fiub":
            raise RecipeError(
                f"{source.stream}.{name} does not hold numbers", hint="choose a field of numbers"
            )
        columns = values.astype(np.float64) * field_scale(schema_of(table, name))
        parts.append(columns if columns.ndim > 1 else columns[:, None])
    matrix = np.concatenate(parts, axis=1)
    counts = TRANSFORMS[source.transform].field_counts
    if matrix.shape[1] not in counts or (counts == (1, 4) and matrix.shape[1] != 4):
        raise RecipeError(
            f"{source.stream}.{'/'.join(source.fields)} gives {matrix.shape[1]} columns; "
            f"transform {source.transform!r} takes {counts[-1]}",
            hint="name one element, e.g. q[0]",
        )
    return matrix


def schema_of(table: pa.Table, name: str) -> pa.Field:
    """The column that holds `name`, which may be an element of a list."""
    return table.schema.field(base_column(name, table.column_names))


def gain_of(source: Source, stream: str, unit: str, table: pa.Table) -> tuple[float, tuple[str, ...]]:
    """Factor from the transform's result to `unit`, and notes about whose word the unit is."""
    transform = TRANSFORMS[source.transform]
    if transform.unit is not None:
        return factor(transform.unit, unit), ()
    stated = field_unit(schema_of(table, source.fields[0]))
    place = f"{stream}.{source.fields[0]}"
    notes: tuple[str, ...] = ()
    if stated and not is_known(stated):
        notes = (f"{place}: unit {stated!r} of the log is not known, taken as {source.unit or 'a number'}",)
        stated = ""
    elif stated and source.unit and factor(stated, source.unit) != 1.0:
        notes = (f"{place}: the log says {stated}, the recipe {source.unit}; the log's unit is used",)
    actual = stated or source.unit
    if not actual and unit not in ("", "1"):
        raise RecipeError(
            f"{place} has no unit in the log", hint='state it in the recipe, e.g. unit = "deg" in its source'
        )
    rate = "/s" if transform.per_second else ""
    return factor(actual + rate if actual else "", unit), notes


def _rows_timed(source: Source, table: pa.Table) -> pa.Table:
    """The rows that the source's own time column gives a time."""
    if not source.time:
        return table
    told = np.isfinite(_stated_times(source, table))
    return table if told.all() else table.filter(numeric(told))


def _in_order(source: Source, table: pa.Table) -> pa.Table:
    """Rows by boot and time; rows of equal time keep their order."""
    boots = int_values(table[BOOT])
    times = _times(source, table)
    order = np.lexsort((times, boots))
    return table if (np.diff(order) == 1).all() else table.take(numeric(order))


def _times(source: Source, table: pa.Table) -> IntArray:
    """(N,) ns: the stream's own time, or that of a column with a time unit (us where none is stated)."""
    if not source.time:
        return _by_rows(source, table)
    unit = field_unit(schema_of(table, source.time)) or "us"
    return np.round(_stated_times(source, table) * factor(unit, "ns")).astype(np.int64)


def _stated_times(source: Source, table: pa.Table) -> FloatArray:
    """(N,) what the source's own time column says, NaN where it says nothing."""
    values = single_values(table, source.time, "'time'")
    if values.dtype.kind not in "fiu":
        raise RecipeError(f"{source.stream}.{source.time} does not hold numbers and so cannot be the times")
    return values.astype(np.float64)


def _by_rows(source: Source, table: pa.Table) -> IntArray:
    """(N,) ns: the stream's own time; for a table without one, its rows at the recipe's period."""
    times = int_values(table[TIME])
    numbered = (table.schema.metadata or {}).get(b"time_source") == ROW_NUMBER.encode()
    if numbered and source.row_period_s is None:
        raise RecipeError(
            "the table has no column that can be its time",
            hint="--dt SECONDS, or row_period_s in the recipe; a time rises from row to row",
        )
    if not numbered and source.row_period_s is not None:
        raise RecipeError("the log tells the time", hint="leave out --dt, or row_period_s in the recipe")
    return times if source.row_period_s is None else np.round(times * source.row_period_s).astype(np.int64)


def _yaw_at(source: Source, log: Log, boots: IntArray, t_ns: IntArray) -> FloatArray:
    """(N,) heading at the given times, rad: unwrapped, interpolated, NaN where it is not known."""
    found = find_source((source,), log)
    assert found is not None  # find_source checked it with the source it serves
    loaded = load_source(found[0], found[1], "rad", log)
    heading = np.full(len(t_ns), np.nan)
    for boot, samples in loaded.boots.items():
        rows = boots == boot
        heading[rows] = _interpolated_angle(samples, t_ns[rows])
    return heading


def _interpolated_angle(samples: Samples, t_ns: IntArray) -> FloatArray:
    """(N,) an angle at other times; NaN outside its samples and inside pauses."""
    finite = np.isfinite(samples.x)
    own = samples.t_ns[finite]
    if len(own) < 2:
        return np.full(len(t_ns), np.nan)
    period = float(np.median(np.diff(own)))
    slack = period  # a heading older than one period still serves at the ends
    outside = (t_ns < own[0] - slack) | (t_ns > own[-1] + slack)
    return np.where(outside, np.nan, angle_between(own, np.unwrap(samples.x[finite]), t_ns, period))


def angle_between(
    own_ns: IntArray, x: FloatArray, t_ns: IntArray, period_ns: float, *, periods: int = 4
) -> FloatArray:
    """(n,) an angle between its samples (m,) without jumps, m >= 2; NaN inside pauses.

    `periods`: a heading is not interpolated across a longer pause.
    """
    values = np.interp((t_ns - own_ns[0]).astype(float), (own_ns - own_ns[0]).astype(float), x)
    after = np.clip(np.searchsorted(own_ns, t_ns), 1, len(own_ns) - 1)
    before = own_ns[after - 1]
    is_sample = (own_ns[after] == t_ns) | (before == t_ns)
    paused = (own_ns[after] - before > periods * period_ns) & ~is_sample
    return np.where(paused, np.nan, values)
