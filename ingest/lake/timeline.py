"""Fields of a log over time, for pictures: values in units, gaps, and the events beside them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from flysid.dataset import FloatArray
from flysid.errors import RecipeError, UsageError
from flysid.facts.clock import log_clock
from flysid.flight import (
    BOOT,
    RECEIVED,
    TIME,
    ClockMap,
    as_instance,
    field_scale,
    field_unit,
    message_of,
    split_address,
    stem_of,
    why_several,
)
from flysid.flightwriter import float_values, int_values
from flysid.ingest.align.allowed import CHOOSE_AGAIN, Allowed
from flysid.ingest.align.recipe import Recipe
from flysid.ingest.align.resample import GAP_PERIODS, period_ns
from flysid.ingest.align.signals import Log, Samples, load_signal
from flysid.ingest.lake.events import events
from flysid.ingest.lake.ranges import is_number
from flysid.showing import first_of

_OWN = (TIME, BOOT, RECEIVED)
_ELEMENT = re.compile(r"^(.+)\[(\d+)\]$")
_COMMA = re.compile(r",(?![^\[]*\])")  # but inside brackets: FSB[1,0]


Boots = Mapping[int, Samples]
"""Boot number -> samples as recorded."""


@dataclass(frozen=True, eq=False)
class Trace:
    """One field over time.

    `name`: `STREAM.FIELD`, or the name of a recipe's signal.
    `unit`: as the log states it; "" where it does not.
    `time_s`: (N,) seconds since the log began; see `facts.clock`.
    `values`: (N,) in `unit`. A NaN stands inside every pause of the stream, and at the end of every boot.
    """

    name: str
    unit: str
    time_s: FloatArray
    values: FloatArray


@dataclass(frozen=True)
class Moment:
    """An event, in seconds since the timeline's start."""

    time_s: float
    kind: str
    text: str


@dataclass(frozen=True, eq=False)
class Timeline:
    """Panels of traces of one log on one axis of time. Boots follow one another: their clocks do not compare.

    `name`: the log.
    `panels`: traces that share an axis.
    `modes`: (start, end, name) of the flight modes, in seconds.
    `moments`: messages and parameter changes.
    `clock`: which clock the seconds are of, in words.
    """

    name: str
    panels: tuple[tuple[Trace, ...], ...]
    modes: tuple[tuple[float, float, str], ...]
    moments: tuple[Moment, ...]
    clock: str = ""


@dataclass(frozen=True, eq=False)
class Curve:
    """One field as recorded: what a trace is made of."""

    name: str
    unit: str
    boots: Boots


def read_fields(log: Log, arguments: Sequence[str], *, most_lines: int = 8) -> list[list[Curve]]:
    """One panel per argument; fields of another unit, or too many to tell apart, go to panels of their own.

    `arguments`: patterns as `find_fields` takes them, several of one panel joined by commas.
    `most_lines`: of one panel: as many as there are colours.
    Raises UsageError: as `find_fields`.
    """
    panels: list[list[Curve]] = []
    for argument in arguments:
        by_unit: dict[str, list[Curve]] = {}
        for stream, field in find_fields(log, _COMMA.split(argument)):
            curve = _read_field(log, stream, field)
            by_unit.setdefault(curve.unit, []).append(curve)
        for curves in by_unit.values():
            panels += [curves] if len(curves) <= most_lines else [[curve] for curve in curves]
    return panels


def read_channels(log: Log, recipe: Recipe) -> list[list[Curve]]:
    """The channels of a recipe that the log holds: command and answer, in one panel.

    Inputs and outputs of different units stand in panels of their own, one below the other. A panel whose
    curves are all drawn above, as the output of several channels is, is left out.
    """
    panels: list[list[Curve]] = []
    drawn: set[str] = set()
    for channel in recipe.channels:
        by_unit: dict[str, list[Curve]] = {}
        try:
            for name in recipe.signals_of(channel):
                spec = recipe.signals[name]
                curve = Curve(name, spec.unit, load_signal(name, spec, log).boots)
                by_unit.setdefault(spec.unit, []).append(curve)
        except RecipeError:
            continue  # this log lacks one of the channel's signals
        for panel in by_unit.values():
            names = {curve.name for curve in panel}
            if not names <= drawn:
                panels.append(panel)
            drawn |= names
    return panels


def find_fields(log: Log, patterns: Sequence[str]) -> list[tuple[str, str]]:
    """The (stream, field) pairs that patterns name, each once, in the order of the patterns.

    `patterns`: `STREAM.FIELD` with wildcards, e.g. `ATT.Des*`, `1.1/ATTITUDE.roll`, `vehicle_attitude.q[0]`.
        A stream is named by its key or its message name, and one of several things by `IMU[0]`; `STREAM`
        alone means all of its fields, `FIELD` alone that field of every stream, and an array all of its
        elements.
    Raises UsageError: a pattern names no numeric field of this log, or a message of several things; the hint
    has what is near.
    """
    found: dict[tuple[str, str], None] = {}
    for pattern in patterns:
        element = _ELEMENT.match(pattern)
        fields = _fields_named(log, pattern)
        if not fields and element:  # one element of an array
            fields = [f for f in _fields_named(log, element[1]) if f[1].endswith(f"[{element[2]}]")]
        if not fields:
            raise _nothing(pattern, log)
        found.update(dict.fromkeys(fields))
    return list(found)


