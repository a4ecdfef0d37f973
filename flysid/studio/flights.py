"""The flights of an ingested folder as the page asks for them: lists, fields, windows of curves, tracks."""

from __future__ import annotations

import json
import os
import re
import struct
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from flysid.catalogue import FlightFacts
from flysid.errors import UsageError
from flysid.facts.clock import log_clock
from flysid.flight import BOOT, RECEIVED, TIME
from flysid.ingest.align.recipe import load_recipe, shipped_recipes
from flysid.ingest.align.signals import load_signal
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.timeline import happenings
from flysid.ingest.lake.track import read_track
from flysid.manifest import FLIGHTS, MANIFEST_FILE, Column, Manifest, StreamEntry, read_manifest
from flysid.studio.folders import NotThere, Workspace, is_name
from flysid.studio.forms import Window
from flysid.studio.pyramid import Pyramid, TimeAxis, View, hold, look, read_axis, read_pyramid

SIGNAL = "@"  # "@recipe:signal" is a recipe's signal, as "stream:field" is a field
RUN = "run/"  # "@run/ID:signal" is one of the recipe that a run was fitted by
MAPPED = 256  # fields kept ready: more than a person looks at
_NUMBER = re.compile(r"^(u?int\d+|halffloat|float|double|bool)$")
_ARRAY = re.compile(r"^fixed_size_list<\w+: (\w+)(?: not null)?>\[(\d+)\]$")


MOST_FIELDS = 16
PIXELS = (16, 8192)


