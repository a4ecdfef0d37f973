"""What is known about an ingested flight without opening its tables: one JSON file per flight.

Imports neither numpy nor pyarrow, so that listing a large folder is cheap. The manifest is written last;
a flight folder without one does not exist for any reader.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from flysid.errors import StoreError, UsageError
from flysid.flight import ClockMap, Damage, Source, resolve_stream
from flysid.version import check_version

DATA_FORMAT = "flysid-data"
FLIGHT_FORMAT = "flysid-flight"
VERSION = 1
DATA_FILE = "flysid-data.json"
FLIGHTS = "flights"
MANIFEST_FILE = "manifest.json"


@dataclass(frozen=True)
class Column:
    """One column of a stream: physical value = raw value * scale, in `unit`."""

    name: str
    type: str
    unit: str = ""
    scale: float = 1.0
    enum: Mapping[str, str] = field(default_factory=dict)
    description: str = ""


@dataclass(frozen=True)
class StreamEntry:
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


@dataclass(frozen=True)
class Manifest:
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

    def stream(self, name: str) -> StreamEntry:
        """The entry of a stream, by key or unambiguous message name; raises UsageError otherwise."""
        entries = {s.stream: s for s in self.streams}
        return entries[resolve_stream(name, entries, self.id)]


def to_json(manifest: Manifest) -> bytes:
    """The manifest as indented JSON; equal manifests give equal bytes."""
    return msgspec.json.format(msgspec.json.encode(manifest, order="deterministic"), indent=1) + b"\n"


def read_manifest(folder: str | Path) -> Manifest:
    """Read the manifest of one flight's folder.

    Raises
    ------
    StoreError : missing, damaged, or written by a newer flysid.
    """
    path = Path(folder) / MANIFEST_FILE
    document = _read_document(path, FLIGHT_FORMAT)
    try:
        return msgspec.convert(document, Manifest)
    except msgspec.ValidationError as error:
        raise StoreError(f"damaged manifest: {error}", path=path, hint="ingest the log again") from error


def check_data_folder(data: str | Path) -> Path:
    """`data` as a Path, once it is known to be an ingested folder of a version that is understood.

    Raises
    ------
    UsageError : there is no such folder, or `flysid ingest` did not make it.
    StoreError : damaged, or of a newer version.
    """
    data = Path(data)
    if not data.is_dir():
        raise UsageError(
            "no such folder", path=data, hint="make it with: flysid ingest LOG... -o " + data.name
        )
    if not (data / DATA_FILE).is_file():
        raise UsageError(
            "not an ingested folder: it has no " + DATA_FILE,
            path=data,
            hint="make one with: flysid ingest LOG... -o DATA",
        )
    _read_document(data / DATA_FILE, DATA_FORMAT)
    return data


def list_flights(data: str | Path) -> list[Manifest]:
    """Manifests of all flights of an ingested folder, by id. Unfinished flights do not show.

    Raises
    ------
    UsageError, StoreError : as `check_data_folder` and `read_manifest`.
    """
    return [read_manifest(folder) for folder in flight_folders(check_data_folder(data))]


def flight_folders(data: Path) -> list[Path]:
    """Folders of all complete flights, by name."""
    return sorted(
        folder
        for folder in (data / FLIGHTS).glob("*")
        if not folder.name.startswith(".") and (folder / MANIFEST_FILE).is_file()
    )


def find_flight(data: str | Path, flight: str) -> Manifest:
    """The flight whose id is, or unambiguously begins with, `flight`.

    Raises
    ------
    UsageError : no such flight, or several.
    """
    folders = {folder.name: folder for folder in flight_folders(check_data_folder(data))}
    found = (
        [flight] if flight in folders else [name for name in folders if name.startswith(flight) and flight]
    )
    if len(found) == 1:
        return read_manifest(folders[found[0]])
    if found:
        raise UsageError(f"{flight!r} names {len(found)} flights", path=data, hint=", ".join(found[:5]))
    import difflib

    near = difflib.get_close_matches(flight, folders, n=3, cutoff=0.3) or sorted(folders)[:3]
    raise UsageError(
        f"no flight {flight!r}", path=data, hint=", ".join(near) or "the folder holds no flights"
    )


def _read_document(path: Path, expected: str) -> dict[str, object]:
    try:
        document = msgspec.json.decode(path.read_bytes())
    except OSError as error:
        raise StoreError(f"cannot be read: {error.strerror}", path=path) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise StoreError("damaged: not JSON", path=path, hint="ingest the log again") from error
    if not isinstance(document, dict) or document.get("format") != expected:
        raise StoreError(f"not a {expected} file", path=path, hint="ingest the log again")
    check_version(document.get("version"), VERSION, expected, path)
    return document
