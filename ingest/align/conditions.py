"""Where the conditions of a recipe hold: armed, airborne, in a mode; as spans of vehicle time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flysid.errors import RecipeError
from flysid.flight import BOOT, TIME
from flysid.flightwriter import int_values
from flysid.ingest.align import resample
from flysid.ingest.align.allowed import Allowed
from flysid.ingest.align.recipe import Condition
from flysid.ingest.align.resample import Span
from flysid.ingest.align.signals import Log, find_source, load_source
from flysid.ingest.align.values import MOST_VALUES, base_column, is_one_of, names_of, single_values, texts_of

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]
ALWAYS = -resample.FOREVER


def condition_spans(conditions: Sequence[Condition], log: Log) -> Allowed:
    """Where all conditions hold in a log. A value counts until the next one (zero-order hold).

    Raises RecipeError: a required condition has no source in the log.
    """
    spans: dict[int, Sequence[Span]] = {}
    notes: list[str] = []
    never: list[str] = []
    for name in dict.fromkeys(c.name for c in conditions):
        alternatives = [c for c in conditions if c.name == name]
        condition = next((c for c in alternatives if find_source(c.sources, log) is not None), None)
        if condition is None:
            wanted = list(dict.fromkeys(s.stream for c in alternatives for s in c.sources))
            if any(c.required for c in alternatives):
                raise RecipeError(f"condition {name!r} needs {', '.join(wanted)}", path=log.name)
            notes.append(f"condition {name!r} could not be checked: no {' or '.join(wanted)} in the log")
            continue
        found, seen = _spans(condition, log)
        for boot, own in found.items():
            spans[boot] = resample.intersect(spans[boot], own) if boot in spans else own
        if not any(found.values()):
            never.append(f"condition {name!r} {_how_short(condition, log) or f'never holds{seen}'}")
    return Allowed(spans, tuple(notes), tuple(never))


def _how_short(condition: Condition, log: Log) -> str:
    """That a condition holds, but only for less than its margins; "" where it never does."""
    if not any(_spans(replace(condition, margin_s=0.0), log)[0].values()):
        return ""
    return f"never holds for longer than its margins, 2 x {condition.margin_s:g} s"


def _spans(condition: Condition, log: Log) -> tuple[dict[int, list[Span]], str]:
    """Spans per boot in which one condition holds, and what the log has, for the case that there are none."""
    found = find_source(condition.sources, log)
    assert found is not None
    source, stream = found
    margin_ns = round(condition.margin_s * 1e9)
    if condition.above is not None or condition.below is not None:
        loaded = load_source(source, stream, condition.unit, log)
        series = {b: resample.tidy(s.t_ns, s.x) for b, s in loaded.boots.items()}
        spans = {
            b: spans_true(*condition_truths(condition, s.t_ns, s.x, {}), margin_ns) for b, s in series.items()
        }
        ranges = [x for s in series.values() if len(s.x) for x in (s.x.min(), s.x.max())]
        seen = f"{min(ranges):.3g} to {max(ranges):.3g} {condition.unit}".rstrip() if ranges else "empty"
        return spans, f": {stream}.{loaded.field} is {seen}"
    column = source.fields[0]
    table = log.table(stream, [TIME, BOOT, base_column(column, log.columns(stream))])
    values = single_values(table, column, f"condition {condition.name!r}")
    names = names_of(table, stream, column, log.info)
    boots = int_values(table[BOOT])
    t_ns = int_values(table[TIME])
    spans = {}
    for boot in np.unique(boots).tolist():
        rows = np.flatnonzero(boots == boot)
        rows = rows[np.argsort(t_ns[rows], kind="stable")]
        spans[int(boot)] = _held(condition, t_ns[rows], values[rows], names)
    texts = list(dict.fromkeys(texts_of(values, names)))
    listed = ", ".join(texts[:MOST_VALUES]) + (", ..." if len(texts) > MOST_VALUES else "")
    return spans, f"{_describe_wanted(condition)}: {stream}.{column} is {listed} in this log"


def _held(
    condition: Condition, t_ns: IntArray, values: npt.NDArray[np.generic], names: Mapping[str, str]
) -> list[Span]:
    """Spans of one boot in which a condition on values or events holds."""
    margin_ns = round(condition.margin_s * 1e9)
    times, holds = condition_truths(condition, t_ns, values, names)
    if not (condition.set_by or condition.cleared_by):
        return spans_true(times, holds, margin_ns)
    if len(times) == 0:  # nothing is known: nothing is cut
        return [(ALWAYS, resample.FOREVER)]
    return spans_true(np.append(ALWAYS, times), np.append(~holds[0], holds), margin_ns)


def condition_truths(
    condition: Condition, t_ns: IntArray, values: npt.NDArray[np.generic], names: Mapping[str, str]
) -> tuple[IntArray, BoolArray]:
    """Times at which the log states whether a condition holds, and the statement; only of such events."""
    if condition.above is not None or condition.below is not None:
        return t_ns, _in_bounds(values.astype(np.float64), condition)
    if not (condition.set_by or condition.cleared_by):
        return t_ns, _is_wanted(values, condition, names)
    begins = is_one_of(values, condition.set_by, names)
    told = begins | is_one_of(values, condition.cleared_by, names)
    return t_ns[told], begins[told]


def _in_bounds(x: npt.NDArray[np.float64], condition: Condition) -> BoolArray:
    low = -np.inf if condition.above is None else condition.above
    high = np.inf if condition.below is None else condition.below
    return np.asarray((x > low) & (x < high))


def _is_wanted(values: npt.NDArray[np.generic], condition: Condition, names: Mapping[str, str]) -> BoolArray:
    if condition.has_bits:
        bits = values.astype(np.int64) & condition.has_bits
        return np.asarray(bits == condition.has_bits)
    return is_one_of(values, condition.any_of, names)


def _describe_wanted(condition: Condition) -> str:
    """The request, in words."""
    if condition.has_bits:
        return f" (bits {condition.has_bits})"
    return f" ({', '.join(str(v) for v in condition.any_of or condition.set_by)})"


def spans_true(t_ns: IntArray, holds: BoolArray, margin_ns: int) -> list[Span]:
    """Spans in which a held truth value is true; the last value counts for ever."""
    if len(t_ns) == 0:
        return []
    edges = np.flatnonzero(np.diff(holds.astype(np.int8)))
    starts = [0, *(int(e) + 1 for e in edges)]
    stops = [*(int(t_ns[e + 1]) for e in edges), resample.FOREVER]
    spans = [
        (int(t_ns[a]) + margin_ns, stop - margin_ns)
        for a, stop in zip(starts, stops, strict=True)
        if holds[a]
    ]
    return [span for span in spans if span[0] < span[1]]
