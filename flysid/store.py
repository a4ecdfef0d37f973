"""Flight to parquet and back. The manifest, written last, commits a flight.

A flight is written into a hidden folder beside its final place: parquet files, then the manifest. When
all of them are on the disk, the folder is renamed. A killed writer, or a power cut, leaves a hidden folder
that no reader sees and that the next writer removes.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Protocol

import pyarrow as pa
import pyarrow.parquet as pq

from flysid import mirror
from flysid.catalogue import CATALOGUE_FILE
from flysid.errors import UsageError, WriteError
from flysid.files import (
    filling,
    put_in_place,
    remove_left_behind,
    slug,
    unread_table,
    write_atomically,
    writing_to,
)
from flysid.files import locked as locked_file
from flysid.flight import BOOT, TIME, ClockMap, Damage, Flight, Source
from flysid.flightwriter import FlightWriter, in_order
from flysid.foreign import inner_path
from flysid.manifest import (
    DATA_FILE,
    DATA_FORMAT,
    FLIGHTS,
    MANIFEST_FILE,
    VERSION,
    Column,
    Manifest,
    StreamEntry,
    check_data_folder,
    find_flight,
    folder_names,
    list_flights,
    read_manifest,
    stamps,
    to_json,
)
from flysid.parts import exhaust
from flysid.progress import tell
from flysid.version import __version__

__all__ = [
    "Column",
    "Manifest",
    "StreamEntry",
    "clean",
    "create_data_folder",
    "discard",
    "entry_path",
    "find_flight",
    "list_flights",
    "locked",
    "mirror_of",
    "read_flight",
    "read_manifest",
    "read_stream",
    "slug",
    "tidy",
    "write_flight",
]


LOCK_FILE = ".lock"


class Part(Protocol):
    """Some rows of one stream."""

    @property
    def stream(self) -> str: ...
    @property
    def table(self) -> pa.Table: ...


class Outcome(Protocol):
    """What a reader knows at its end."""

    @property
    def damage(self) -> Damage: ...
    @property
    def clocks(self) -> tuple[ClockMap, ...]: ...
    @property
    def info(self) -> Mapping[str, str]: ...
    @property
    def renamed(self) -> Mapping[str, str]: ...


def flight_id(source: Source, digits: int = 8) -> str:
    """`<log name>-<sha256[:digits]>`, safe as a folder name."""
    return f"{slug(Path(source.name).stem)}-{source.sha256[:digits]}"


# ------------------------------------------------------------------------------------------- folders


def create_data_folder(data: str | Path) -> Path:
    """Make `data` an ingested folder unless it is one.

    Raises UsageError: it exists, is not empty and is not an ingested folder. Raises StoreError: its flights
    are a link that leads elsewhere. Raises WriteError: it cannot be made.
    """
    data = Path(data)
    if (data / DATA_FILE).is_file():
        inner_path(data, FLIGHTS, data)  # writers remove there what has no manifest
        return check_data_folder(data)
    if data.is_file() or (data.is_dir() and not all(_is_own(p) for p in data.iterdir())):
        what = "a file, not a folder" if data.is_file() else "not an ingested folder, and not empty"
        raise UsageError(what, path=data, hint="choose another folder with -o")
    with writing_to(data):
        (data / FLIGHTS).mkdir(parents=True, exist_ok=True)
        document = f'{{"format": "{DATA_FORMAT}", "version": {VERSION}}}\n'
        write_atomically(data / DATA_FILE, document.encode())
    return data


def mirror_of(address: str) -> Path:
    """The data folder here that mirrors a lake; made where there is none yet."""
    folder = create_data_folder(mirror.folder_for(address))
    mirror.mark(folder, address)
    return folder


def remove_empty(data: Path) -> None:
    """Remove an ingested folder that holds no flight, and nothing that is not flysid's own."""
    with suppress(OSError):
        (data / FLIGHTS).rmdir()
        for path in data.iterdir():
            if path.name == DATA_FILE or path.name.startswith("."):
                path.unlink()
        data.rmdir()


def _is_own(path: Path) -> bool:
    """Whether an entry of a folder is what a writer leaves that is killed while it makes a data folder."""
    if path.name == FLIGHTS:
        return path.is_dir() and not any(path.iterdir())
    return path.name in (LOCK_FILE, CATALOGUE_FILE) or path.name.startswith(f".{DATA_FILE}.")


def locked(data: Path) -> AbstractContextManager[None]:
    """Hold the folder's lock, so that two writers never clean up after each other.

    Raises WriteError when another process holds it; see `flysid.files.locked`.
    """
    return locked_file(data / LOCK_FILE, data)


def clean(data: Path) -> int:
    """Remove what killed writers left behind; returns the number of folders removed."""
    unfinished = set(folder_names(data)) - set(stamps(data))
    for name in unfinished:
        with writing_to(data / FLIGHTS / name):
            shutil.rmtree(data / FLIGHTS / name)
    for file in data.glob(f".{CATALOGUE_FILE}.*"):
        file.unlink(missing_ok=True)
    remove_left_behind(data, f".{DATA_FILE}.")
    return len(unfinished)


def tidy(data: Path) -> None:
    """Remove what killed writers left behind, where no other process writes; nothing else is touched."""
    with suppress(WriteError), locked(data):
        remove_left_behind(data / FLIGHTS, ".incoming-")
        for name in (CATALOGUE_FILE, DATA_FILE):
            remove_left_behind(data, f".{name}.")