class Flights:
    """Reads from a studio's ingested folder; `cache` is for mapped fields, gone after this process."""

    def __init__(self, workspace: Workspace, cache: Path) -> None:
        self.data = workspace.data
        self._cache = cache
        self._recipe_of_run = lru_cache(MAPPED)(workspace.recipe_of_run)
        self._readers = ThreadPoolExecutor(os.cpu_count())
        self._described = lru_cache(MAPPED)(self._describe)
        self._axis = lru_cache(MAPPED)(self._read_axis)
        self._pyramid = lru_cache(MAPPED)(self._read_pyramid)
        self._signal = lru_cache(MAPPED)(self._read_signal)

    def listing(self, words: str = "", most: int = 500) -> dict[str, Any]:
        """The newest flights whose facts hold every one of some words, and how many there are."""
        wanted = words.casefold().split()
        facts = [f for f in open_lake(self.data).facts if all(word in _searchable_text(f) for word in wanted)]
        facts.sort(key=lambda f: (-(f.start_utc_ns or 0), f.id))
        return {"count": len(facts), "flights": [_summarise(f) for f in facts[:most]]}

    def describe(self, flight: str) -> dict[str, Any]:
        """Facts, streams with fields, modes, messages and parameter changes of a flight."""
        self.manifest(flight)
        return self._described(flight, (self.data / FLIGHTS / flight / MANIFEST_FILE).stat().st_mtime_ns)

    def _describe(self, flight: str, _stamp: int) -> dict[str, Any]:
        manifest = self.manifest(flight)
        lake = lake_of(self.data, flight)
        [log] = lake.logs
        axis = log_clock(manifest.clocks)
        modes, moments = happenings(log, axis.offsets_s, manifest.duration_s)
        return {
            **_summarise(log.facts),
            "clocks": [[boot, str(axis.begins_ns[boot]), start_s] for boot, start_s in axis.starts_s.items()],
            "streams": [_stream(entry) for entry in manifest.streams if entry.rows],
            "signals": _signals(lake),
            "modes": modes,
            "moments": [[m.time_s, m.kind, m.text] for m in moments],
        }

    def track(self, flight: str) -> dict[str, Any]:
        """Where the vehicle flew, for a drawing without tiles; at most about 2,000 points."""
        table = read_track(lake_of(self.data, flight).logs[0])
        if table is None:
            return {"points": []}
        kept = np.unique(np.linspace(0, table.num_rows - 1, min(table.num_rows, 2000)).astype(int))
        columns = [table[name].to_numpy()[kept] for name in ("time_s", "lat_deg", "lon_deg")]
        points = [
            [round(float(at), 3), round(float(lat), 7), round(float(lon), 7)]
            for at, lat, lon in zip(*columns, strict=True)
        ]
        return {"points": points}

    def series(self, window: Window) -> bytes:
        """Curves in a window: the length of a JSON head as a 32-bit number, the head, then the numbers.

        The head has for every series its name, unit and count of points, `base`, and `whole` where every
        sample is there. After it, at the next multiple of 8 bytes, follow for every series its times after
        `start_s` and its values above `base`, float32 in the byte order of the network's opposite (little).
        Raises UsageError: no such flight, stream or field; too many fields; a width or a window that cannot
        be.
        """
        manifest = self.manifest(window.f)
        start_s, end_s = _span(window, manifest)
        units = [self._unit(manifest, name) for name in window.s]
        for stream in dict.fromkeys(name.rpartition(":")[0] for name in window.s):
            if not stream.startswith(SIGNAL):
                self._axis(manifest.id, stream)
        curves = self._readers.map(partial(self._curve, manifest.id), window.s)
        head: list[dict[str, Any]] = []
        body: list[bytes] = []
        for name, unit, (axis, pyramid) in zip(window.s, units, curves, strict=True):
            view = look(axis, pyramid, start_s, end_s, window.w)
            base = _middle(view)
            body.append((view.time_s - start_s).astype("<f4").tobytes())
            body.append((view.values - base).astype("<f4").tobytes())
            head.append(
                {"name": name, "unit": unit, "points": len(view.time_s), "base": base, "whole": view.whole}
            )
        text = json.dumps({"start_s": start_s, "end_s": end_s, "series": head}).encode()
        text += b" " * (-(4 + len(text)) % 8)
        return b"".join([struct.pack("<I", len(text)), text, *body])

    def manifest(self, flight: str) -> Manifest:
        """What is known of a flight without its tables; raises NotThere."""
        folder = self.data / FLIGHTS / flight
        if not is_name(flight) or not folder.is_dir():
            raise NotThere(f"no flight {flight!r}", path=self.data)
        return read_manifest(folder)

    def _unit(self, manifest: Manifest, name: str) -> str:
        """The unit of what a name stands for; raises UsageError where it stands for nothing."""
        stream, _, field = name.rpartition(":")
        if stream.startswith(SIGNAL):
            signals = load_recipe(self._recipe(stream)[0]).signals
            units = {name: spec.unit for name, spec in signals.items()}
        else:
            entry = manifest.stream(stream)
            units = {known: column.unit for column in entry.columns for known in drawable(column)}
        if field not in units:
            raise UsageError(f"no numeric field {field!r} in {stream!r}", path=manifest.id)
        return units[field]

    def _curve(self, flight: str, name: str) -> tuple[TimeAxis, Pyramid]:
        stream, _, field = name.rpartition(":")
        if stream.startswith(SIGNAL):
            return self._signal(flight, *self._recipe(stream), field)
        return self._axis(flight, stream), self._pyramid(flight, stream, field)

    def _recipe(self, stream: str) -> tuple[str, int]:
        """What `load_recipe` takes for "@NAME" or "@run/ID", and when that was written; raises NotThere."""
        name = stream.removeprefix(SIGNAL)
        if name in shipped_recipes():
            return name, 0
        if not name.startswith(RUN):
            raise NotThere(f"no recipe {name!r}")
        path = self._recipe_of_run(name.removeprefix(RUN))
        try:
            return str(path), path.stat().st_mtime_ns
        except OSError as error:
            raise NotThere("the run is gone", path=path.parent) from error

    def _read_signal(self, flight: str, recipe: str, _stamp: int, signal: str) -> tuple[TimeAxis, Pyramid]:
        found = load_signal(signal, load_recipe(recipe).signals[signal], lake_of(self.data, flight).logs[0])
        offsets = log_clock(self.manifest(flight).clocks).offsets_s
        boots = [
            (np.asarray(samples.t_ns * 1e-9 + offsets.get(boot, 0.0)), samples.x)
            for boot, samples in sorted(found.boots.items())
        ]
        return hold(boots, self._cache)

    def _read_axis(self, flight: str, stream: str) -> TimeAxis:
        manifest = self.manifest(flight)
        folder = self.data / FLIGHTS / flight
        return read_axis(folder, manifest.stream(stream), log_clock(manifest.clocks).offsets_s, self._cache)

    def _read_pyramid(self, flight: str, stream: str, field: str) -> Pyramid:
        manifest = self.manifest(flight)
        return read_pyramid(self.data / FLIGHTS / flight, manifest.stream(stream), field, self._cache)


