"""From these fields to those: recipes and datasets of logs that no shipped recipe speaks of."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flysid.dataset import Dataset
from flysid.errors import RecipeError
from flysid.escaping import toml_document
from flysid.flight import BOOT, RECEIVED, TIME, Flight, field_unit, matching_streams
from flysid.ingest.align.align import align
from flysid.ingest.align.recipe import QUICK, ChannelSpec, Recipe, SignalSpec, Source, parse_recipe
from flysid.ingest.align.signals import FlightLog, Log
from flysid.ingest.formats.base import WHOLE_BATCH_BYTES, Limits
from flysid.ingest.formats.common.units import is_known
from flysid.ingest.formats.registry import read
from flysid.showing import first_of

_ELEMENT = re.compile(r"^(.+?)(\[\d+\])?$")
_PLAIN = re.compile(r"[^A-Za-z0-9_]+")
_OWN = (TIME, BOOT, RECEIVED)
SHOWN = 12
NEITHER = "neither a recipe nor fields are given"


@dataclass(frozen=True)
class StreamField:
    """A field of a stream, and what its values are in."""

    stream: str
    field: str
    unit: str

    @property
    def name(self) -> str:
        """As a signal's name."""
        return _PLAIN.sub("_", self.field).strip("_") or "signal"


def dataset_from(
    source: str | Path | Flight | Sequence[str | Path | Flight],
    inputs: str | Sequence[str],
    outputs: str | Sequence[str],
    *,
    dt_s: float | None = None,
    time_unit: str = "",
    date_order: str = "",
) -> Dataset:
    """The dataset of some fields of logs: one clock, cut at gaps, inputs held from sample to sample.

    Parameters
    ----------
    source : a log or table (.csv), or several of them: paths, or flights in memory.
    inputs, outputs : fields, as `FIELD` where one stream has it, else as `STREAM.FIELD`.
    dt_s : seconds from row to row, for tables that have no time column.
    time_unit : of a table's times that state none: "s", "ms", "us", "ns", "min", "h" or "d".
    date_order : of a table's dates that may be meant in two: "dmy", "mdy" or "ymd".

    Raises
    ------
    FormatError : a log cannot be read; a table whose times may be in several units or orders.
    RecipeError : a field is nowhere, or in several streams; a table needs `dt_s`, or a log has its own time.
    DataError : the logs are too short, or a signal never moves.

    Examples
    --------
    >>> data = flysid.dataset_from("steps.csv", "u", "y")
    >>> data.dt_s, len(data)
    (0.1, 600)
    """
    sources = [source] if isinstance(source, str | Path | Flight) else source
    told = Limits(batch_bytes=WHOLE_BATCH_BYTES, time_unit=time_unit, date_order=date_order)
    logs = [FlightLog(s if isinstance(s, Flight) else read(s, limits=told)) for s in sources]
    driving, driven = ([words] if isinstance(words, str) else list(words) for words in (inputs, outputs))
    recipe = parse_recipe(tomllib.loads(quick_recipe(logs, driving, driven, dt_s)))
    signals = list(recipe.signals)
    count = len(dict.fromkeys(driving))
    both = ChannelSpec(tuple(signals[:count]), tuple(recipe.channels))
    name = ", ".join(recipe.channels)
    return align(logs, replace(recipe, channels={name: both}), name).dataset


def quick_recipe(
    logs: Sequence[Log], inputs: Sequence[str], outputs: Sequence[str], row_period_s: float | None = None
) -> str:
    """A recipe, in TOML: one channel per output, driven by all inputs.

    `logs`: where the fields are looked for; the first log that has a field tells its unit.
    `inputs`, `outputs`: fields, as `FIELD` where one stream has it, else as `STREAM.FIELD`.
    `row_period_s`: seconds from row to row, for tables that have no time column.
    Raises RecipeError: no inputs or outputs; a field is nowhere, or in several streams.
    """
    if not inputs or not outputs:
        lacking = f"no {'output' if inputs else 'input'} is named" if inputs or outputs else ""
        raise RecipeError(
            lacking or NEITHER,
            hint=f"--from FIELD --to FIELD, or --recipe; fields: {first_of(_fields(logs), SHOWN)}",
        )
    words = [*inputs, *outputs]
    places = {word: find_field(logs, word) for word in words}
    names = _distinct([places[word] for word in words])
    driven = [names[places[word]] for word in dict.fromkeys(inputs)]
    recipe = {
        "name": QUICK,
        "description": f"{', '.join(inputs)} to {', '.join(outputs)}",
        "signals": {
            names[places[word]]: _signal(places[word], "zero" if word in inputs else "linear", row_period_s)
            for word in dict.fromkeys(words)
        },
        "channels": {
            names[places[word]]: {"inputs": driven, "outputs": [names[places[word]]]}
            for word in dict.fromkeys(outputs)
        },
    }
    return toml_document(recipe)


