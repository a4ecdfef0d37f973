"""Many small tables into few large ones: per message and month, for questions about a whole fleet.

The flights' own tables stay as they are. Beside them a message's rows of a month lie in parts of about
128 MB, with columns that say whose rows they are, sorted by vehicle and start. One object lists the parts: it
is replaced as a whole, so a reader sees all new ones or the old. It names the commit of the catalogue whose
flights the parts hold: where that is still the newest, no row of the catalogue has to be read. A month
is written again where its flights are not the same as before: late flights cost their month alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from flysid.catalogue import FlightFacts
from flysid.errors import StoreError
from flysid.facts.vehicle import vehicle_of
from flysid.files import slug
from flysid.flight import message_of, stem_of
from flysid.ingest.lake.flighttable import Commit, facts_in, last_commit, rows_of, select
from flysid.manifest import MANIFEST_FILE, Manifest, parse_manifest
from flysid.mirror import GENERATION, home_of
from flysid.place import Place, StoredObject
from flysid.progress import tell

PARTS = "catalog/parts.json"
FOLDER = "streams"
ROWS_PER_GROUP = 1 << 18
OWN = ("flight", "vehicle", "stream")
"""Columns that a part has beside those of the flights' tables."""


class MonthPart(msgspec.Struct, frozen=True):
    """A parquet file with a message's rows of a month; `group` stands for all the flights of that month."""

    message: str
    month: str
    key: str
    rows: int
    size_bytes: int
    flights: tuple[str, ...]
    group: str


class Parts(msgspec.Struct, frozen=True):
    """All parts of a lake, and the catalogue's commit whose flights they hold."""

    commit: Commit = Commit()
    parts: tuple[MonthPart, ...] = ()


@dataclass(frozen=True)
class Compacted:
    """What a compaction did: groups of a message and a month that were written and that were as before."""

    written: int
    unchanged: int
    rows: int
    parts: int


def compact(place: Place, part_bytes: int = 128 << 20) -> Compacted:
    """Bring the parts of a lake up to its flights.

    Interrupted at any moment it leaves the parts that were there. Only one compaction runs at a time.
    Raises StoreError: a flight's table is damaged or gone. Raises PlaceError: no answer.
    """
    commit = last_commit(place)  # first: what is committed meanwhile waits for the next compaction
    flights = facts_in(select(place))
    before = _parts(place)
    present = {(part.message, part.month): part.group for part in before.parts}
    groups = _groups(flights)
    stale = {key for key, own in groups.items() if present.get(key) != _digest(own)}
    kept = [p for p in before.parts if (key := (p.message, p.month)) in groups and key not in stale]
    fresh: list[MonthPart] = []
    for number, key in enumerate(sorted(stale)):
        tell(f"compacting {key[0]}, {key[1] or 'without a date'}", share=number / len(stale))
        fresh += _write_group(place, key, groups[key], part_bytes)
    _list(place, Parts(commit, (*kept, *fresh)))
    rows = sum(part.rows for part in fresh)
    return Compacted(len(stale), len(groups) - len(stale), rows, len(kept) + len(fresh))


def files_of(place: Place, message: str, where: str = "") -> list[str]:
    """Addresses of the files with a message's rows: parts, and tables of flights that are in none.

    `where`: a condition in SQL on the flights; then the flights' own tables are named.
    """
    known = Parts() if where else _parts(place)
    parts = [part for part in known.parts if part.message == message]
    addresses = [place.at(part.key) for part in parts]
    if not where and last_commit(place, known.commit.version) == known.commit:
        return addresses
    covered = {digits for part in parts for digits in part.flights}
    rows = select(place, where, ("flight", "sha256", "streams", "stream_rows"))
    late = [n for n, digits in enumerate(rows["sha256"].to_pylist()) if digits not in covered]
    having = [n for n in late if _has(rows["streams"][n].as_py(), rows["stream_rows"][n].as_py(), message)]
    alone = sorted(rows["flight"][n].as_py() for n in having)
    tables = [
        place.at(f"{home}/{name}")
        for home, manifest in _manifests(place, alone)
        for name in _tables(manifest, message)
    ]
    return addresses + tables


def find_unreferenced(place: Place) -> list[StoredObject]:
    """Parts that the list of parts does not name."""
    named = {part.key for part in _parts(place).parts}
    return [found for found in place.list(FOLDER) if found.key not in named]


def _groups(flights: Sequence[FlightFacts]) -> dict[tuple[str, str], list[FlightFacts]]:
    groups: dict[tuple[str, str], list[FlightFacts]] = {}
    for facts, month in zip(flights, rows_of(flights)["month"].to_pylist(), strict=True):
        for message in sorted({_message(key) for key, rows in facts.streams.items() if rows}):
            groups.setdefault((message, month), []).append(facts)
    return groups


def _message(stream: str) -> str:
    """A message without its sender and its thing: all of them lie in one part, whose column names it."""
    return stem_of(message_of(stream))


