"""What is known about an ingested flight without opening its tables: one JSON file per flight.

Imports neither numpy nor pyarrow, so that listing a large folder is cheap. The manifest is written last;
a flight folder without one does not exist for any reader.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path, PurePath
from typing import Any

import msgspec
from msgspec import field

from flysid import mirror
from flysid.errors import StoreError, UsageError
from flysid.files import remedy_unread, why_unread
from flysid.flight import ClockMap, Damage, Source, resolve_stream
from flysid.foreign import inner_path, why_outside
from flysid.showing import Table, as_html, as_text, counted
from flysid.version import check_version

DATA_FORMAT = "flysid-data"
FLIGHT_FORMAT = "flysid-flight"
VERSION = 1
LAKE_VERSION = 2
"""Of a lake in an object store: flights by their hashes, tables by generation."""
RUN_FILE = "run.json"
"""What `flysid fit` lays into a run's folder, by which the folder is known."""
DATA_FILE = "flysid-data.json"
FLIGHTS = "flights"
MANIFEST_FILE = "manifest.json"

Stamp = tuple[int, int]
"""Size of a manifest in bytes and its time of change in ns: what differs where the manifest does."""


class Column(msgspec.Struct, frozen=True, omit_defaults=True):
    """One column of a stream: physical value = raw value * scale, in `unit`."""

    name: str
    type: str
    unit: str = ""
    scale: float = 1.0
    enum: Mapping[str, str] = field(default_factory=dict)
    description: str = ""


class StreamEntry(msgspec.Struct, frozen=True, omit_defaults=True):
    """One stream of a flight.

    Attributes
    ----------
    stream : the stream's key, exactly as the reader gave it.
    file : name of its parquet file inside the flight's folder.
    first_ns, last_ns : smallest and largest vehicle time; None without rows.
    rate_hz : mean rate inside boots; None where time does not advance.
    boots : the boots it occurs in, ascending.
    is_sorted : rows are in order of (boot, time_ns) across the whole file.
    metadata : schema metadata, e.g. {"time_source": "time_boot_ms", "system": "1"}.
    """

    stream: str
    file: str
    rows: int
    columns: tuple[Column, ...]
    first_ns: int | None = None
    last_ns: int | None = None
    rate_hz: float | None = None
    boots: tuple[int, ...] = ()
    is_sorted: bool = True
    metadata: Mapping[str, str] = field(default_factory=dict)


class Manifest(msgspec.Struct, frozen=True):
    """An ingested flight: where it came from, its streams, its clocks and what was lost."""

    id: str
    source: Source
    streams: tuple[StreamEntry, ...]
    damage: Damage = field(default_factory=Damage)
    clocks: tuple[ClockMap, ...] = ()
    info: Mapping[str, str] = field(default_factory=dict)
    format: str = FLIGHT_FORMAT
    version: int = VERSION
    flysid: str = ""

    @property
    def rows(self) -> int:
        """Rows of all streams."""
        return sum(s.rows for s in self.streams)

    @property
    def duration_s(self) -> float:
        """Vehicle time from first to last row, summed over boots, in seconds."""
        return sum(c.last_ns - c.first_ns for c in self.clocks) * 1e-9

    def _table(self) -> Table:
        title = (
            f"{self.id}: {self.source.format}, {counted(self.rows, 'record')} in "
            f"{counted(len(self.streams), 'stream')}, {self.duration_s:.1f} s"
        )
        title += "; with losses" if self.damage.lossy else ""
        most = sorted(self.streams, key=lambda entry: -entry.rows)
        rows = [(s.stream, f"{s.rows:,}", f"{s.rate_hz:.4g}" if s.rate_hz else "-") for s in most]
        return Table(title, ("stream", "records", "Hz"), rows)

    def __repr__(self) -> str:
        return as_text(self._table())

    def _repr_html_(self) -> str:
        return as_html(self._table())

    def stream(self, name: str) -> StreamEntry:
        """The entry of a stream, by key or unambiguous message name; raises UsageError otherwise."""
        entries = {s.stream: s for s in self.streams}
        return entries[resolve_stream(name, entries, self.id)]