def lake_of(data: Path, flight: str) -> Lake:
    """The ingested folder with one flight alone; raises NotThere."""
    lake = open_lake(data).only([flight])
    if not lake.logs:
        raise NotThere(f"no flight {flight!r}", path=data)
    return lake


def _signals(lake: Lake) -> list[dict[str, Any]]:
    """The signals of the recipes that a lake of one flight serves: "@recipe" -> [name, unit]."""
    listed = []
    for name, channels in lake.recipes().items():
        recipe = load_recipe(name)
        used = dict.fromkeys(s for channel in channels for s in recipe.signals_of(channel))
        fields = [[signal, recipe.signals[signal].unit] for signal in used]
        pairs = [list(recipe.signals_of(channel)) for channel in channels]
        listed.append({"stream": f"{SIGNAL}{name}", "fields": fields, "channels": pairs})
    return listed


def drawable(column: Column) -> Sequence[str]:
    """The fields of a column that are numbers: itself, or its elements where it holds arrays."""
    if column.name in (TIME, BOOT, RECEIVED):
        return ()
    array = _ARRAY.match(column.type)
    if array is not None and _NUMBER.match(array[1]):
        return [f"{column.name}[{i}]" for i in range(int(array[2]))]
    return (column.name,) if _NUMBER.match(column.type) else ()


def _stream(entry: StreamEntry) -> dict[str, Any]:
    fields = [[name, column.unit] for column in entry.columns for name in drawable(column)]
    clock = entry.metadata.get("time_source", "")
    fields.sort(key=lambda field: field[0] == clock)  # its own clock last
    return {"stream": entry.stream, "rows": entry.rows, "rate_hz": entry.rate_hz, "fields": fields}


def _summarise(facts: FlightFacts) -> dict[str, Any]:
    return {
        "id": facts.id,
        "log": facts.log,
        "format": facts.format,
        "size_bytes": facts.size_bytes,
        "duration_s": facts.duration_s,
        "rows": facts.rows,
        "losses": facts.lacks,
        "start_utc_ns": None if facts.start_utc_ns is None else str(facts.start_utc_ns),
        "info": dict(facts.info),
    }


def _searchable_text(facts: FlightFacts) -> str:
    return " ".join([facts.id, facts.log, facts.format, *facts.info.values()]).casefold()


def _span(window: Window, manifest: Manifest) -> tuple[float, float]:
    """The window's ends; raises UsageError for what cannot be looked at."""
    start_s = 0.0 if window.t0 is None else window.t0
    end_s = max(manifest.duration_s, 1e-3) if window.t1 is None else window.t1
    if not (np.isfinite(start_s) and np.isfinite(end_s) and start_s < end_s):
        raise UsageError(f"a window from {start_s} to {end_s} s shows nothing")
    if not PIXELS[0] <= window.w <= PIXELS[1]:
        raise UsageError(f"{window.w} pixels", hint=f"w from {PIXELS[0]} to {PIXELS[1]}")
    if len(window.s) > MOST_FIELDS:
        raise UsageError(f"{len(window.s)} fields at once", hint=f"at most {MOST_FIELDS}")
    return start_s, end_s


def _middle(view: View) -> float:
    """A value near all others, so that differences from it need few digits."""
    finite = view.values[np.isfinite(view.values)]
    return float((finite.min() + finite.max()) / 2.0) if len(finite) else 0.0
