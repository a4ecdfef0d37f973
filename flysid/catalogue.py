"""What is known of every flight of a folder, without opening them one by one.

The catalogue is one file beside the flights. It is an index, never the truth: every entry carries the size
and time of its flight's manifest and is made again where these differ. A catalogue that is missing, damaged
or of another version is made anew from the manifests.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import msgspec

from flysid.errors import StoreError
from flysid.facts.losses import lost_words
from flysid.files import write_atomically
from flysid.flight import message_of
from flysid.foreign import inner_path
from flysid.manifest import FLIGHTS, Manifest, Stamp, check_data_folder, read_manifest, stamps

CATALOGUE_FILE = ".catalogue"
CATALOGUE_VERSION = 2


class FlightFacts(msgspec.Struct, frozen=True, array_like=True):
    """A flight in the catalogue.

    `id`: the flight's.
    `log`, `format`, `size_bytes`, `sha256`: of the log that it came from.
    `flysid`: the version that wrote it.
    `duration_s`: vehicle time, summed over boots.
    `rows`: of all streams.
    `lossy`: the log held something that could not be kept.
    `start_utc_ns`: when its first boot that is anchored to UTC began; None where none is.
    `info`: facts about the vehicle.
    `streams`: key -> rows.
    `layout`: digest of the filled streams' keys and columns, and of which of several of one message has most
        rows: recipes find the same sources in all flights of one layout.
    `stamp`: of the manifest that this was read from.
    `losses`: what the log lacks, in words, also what was lost before it was written; "" where nothing is.
    """

    id: str
    log: str
    format: str
    size_bytes: int
    sha256: str
    flysid: str
    duration_s: float
    rows: int
    lossy: bool
    start_utc_ns: int | None
    info: Mapping[str, str]
    streams: Mapping[str, int]
    layout: str
    stamp: Stamp
    losses: str = ""

    @property
    def lost(self) -> bool:
        """Whether the log lacks anything."""
        return self.lossy or bool(self.losses)

    @property
    def lacks(self) -> str:
        """What the log lacks, in words; tables of older versions know only that it lacks something."""
        return self.losses or ("something was lost" if self.lossy else "")


class _Catalogue(msgspec.Struct, frozen=True, array_like=True):
    version: int
    flights: tuple[FlightFacts, ...]


def catalogue(data: str | Path) -> tuple[FlightFacts, ...]:
    """All flights of an ingested folder, by id.

    Manifests are read only where the catalogue does not know them; it is then written anew, where that is
    allowed. Raises UsageError, StoreError: as `check_data_folder` and `read_manifest`.
    """
    data = check_data_folder(data)
    known = {facts.id: facts for facts in _read(data / CATALOGUE_FILE)}
    present = stamps(data)
    found = tuple(
        facts
        if (facts := known.get(name)) is not None and facts.stamp == present[name]
        else facts_of(read_manifest(data / FLIGHTS / name), present[name])
        for name in sorted(present)
    )
    if len(known) != len(found) or any(known.get(facts.id) is not facts for facts in found):
        with suppress(OSError):  # a folder that cannot be written to is read without
            write_atomically(
                data / CATALOGUE_FILE, msgspec.msgpack.encode(_Catalogue(CATALOGUE_VERSION, found))
            )
    return found


def facts_of(manifest: Manifest, stamp: Stamp) -> FlightFacts:
    """What the catalogue holds of a flight."""
    starts = [c.began_utc_ns for c in manifest.clocks if c.began_utc_ns is not None]
    filled = [s for s in manifest.streams if s.rows]
    filled.sort(key=lambda s: (message_of(s.stream), -s.rows, s.stream))
    layout = [(s.stream, [c.name for c in s.columns]) for s in filled]
    return FlightFacts(
        id=manifest.id,
        log=manifest.source.name,
        format=manifest.source.format,
        size_bytes=manifest.source.size_bytes,
        sha256=manifest.source.sha256,
        flysid=manifest.flysid,
        duration_s=manifest.duration_s,
        rows=manifest.rows,
        lossy=manifest.damage.lossy,
        start_utc_ns=round(starts[0]) if starts else None,
        info=manifest.info,
        streams={s.stream: s.rows for s in manifest.streams},
        layout=hashlib.sha256(msgspec.msgpack.encode(layout)).hexdigest()[:16],
        stamp=stamp,
        losses=lost_words(manifest.damage),
    )


def _read(path: Path) -> tuple[FlightFacts, ...]:
    try:
        inner = inner_path(path.parent, path.name, path)
        stored = msgspec.msgpack.decode(inner.read_bytes(), type=_Catalogue)
    except (OSError, StoreError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return ()
    return stored.flights if stored.version == CATALOGUE_VERSION else ()