class _StoredEntry(StreamEntry, frozen=True):
    """An entry whose columns are still text: those of a message are the same in many flights."""

    columns: msgspec.Raw  # type: ignore[assignment]


class _Stored(Manifest, frozen=True):
    streams: tuple[_StoredEntry, ...]


def to_json(manifest: Manifest) -> bytes:
    """The manifest as JSON; equal manifests give equal bytes."""
    return msgspec.json.encode(manifest, order="deterministic") + b"\n"


def read_manifest(folder: str | Path) -> Manifest:
    """Read the manifest of one flight's folder.

    Raises StoreError: missing, damaged, or written by a newer flysid.
    """
    path = mirror.fetch(inner_path(Path(folder), MANIFEST_FILE, folder))
    return parse_manifest(_read(path), path)


def parse_manifest(text: bytes, path: str | Path) -> Manifest:
    """The manifest that a text is; raises as `read_manifest`."""
    _check_head(text, FLIGHT_FORMAT, VERSION, path)
    try:
        facts = msgspec.structs.asdict(msgspec.json.decode(text, type=_Stored))
        check_id(facts["id"], path)
        return Manifest(**{**facts, "streams": tuple(_entry(stored) for stored in facts["streams"])})
    except msgspec.ValidationError as error:
        raise StoreError(f"damaged manifest: {error}", path=path, hint="ingest the log again") from error


def check_id(flight: str, document: str | Path) -> None:
    """Raise StoreError where the id of a flight is not the name of a folder."""
    if why_outside(flight) or PurePath(flight).name != flight:
        raise StoreError(
            f"{flight!r} is not the id of a flight", path=document, hint="do not use it: no flysid wrote it"
        )


def _entry(stored: _StoredEntry) -> StreamEntry:
    facts = msgspec.structs.asdict(stored)
    return StreamEntry(**{**facts, "columns": _columns(bytes(facts["columns"]))})


@lru_cache(maxsize=1 << 12)
def _columns(text: bytes) -> tuple[Column, ...]:
    """Columns, once for all flights that have the same: ten thousand flights would not fit otherwise."""
    return msgspec.json.decode(text, type=tuple[Column, ...])


def check_data_folder(data: str | Path) -> Path:
    """`data` as a Path, once it is known to be an ingested folder of a version that is understood.

    Raises UsageError: there is no such folder, or `flysid ingest` did not make it. Raises StoreError:
    damaged, or of a newer version.
    """
    data = Path(data)
    if data.is_file():
        raise UsageError(
            "a file, not an ingested folder",
            path=data,
            hint=f"flysid doctor {data}; or flysid ingest {data} -o DATA first",
        )
    if not data.is_dir():
        raise UsageError("no such folder", path=data, hint=f"make it with: flysid ingest LOG... -o {data}")
    if not (data / DATA_FILE).is_file():
        raise UsageError(
            "not an ingested folder: it has no " + DATA_FILE,
            path=data,
            hint=about_run(data) or "make one with: flysid ingest LOG... -o DATA",
        )
    _check_head(_read(data / DATA_FILE), DATA_FORMAT, VERSION, data / DATA_FILE)
    return data


def about_run(folder: Path) -> str:
    """What to do with the folder of a run where flights are wanted; "" where it is none."""
    if not (folder / RUN_FILE).is_file():
        return ""
    with suppress(msgspec.DecodeError, OSError):
        if data := msgspec.json.decode((folder / RUN_FILE).read_bytes(), type=_RunHead).data:
            return f"this is a run, and its flights are in {data}; 'flysid validate {folder}' judges it"
    return f"this is a run: 'flysid validate {folder}' judges it"


def check_lake(document: bytes, address: str) -> None:
    """Raise StoreError where a lake's document is not one that is understood."""
    _check_head(document, DATA_FORMAT, LAKE_VERSION, f"{address}/{DATA_FILE}")