def driven_by(recipe: Recipe, reference: Sequence[str], logs: Sequence[Log]) -> Recipe:
    """The recipe with these references in every channel: its own signals, or fields of the logs.

    Raises RecipeError: no log has such a field.
    """
    if not reference:
        return recipe
    signals = dict(recipe.signals)
    names = []
    for word in reference:
        name = word
        if word not in signals:
            place = find_field(logs, word)
            unit = "" if place.unit == "1" else place.unit
            source = Source(place.stream, place.field)
            name = place.name if place.name not in signals else f"{place.name}_reference"
            signals[name] = SignalSpec(unit, (source,), hold="zero")
        if all(name in channel.outputs for channel in recipe.channels.values()):
            raise RecipeError(
                f"{word!r} is an output: it does not drive its own loop", hint="a chirp, or a setpoint"
            )
        names.append(name)
    channels = {n: replace(c, reference=tuple(names)) for n, c in recipe.channels.items()}
    return replace(recipe, signals=signals, channels=channels)


def find_field(logs: Sequence[Log], word: str) -> StreamField:
    """The field that a word names; raises RecipeError with what is near."""
    for log in logs:
        readings = _readings(log, word)
        found = [place for stream in log.rows if (place := _place(log, stream, readings[stream])) is not None]
        if len(found) > 1:
            told = ", ".join(f"{p.stream}.{p.field}" for p in found[:SHOWN])
            raise RecipeError(f"{word!r} is a field of {len(found)} streams", hint=f"one of {told}")
        if found:
            return found[0]
    known = _fields(logs)
    near = difflib.get_close_matches(word, [*known, *(k.rpartition(".")[2] for k in known)], n=3)
    hint = ", ".join(dict.fromkeys(near)) or f"one of {first_of(known, SHOWN)}"
    raise RecipeError(f"no log has a field {word!r}", hint=hint)


def _place(log: Log, stream: str, readings: Sequence[str]) -> StreamField | None:
    """The first of some fields that a stream has."""
    columns = [c for c in log.columns(stream) if c not in _OWN]
    for field in readings:
        match = _ELEMENT.match(field)
        column = field if field in columns else match[1] if match else ""
        if column in columns:
            unit = field_unit(log.table(stream, [column]).schema.field(column))
            return StreamField(stream, field, unit if is_known(unit) else "")
    return None


def _readings(log: Log, word: str) -> dict[str, list[str]]:
    """Stream -> the fields of it that a word may mean: itself, or what stands behind the stream and a dot."""
    found = {stream: [word] for stream in log.rows}
    for i in [i for i, c in enumerate(word) if c == "."]:
        for stream in matching_streams(word[:i], log.rows):
            found[stream].append(word[i + 1 :])
    return found


def _fields(logs: Sequence[Log]) -> list[str]:
    return [f"{s}.{c}" for log in logs[:1] for s in log.rows for c in log.columns(s) if c not in _OWN]


def _distinct(places: Sequence[StreamField]) -> dict[StreamField, str]:
    """A name for every place; where two share one, the stream's goes before it."""
    names: dict[StreamField, str] = {}
    for place in dict.fromkeys(places):
        name = place.name
        if name in names.values():
            name = _PLAIN.sub("_", f"{place.stream}_{place.field}").strip("_")
        names[place] = name if name not in names.values() else f"{name}_{len(names)}"
    return names


def _signal(place: StreamField, hold: str, row_period_s: float | None) -> dict[str, Any]:
    source: dict[str, Any] = {"stream": place.stream, "field": place.field}
    if row_period_s is not None:
        source["row_period_s"] = row_period_s
    return {"unit": "" if place.unit == "1" else place.unit, "hold": hold, "sources": [source]}
