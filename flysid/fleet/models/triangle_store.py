"""Where triangles are kept: parquet beside the flights, by the recipe that made them, each written once.

    catalog/triangles/<recipe>/sampling-<channel>.json     the grid, chosen once
    catalog/triangles/<recipe>/part-<digest>.parquet       one row per flight and channel, of many flights

A part's name is the digest of its content: the same flights in the same order are the same bytes under the
same name, and two writers at once do no harm. What is known of a flight holds for its log and for this
version of the table; another recipe has another folder.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from flysid.errors import StoreError
from flysid.files import write_atomically, writing_to
from flysid.fleet.models.band import ComplexArray
from flysid.fleet.models.common_grid import Sampling
from flysid.fleet.models.differences import FlightPart
from flysid.fleet.models.triangles import Triangle
from flysid.ingest.align.recipe import Recipe

TRIANGLES = "catalog/triangles"
VERSION = 1
WORDS = ("description", "remedy", "shows", "hides", "min_rate_hz")


class Objects(Protocol):
    """What a place must be able to do; names are relative, with "/"."""

    def names(self, prefix: str) -> Sequence[str]:
        """Those that begin with the prefix, in order."""
        ...

    def get(self, name: str) -> bytes | None:
        """The content; None where there is none."""
        ...

    def create(self, name: str, content: bytes) -> None:
        """Write it whole, where it is not there yet."""
        ...


class Folder:
    """A local folder of objects."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def names(self, prefix: str) -> Sequence[str]:
        """As `Objects`."""
        folder = self._path / prefix
        found = sorted(p.name for p in folder.iterdir() if p.is_file()) if folder.is_dir() else []
        return [f"{prefix}/{name}" for name in found if not name.startswith(".")]

    def get(self, name: str) -> bytes | None:
        """As `Objects`."""
        try:
            return (self._path / name).read_bytes()
        except FileNotFoundError:
            return None

    def create(self, name: str, content: bytes) -> None:
        """As `Objects`."""
        path = self._path / name
        if path.exists():
            return
        with writing_to(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, content)


class Unfit(msgspec.Struct, frozen=True):
    """A channel that had no grid when the fleet had so many flights."""

    reason: str
    flights: int


class TriangleRow(msgspec.Struct, frozen=True):
    """One flight and channel; `reason` explains why there is no triangle."""

    flight: str
    sha256: str
    channel: str
    vehicle: str
    firmware: str
    start_ns: int | None
    rows: int
    windows: int
    reason: str
    r: bytes
    spectra: bytes


def _without_words(value: Any) -> Any:
    """A recipe without its notes for people, which make no triangle."""
    if isinstance(value, Mapping):
        return {k: _without_words(v) for k, v in value.items() if k not in WORDS}
    return [_without_words(v) for v in value] if isinstance(value, list | tuple) else value


SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("flight", "sha256", "channel", "vehicle", "firmware")),
        *((name, pa.int64()) for name in ("start_ns", "rows", "windows")),
        ("reason", pa.string()),
        ("r", pa.binary()),
        ("spectra", pa.binary()),
    ]
)


def row_of(part: FlightPart, sha256: str, channel: str, reason: str = "") -> TriangleRow:
    """A part as it is stored: the upper triangle row by row, little-endian."""
    t = part.triangle
    r = t.r[np.triu_indices(len(t.r))].astype("<f8").tobytes()
    spectra = t.spectra.astype("<c16").tobytes()
    flown = part.flight, sha256, channel, part.vehicle, part.firmware, part.start_ns
    return TriangleRow(*flown, t.rows, t.windows, reason, r, spectra)