def discard(data: Path, pid: int) -> None:
    """Remove what one writer, a process that has ended, left unfinished."""
    for folder in (data / FLIGHTS).glob(f".incoming-*-{pid}"):
        shutil.rmtree(folder, ignore_errors=True)


# ------------------------------------------------------------------------------------------- writing


def write_flight(
    data: str | Path,
    source: Source,
    parts: Generator[Part, None, Outcome],
    *,
    replace: bool = False,
    info: Mapping[str, str] | None = None,
) -> Manifest:
    """Write one flight into an ingested folder, in bounded memory.

    `data`: the ingested folder (`create_data_folder`).
    `source`: the log the parts come from.
    `parts`: a reader's generator: yields parts of streams, returns a summary.
    `replace`: overwrite a flight of the same id; without it the present one is returned unread.
    `info`: facts beside those that the reader finds.
    Raises WriteError: disk full, read-only. Raises FormatError: from the reader. Nothing stays visible either
    way.
    """
    data = Path(data)
    name = _free_id(data, source)
    final = data / FLIGHTS / name
    if (final / MANIFEST_FILE).is_file() and not replace:
        return read_manifest(final)
    incoming = data / FLIGHTS / f".incoming-{name}-{os.getpid()}"
    try:
        with writing_to(incoming):
            shutil.rmtree(incoming, ignore_errors=True)
            incoming.mkdir(parents=True)
        with filling(incoming):
            manifest = _write_streams(incoming, name, source, parts, info or {})
            with writing_to(final):
                (incoming / MANIFEST_FILE).write_bytes(to_json(manifest))
        with writing_to(final):
            put_in_place(incoming, final)
    except BaseException:
        shutil.rmtree(incoming, ignore_errors=True)
        raise
    return manifest


def _free_id(data: Path, source: Source) -> str:
    """The flight's id; with the whole hash where another log has taken the short one."""
    taken = data / FLIGHTS / flight_id(source)
    if (taken / MANIFEST_FILE).is_file() and read_manifest(taken).source.sha256 != source.sha256:
        return flight_id(source, digits=64)
    return taken.name


TELL_EVERY_S = 1.0


class _Told:
    """Hands parts to a writer, and reports now and then how many records those were."""

    def __init__(self, writer: FlightWriter) -> None:
        self._writer = writer
        self._rows = 0
        self._told = time.monotonic()

    def add(self, part: Part) -> None:
        self._writer.add(part.stream, part.table)
        self._rows += part.table.num_rows
        if time.monotonic() - self._told > TELL_EVERY_S:
            self._told = time.monotonic()
            tell(f"reading, {self._rows:,} records so far")


def _write_streams(
    folder: Path, name: str, source: Source, parts: Generator[Part, None, Outcome], info: Mapping[str, str]
) -> Manifest:
    writer = FlightWriter(folder)
    try:
        outcome = exhaust(parts, _Told(writer).add)
        entries = writer.finish(outcome.renamed)
    finally:
        writer.close()
    return Manifest(
        id=name,
        source=source,
        streams=entries,
        damage=outcome.damage,
        clocks=outcome.clocks,
        info=dict(outcome.info) | dict(info),
        flysid=__version__,
    )


# ------------------------------------------------------------------------------------------- reading


def read_stream(data: str | Path, flight: str, stream: str, columns: Sequence[str] | None = None) -> pa.Table:
    """One stream of an ingested flight, sorted by (boot, time_ns).

    `data`: the ingested folder.
    `flight`: the flight's id, or its unambiguous beginning.
    `stream`: the stream's key, or its message name where that is unambiguous.
    `columns`: which columns, in this order; all when None.
    Raises UsageError: no such flight, stream or column. Raises StoreError: damaged.
    """
    manifest = find_flight(data, flight)
    return read_entry(Path(data) / FLIGHTS / manifest.id, manifest.stream(stream), columns)


def entry_path(folder: Path, entry: StreamEntry) -> Path:
    """The file of one entry of a manifest; `folder` is the flight's folder. Raises StoreError."""
    return inner_path(folder, entry.file, folder / MANIFEST_FILE)


def read_entry(folder: Path, entry: StreamEntry, columns: Sequence[str] | None = None) -> pa.Table:
    """The table of one entry of a manifest; `folder` is the flight's folder."""
    path = entry_path(folder, entry)
    unknown = sorted(set(columns or ()) - {c.name for c in entry.columns})
    if unknown:
        raise UsageError(
            f"stream {entry.stream!r} has no column {unknown[0]!r}",
            path=folder.name,
            hint="one of " + ", ".join(c.name for c in entry.columns),
        )
    needed = None if columns is None else list(dict.fromkeys([*columns, BOOT, TIME]))
    try:
        table = pq.ParquetFile(mirror.fetch(path)).read(columns=needed)
    except (OSError, pa.ArrowException) as error:
        raise unread_table(error, path, "ingest the log again") from error
    if not entry.is_sorted:
        table = in_order(table)
    return table if columns is None else table.select(list(columns))


def read_flight(data: str | Path, flight: str, streams: Sequence[str] | None = None) -> Flight:
    """An ingested flight in memory, as `flysid.read` gives it for the log itself (rows sorted by time).

    `streams` limits it to some streams (keys or unambiguous names). Raises as `read_stream`.
    """
    manifest = find_flight(data, flight)
    folder = Path(data) / FLIGHTS / manifest.id
    entries = manifest.streams if streams is None else tuple(manifest.stream(s) for s in streams)
    tables = {entry.stream: read_entry(folder, entry) for entry in entries}
    return Flight(manifest.source, tables, manifest.damage, manifest.clocks, manifest.info)