def _fields_named(log: Log, pattern: str) -> list[tuple[str, str]]:
    """The (stream, field) pairs that a pattern names: in full, else without the thing where there is but one.

    Raises UsageError: the pattern names no thing, and its message is of several.
    """
    columns = _columns(log)
    hits = _hits(columns, pattern, message_of)
    hits = hits or _hits(columns, pattern, lambda stream: as_instance(stream, log.rows))
    if not hits:
        hits = _hits(columns, pattern, lambda stream: stem_of(message_of(stream)))
        for stem in dict.fromkeys(map(stem_of, hits)):
            things = [message_of(stream) for stream in hits if stem_of(stream) == stem]
            if len(things) > 1:
                field = pattern.rpartition(message_of(stem))[2]
                words, hint = why_several(pattern, [thing + field for thing in things])
                raise UsageError(words, path=log.name, hint=hint)
    return [(s, f) for s, columns in hits.items() for f in _numbers(log, s, columns)]


def _hits(
    columns: Sequence[tuple[str, str]], pattern: str, called: Callable[[str], str]
) -> dict[str, list[str]]:
    """Stream -> its columns that a pattern names, with streams by their keys or as they are `called`."""
    hits: dict[str, list[str]] = {}
    for stream, column in columns:
        name = called(stream)
        if any(
            _is_named(pattern, sender + name, f)
            for sender in ("", _sender(stream))
            for f in (column, _column(column))
        ):
            hits.setdefault(stream, []).append(column)
    return hits


def lay_out(log: Log, panels: Sequence[Sequence[Curve]], allowed: Allowed = Allowed()) -> Timeline:  # noqa: B008 - frozen
    """Curves on one axis of time, with the modes, messages and parameter changes of the log.

    Where `allowed` leaves out samples there is a gap; times are still those of the whole flight.
    Raises UsageError: nothing of the curves lies in it.
    """
    if allowed.never:
        raise UsageError(allowed.never[0], path=log.name, hint=CHOOSE_AGAIN)
    curves = [curve for panel in panels for curve in panel]
    axis = log_clock(log.clocks or _boots_of(curves))
    offsets = axis.offsets_s
    drawn = tuple(tuple(_trace(_kept(curve, allowed), offsets) for curve in panel) for panel in panels)
    if curves and not any(len(trace.time_s) for panel in drawn for trace in panel):
        ends = [
            s.t_ns[-1] * 1e-9 + offsets.get(b, 0.0) for c in curves for b, s in c.boots.items() if len(s.t_ns)
        ]
        raise UsageError(
            "no sample lies in the time asked for",
            path=log.name,
            hint=f"these fields were logged for {max(ends, default=0.0):.0f} s",
        )
    end_s = max((float(t.time_s[-1]) for panel in drawn for t in panel if len(t.time_s)), default=0.0)
    return Timeline(log.name, drawn, *happenings(log, offsets, end_s), axis.words)


def happenings(
    log: Log, offsets: Mapping[int, float], end_s: float
) -> tuple[tuple[tuple[float, float, str], ...], tuple[Moment, ...]]:
    """Flight modes as (start, end, name), and the other events, in seconds since the timeline's start.

    `offsets` has the seconds to add to the vehicle's time for every boot that counts.
    """
    seen = [(e.time_ns * 1e-9 + offsets[e.boot], e) for e in events(log) if e.boot in offsets]
    modes = [(max(0.0, at), e.text) for at, e in seen if e.kind == "mode"]
    bands = [(start, end, name) for (start, name), (end, _) in pairwise([*modes, (end_s, "")])]
    return (
        tuple(band for band in bands if band[0] < band[1]),
        tuple(Moment(at, e.kind, e.text) for at, e in seen if e.kind != "mode" and 0.0 <= at <= end_s),
    )


def _columns(log: Log) -> list[tuple[str, str]]:
    return [(s, c) for s, rows in log.rows.items() if rows for c in log.columns(s) if c not in _OWN]


def _numbers(log: Log, stream: str, columns: Sequence[str]) -> list[str]:
    """Those columns that can be drawn, arrays element by element; not the stream's own clock."""
    table = log.table(stream, columns)
    clock = (table.schema.metadata or {}).get(b"time_source", b"").decode()
    fields = []
    for column in table.schema:
        if len(columns) > 1 and column.name == clock:
            continue
        if is_number(column.type):
            fields.append(column.name)
        elif pa.types.is_fixed_size_list(column.type) and is_number(column.type.value_type):
            fields += [f"{column.name}[{i}]" for i in range(column.type.list_size)]
    return fields