def part_of(row: Mapping[str, object], sampling: Sampling) -> FlightPart:
    """The part of a stored row."""
    got = msgspec.convert(row, TriangleRow)
    r = np.zeros((sampling.columns,) * 2)
    r[np.triu_indices(sampling.columns)] = np.frombuffer(got.r, dtype="<f8")
    signals = len(sampling.inputs) + len(sampling.outputs)
    spectra: ComplexArray = np.frombuffer(got.spectra, dtype="<c16").reshape(-1, signals, signals)
    return FlightPart(
        got.flight, got.vehicle, got.firmware, got.start_ns, Triangle(r, got.rows, spectra, got.windows)
    )


class TriangleStore:
    """The triangles that a recipe made of a fleet.

    `objects`: the fleet's place.
    `recipe`: stores differ by its content, not by its name.
    `rate_hz`: the grid that the user chose; None: chosen from the coherence.
    """

    def __init__(self, objects: Objects, recipe: Recipe, rate_hz: float | None = None) -> None:
        content = _without_words(dataclasses.asdict(recipe))
        identity = json.dumps((VERSION, content, rate_hz), sort_keys=True).encode()
        self._objects = objects
        self.prefix = f"{TRIANGLES}/{hashlib.sha256(identity).hexdigest()[:16]}"

    def sampling(self, channel: str) -> Sampling | Unfit | None:
        """The channel's grid, or why it had none; None before the first look. Raises StoreError: damaged."""
        name = f"{self.prefix}/sampling-{channel}.json"
        for place in (name, *reversed(self._unfit(channel))):
            content = self._objects.get(place)
            if content is not None:
                try:
                    if place == name:
                        return msgspec.json.decode(content, type=Sampling)
                    return msgspec.json.decode(content, type=Unfit)
                except msgspec.DecodeError as error:
                    raise StoreError(
                        f"damaged: {error}", path=place, hint="remove it and run the command again"
                    ) from error
        return None

    def _unfit(self, channel: str) -> list[str]:
        stem = f"{self.prefix}/unfit-{channel}-"
        return [n for n in self._objects.names(self.prefix) if n.startswith(stem)]

    def keep_sampling(self, channel: str, found: Sampling | Unfit) -> None:
        """Remember a channel's grid."""
        kind = f"unfit-{channel}-{found.flights:09d}" if isinstance(found, Unfit) else f"sampling-{channel}"
        self._objects.create(f"{self.prefix}/{kind}.json", msgspec.json.encode(found))

    def keep(self, rows: Sequence[TriangleRow]) -> None:
        """Remember flights."""
        table = pa.Table.from_pylist([msgspec.to_builtins(r, builtin_types=(bytes,)) for r in rows], SCHEMA)
        file = io.BytesIO()
        pq.write_table(table, file, compression="zstd")
        content = file.getvalue()
        digest = hashlib.sha256(content).hexdigest()[:16]
        self._objects.create(f"{self.prefix}/part-{digest}.parquet", content)

    def known(self) -> set[tuple[str, str, str]]:
        """(flight, sha256 of its log, channel) of all that is remembered."""
        tables = self._tables(["flight", "sha256", "channel"])
        return {tuple(row.values()) for table in tables for row in table.to_pylist()}

    def parts(self, channel: str, sampling: Sampling, flights: Mapping[str, str]) -> list[FlightPart]:
        """The channel's parts of some flights (id -> sha256), each once, by flight."""
        found: dict[str, FlightPart] = {}
        for table in self._tables(None):
            for row in table.filter(pa.compute.equal(table["channel"], channel)).to_pylist():
                if flights.get(row["flight"]) == row["sha256"] and not row["reason"]:
                    found[row["flight"]] = part_of(row, sampling)
        return [found[name] for name in sorted(found)]

    def _tables(self, columns: list[str] | None) -> Iterable[pa.Table]:
        for name in self._objects.names(self.prefix):
            if name.endswith(".parquet"):
                content = self._objects.get(name)
                if content is not None:
                    try:
                        yield pq.read_table(io.BytesIO(content), columns=columns)
                    except pa.ArrowException as error:
                        raise StoreError(
                            f"damaged: {error}", path=name, hint="remove it and run the command again"
                        ) from error