def list_flights(data: str | Path) -> list[Manifest]:
    """Manifests of all flights of an ingested folder, by id. Unfinished flights do not show.

    Each is read; `flysid.catalogue` has most of it without. Raises UsageError, StoreError: as
    `check_data_folder` and `read_manifest`.
    """
    data = check_data_folder(data)
    return [read_manifest(data / FLIGHTS / name) for name in sorted(stamps(data))]


def folder_names(data: Path) -> Iterator[str]:
    """Names of the folders that may hold flights, finished or not, in no order."""
    with suppress(FileNotFoundError), os.scandir(data / FLIGHTS) as entries:
        yield from (entry.name for entry in entries if entry.is_dir())


def stamps(data: Path) -> dict[str, Stamp]:
    """Every finished flight -> size and time of change of its manifest; no file is opened."""
    found: dict[str, Stamp] = {}
    for name in folder_names(data):
        if not name.startswith("."):
            with suppress(OSError):
                found[name] = stamp_of(os.path.join(data, FLIGHTS, name))
    return found


def stamp_of(folder: str | Path) -> Stamp:
    """Size and time of change of a flight's manifest. Raises OSError where there is none."""
    state = os.stat(os.path.join(folder, MANIFEST_FILE))
    return state.st_size, state.st_mtime_ns


def content_stamp(text: bytes) -> Stamp:
    """What stands for size and time of change where there is no time: size and a part of the hash."""
    return len(text), int.from_bytes(hashlib.sha256(text).digest()[:7])


def find_flight(data: str | Path, flight: str) -> Manifest:
    """The flight whose id is, or unambiguously begins with, `flight`.

    Raises UsageError: no such flight, or several.
    """
    data = check_data_folder(data)
    if flight and Path(flight).name == flight:
        mirror.fetch(data / FLIGHTS / flight / MANIFEST_FILE)
    names = {name for name in folder_names(data) if not name.startswith(".")}
    near = [flight] if flight in names else [name for name in names if name.startswith(flight)]
    finished = [name for name in near if (data / FLIGHTS / name / MANIFEST_FILE).is_file()]
    if not finished:
        finished = [name for name in names if (data / FLIGHTS / name / MANIFEST_FILE).is_file()]
    return read_manifest(data / FLIGHTS / find_named(flight, finished, data))


def find_named(flight: str, ids: Collection[str], path: str | Path) -> str:
    """The one of `ids` that is, or unambiguously begins with, `flight`.

    Raises UsageError: no such flight, or several; `path` is where they are.
    """
    if not flight:
        raise UsageError("the name of the flight is empty", path=path, hint="see 'flysid ls'")
    found = [flight] if flight in ids else sorted(name for name in ids if name.startswith(flight))
    if len(found) == 1:
        return found[0]
    if found:
        raise UsageError(f"{flight!r} names {len(found)} flights", path=path, hint=", ".join(found[:5]))
    import difflib

    alike = difflib.get_close_matches(flight, ids, n=3, cutoff=0.3) or sorted(ids)[:3]
    raise UsageError(
        f"no flight {flight!r}", path=path, hint=", ".join(alike) or "the folder holds no flights"
    )


class _RunHead(msgspec.Struct):
    """The part of a run that locates its flights."""

    data: str = ""


class _Head(msgspec.Struct):
    """The part that decides whether the rest of a document can be understood."""

    format: Any = None
    version: Any = None


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise StoreError(
            f"cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
        ) from error


def _check_head(text: bytes, expected: str, newest: int, path: str | Path) -> None:
    """Raise StoreError where a text is no document of the format that is expected, or of a newer version."""
    try:
        head = msgspec.json.decode(text, type=_Head)
    except msgspec.ValidationError as error:
        raise StoreError(f"not a {expected} file", path=path, hint="ingest the log again") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise StoreError("damaged: not JSON", path=path, hint="ingest the log again") from error
    if head.format != expected:
        raise StoreError(f"not a {expected} file", path=path, hint="ingest the log again")
    check_version(head.version, newest, expected, path)
