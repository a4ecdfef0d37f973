"""Where the conditions of a recipe hold: armed, airborne, in a mode; as spans of vehicle time."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from flysid.errors import RecipeError
from flysid.flight import BOOT, TIME
from flysid.ingest import resample
from flysid.ingest.recipe import Condition
from flysid.ingest.resample import Span
from flysid.ingest.signals import Log, column_values, find_source, load_source

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Allowed:
    """Spans per boot in which all conditions hold; a boot that is not named is not restricted."""

    spans: Mapping[int, Sequence[Span]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def condition_spans(conditions: Sequence[Condition], log: Log) -> Allowed:
    """Where all conditions hold in a log. A value counts until the next one (zero-order hold).

    Raises
    ------
    RecipeError : a required condition has no source in the log.
    """
    spans: dict[int, Sequence[Span]] = {}
    notes: list[str] = []
    for condition in conditions:
        found = find_source(condition.sources, log)
        if found is None:
            if condition.required:
                wanted = ", ".join(s.stream for s in condition.sources)
                raise RecipeError(f"condition {condition.name!r} needs {wanted}", path=log.name)
            notes.append(f"condition {condition.name!r} could not be checked: no source")
            continue
        times, holds = _evaluate(condition, log)
        for boot, t_ns in times.items():
            own = _spans_true(t_ns, holds[boot], round(condition.margin_s * 1e9))
            spans[boot] = resample.intersect(spans[boot], own) if boot in spans else own
        if not any(h.any() for h in holds.values()):
            notes.append(f"condition {condition.name!r} never holds")
    return Allowed(spans, tuple(notes))


def _evaluate(
    condition: Condition, log: Log
) -> tuple[dict[int, npt.NDArray[np.int64]], dict[int, BoolArray]]:
    found = find_source(condition.sources, log)
    assert found is not None
    source, stream = found
    if not condition.any_of and not condition.has_bits:
        loaded = load_source(source, stream, condition.unit, log)
        series = {b: resample.tidy(s.t_ns, s.x) for b, s in loaded.boots.items()}
        return (
            {b: s.t_ns for b, s in series.items()},
            {b: _in_bounds(s.x, condition) for b, s in series.items()},
        )
    table = log.table(stream, [TIME, BOOT, source.fields[0]])
    values = column_values(table, source.fields[0])
    holds = _is_one_of(values, condition, table.schema.field(source.fields[0]).metadata or {})
    boots, t_ns = np.asarray(table[BOOT].to_numpy()), np.asarray(table[TIME].to_numpy())
    keys = [int(b) for b in np.unique(boots)]
    return {b: t_ns[boots == b] for b in keys}, {b: holds[boots == b] for b in keys}


def _in_bounds(x: npt.NDArray[np.float64], condition: Condition) -> BoolArray:
    low = -np.inf if condition.above is None else condition.above
    high = np.inf if condition.below is None else condition.below
    return np.asarray((x > low) & (x < high))


def _is_one_of(
    values: npt.NDArray[np.generic], condition: Condition, metadata: Mapping[bytes, bytes]
) -> BoolArray:
    if condition.has_bits:
        bits = values.astype(np.int64) & condition.has_bits
        return np.asarray(bits == condition.has_bits)
    names = {v: k for k, v in json.loads(metadata.get(b"enum", b"{}")).items()}
    wanted = {float(names[v]) if v in names else v for v in condition.any_of}
    if values.dtype.kind in "OUS":
        texts = {str(w) for w in wanted}
        return np.array([str(v) in texts for v in values], dtype=bool)
    numbers = [float(w) for w in wanted if not isinstance(w, str)]
    return np.isin(values.astype(np.float64), numbers)


def _spans_true(t_ns: npt.NDArray[np.int64], holds: BoolArray, margin_ns: int) -> list[Span]:
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