def _has(streams: Sequence[str], rows: Sequence[int], message: str) -> bool:
    return any(_message(key) == message and count for key, count in zip(streams, rows, strict=True))


def _digest(flights: Sequence[FlightFacts]) -> str:
    known = sorted((f.sha256, f.info.get(GENERATION, "")) for f in flights)
    return hashlib.sha256(repr(known).encode()).hexdigest()[:16]


def _write_group(
    place: Place, key: tuple[str, str], flights: Sequence[FlightFacts], part_bytes: int
) -> Iterator[MonthPart]:
    """Parts of one message and month; a part for each set of columns, and more where it grows too large."""
    message, month = key
    group = _digest(flights)
    ordered = sorted(flights, key=lambda f: (vehicle_of(f.info), f.start_utc_ns or 0, f.id))
    with TemporaryDirectory(prefix="flysid-") as folder:
        writers: dict[bytes, _Writer] = {}
        done: list[_Writer] = []
        for facts, (home, manifest) in zip(ordered, _manifests(place, [f.id for f in ordered]), strict=True):
            for name in _tables(manifest, message):
                table = _with_owner(_table(place, f"{home}/{name}"), facts, manifest, name)
                columns = table.schema.serialize().to_pybytes()  # units and scales too: never mixed
                part = writers.get(columns)
                if part is None:
                    part = writers[columns] = _Writer(Path(folder) / f"{len(writers) + len(done)}.parquet")
                part.add(table, facts.sha256)
                if part.path.stat().st_size >= part_bytes:
                    part.close()
                    done.append(writers.pop(columns))
        for part in (*done, *writers.values()):
            part.close()
            digest = hashlib.sha256(part.path.read_bytes()).hexdigest()[:16]
            target = f"{FOLDER}/{slug(message)}/month={month or 'none'}/part-{digest}.parquet"
            place.put(target, part.path)
            size = part.path.stat().st_size
            yield MonthPart(message, month, target, part.rows, size, tuple(sorted(part.flights)), group)


class _Writer:
    """A parquet file that grows by the tables of flights, in row groups of many flights."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows = 0
        self.flights: set[str] = set()
        self._writer: pq.ParquetWriter | None = None
        self._waiting: list[pa.Table] = []
        path.touch()

    def add(self, table: pa.Table, flight: str) -> None:
        self._waiting.append(table)
        self.flights.add(flight)
        self.rows += table.num_rows
        if sum(waiting.num_rows for waiting in self._waiting) >= ROWS_PER_GROUP:
            self._flush()

    def close(self) -> None:
        if self._waiting:
            self._flush()
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _flush(self) -> None:
        table = pa.concat_tables(self._waiting)
        self._waiting = []
        if self._writer is None:
            self._writer = pq.ParquetWriter(
                self.path, table.schema, compression="zstd", write_page_index=True
            )
        self._writer.write_table(table, row_group_size=ROWS_PER_GROUP)


def _with_owner(table: pa.Table, facts: FlightFacts, manifest: Manifest, name: str) -> pa.Table:
    """The table with columns for the owner of each row, without the flight's own notes on columns."""
    stream = next(entry.stream for entry in manifest.streams if name.endswith(f"/{entry.file}"))
    values = {"flight": facts.id, "vehicle": vehicle_of(facts.info), "stream": stream}
    for column in reversed(OWN):
        constant = pa.array([values[column]] * table.num_rows, pa.string())
        table = table.add_column(0, column, constant)
    return table.replace_schema_metadata(None)


def _manifests(place: Place, flights: Sequence[str]) -> Iterator[tuple[str, Manifest]]:
    homes = [home_of(flight.rpartition("-")[2]) for flight in flights]
    keys = [f"{home}/{MANIFEST_FILE}" for home in homes]
    for home, (key, text) in zip(homes, place.read_many(keys), strict=True):
        if text is None:
            raise StoreError(
                "a flight of the catalogue is gone", path=place.at(key), hint="flysid fleet check"
            )
        yield home, parse_manifest(text, place.at(key))


def _tables(manifest: Manifest, message: str) -> list[str]:
    """Tables of a message, relative to the flight's home."""
    generation = manifest.info.get(GENERATION, "")
    return [f"{generation}/{e.file}" for e in manifest.streams if _message(e.stream) == message and e.rows]


def _table(place: Place, key: str) -> pa.Table:
    try:
        return pq.read_table(pa.BufferReader(place.read(key)))
    except (FileNotFoundError, pa.ArrowException) as error:
        raise StoreError(
            f"damaged or missing: {error}", path=place.at(key), hint="flysid fleet check; ingest it again"
        ) from error


def _parts(place: Place) -> Parts:
    content = place.read_if_there(PARTS)
    if content is None:
        return Parts()
    try:
        return msgspec.json.decode(content, type=Parts)
    except msgspec.DecodeError as error:
        raise StoreError(
            f"damaged: {error}", path=place.at(PARTS), hint="delete it, then: flysid fleet compact"
        ) from error


def _list(place: Place, parts: Parts) -> None:
    place.put(PARTS, msgspec.json.encode(parts))