def _sender(stream: str) -> str:
    """What stands before a stream's message: `1.1/`."""
    return stream[: len(stream) - len(message_of(stream))]


def _is_named(pattern: str, stream: str, field: str) -> bool:
    """Whether a pattern means a field; brackets stand for themselves, as things and elements have them."""
    return pattern in (stream, field) or fnmatchcase(f"{stream}.{field}", pattern.replace("[", "[[]"))


def _nothing(pattern: str, log: Log, *, most: int = 8) -> UsageError:
    """The error for a pattern that names nothing: the fields of its stream, else what is spelt alike.

    `most`: names in a hint.
    """
    fields = [(message_of(s), c) for s, c in _columns(log)]
    names = [f"{message}.{c}" for message, c in fields]
    streams = list(dict.fromkeys(message for message, _ in fields))
    asked = split_address(pattern)[0] or pattern
    inside = [f"{message}.{c}" for message, c in fields if asked in (message, stem_of(message))]
    near = inside or difflib.get_close_matches(pattern, [*names, *streams], n=5, cutoff=0.4)
    near = near or (names if len(names) <= most else streams)
    return UsageError(f"no numeric field {pattern!r} in the log", path=log.name, hint=first_of(near, most))


def _column(field: str) -> str:
    """The name without the number of an element."""
    match = _ELEMENT.match(field)
    return match[1] if match else field


def _read_field(log: Log, stream: str, field: str) -> Curve:
    """Samples of one field, in the unit that the log states; boots kept apart, each in order of time."""
    name = field if field in log.columns(stream) else _column(field)
    table = log.table(stream, [TIME, BOOT, name])
    column = table.schema.field(name)
    values = numbers_of(table[name].combine_chunks(), "" if name == field else field) * field_scale(column)
    boots = int_values(table[BOOT])
    times_ns = int_values(table[TIME])
    samples = {}
    for boot in np.unique(boots):
        inside = np.flatnonzero(boots == boot)
        order = inside[np.argsort(times_ns[inside], kind="stable")]
        samples[int(boot)] = Samples(times_ns[order], values[order])
    return Curve(f"{stream}.{field}", field_unit(column), samples)


def numbers_of(column: pa.Array, field: str) -> FloatArray:
    element = _ELEMENT.match(field)
    picked = pc.list_element(column, int(element[2])) if element else column
    return float_values(picked)


def _boots_of(curves: Sequence[Curve]) -> list[ClockMap]:
    """The boots of a log without clocks: from the first sample that is drawn to the last."""
    spans: dict[int, tuple[int, int]] = {}
    for curve in curves:
        for boot, samples in curve.boots.items():
            if len(samples.t_ns):
                first, last = spans.get(boot, (int(samples.t_ns[0]), int(samples.t_ns[-1])))
                spans[boot] = min(first, int(samples.t_ns[0])), max(last, int(samples.t_ns[-1]))
    return [ClockMap(boot, *span) for boot, span in sorted(spans.items())]


def _kept(curve: Curve, allowed: Allowed) -> Curve:
    """The samples that may be drawn."""
    boots = dict(curve.boots)
    for boot, spans in allowed.spans.items():
        if boot in boots:
            t_ns = boots[boot].t_ns
            inside = np.zeros(len(t_ns), dtype=bool)
            for start, end in spans:
                inside |= (t_ns >= start) & (t_ns < end)
            boots[boot] = Samples(t_ns[inside], boots[boot].x[inside])
    return replace(curve, boots=boots)


def _trace(curve: Curve, offsets: Mapping[int, float]) -> Trace:
    parts = [
        with_gaps(np.asarray(samples.t_ns * 1e-9 + offsets.get(boot, 0.0)), samples.x)
        for boot, samples in sorted(curve.boots.items())
        if len(samples.t_ns)
    ]
    if not parts:
        return Trace(curve.name, curve.unit, np.zeros(0), np.zeros(0))
    times, values = zip(*parts, strict=True)
    return Trace(curve.name, curve.unit, np.concatenate(times), np.concatenate(values))


def with_gaps(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A NaN inside every pause, and at the end, so that no line crosses either."""
    cuts = np.zeros(0, dtype=np.intp)
    if len(time_s) > 2:
        longest_s = 2.0 * GAP_PERIODS * period_ns(np.asarray(time_s * 1e9, dtype=np.int64)) * 1e-9
        cuts = np.flatnonzero(np.diff(time_s) > longest_s) + 1
    middles = (time_s[cuts - 1] + time_s[cuts]) / 2.0
    return (
        np.append(np.insert(time_s, cuts, middles), time_s[-1]),
        np.append(np.insert(values, cuts, np.nan), np.nan),
    )
