"""Remove flights from a lake for good: objects, rows, parts and the catalogue's history."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from flysid.catalogue import FlightFacts
from flysid.fleet.compaction import PARTS, compact, find_unreferenced
from flysid.fleet.lakes import DUPLICATES, QUARANTINE
from flysid.ingest.lake.flighttable import TABLE, open_table, remove
from flysid.manifest import MANIFEST_FILE
from flysid.mirror import home_of
from flysid.place import Place
from flysid.progress import tell


@dataclass(frozen=True)
class Forgotten:
    """What was removed, and where the logs still are: `sources` are addresses that this does not touch."""

    flights: int
    objects: int
    sources: tuple[str, ...]


def forget(place: Place, flights: Sequence[FlightFacts]) -> Forgotten:
    """Remove flights from a lake; it may be interrupted and done again.

    Manifests go first: a flight without one is there for nobody. The catalogue is written anew without its
    history, which holds names in its statistics.
    """
    homes = [home_of(facts.id.rpartition("-")[2]) for facts in flights]
    hashes = {facts.sha256 for facts in flights}
    sources = tuple(sorted({url for facts in flights if (url := facts.info.get("source_url", ""))}))
    tell("removing flights")
    place.delete(f"{home}/{MANIFEST_FILE}" for home in homes)
    keys = [found.key for home in homes for found in place.list(home)]
    names = [*hashes, *(facts.id for facts in flights), *sources]
    notes = [found.key for folder in (DUPLICATES, QUARANTINE) for found in place.list(folder)]
    keys += [key for key, text in place.read_many(notes) if text and _names_one(text, names)]
    place.delete(keys)
    tell("writing the catalogue anew")
    remove(place, sorted(hashes))
    if place.head(PARTS) is not None:
        compact(place)
        old = [found.key for found in find_unreferenced(place)]
        place.delete(old)
        keys += old
    keys += _without_history(place)
    return Forgotten(len(flights), len(keys) + len(homes), sources)


def _names_one(text: bytes, names: Sequence[str]) -> bool:
    return any(name.encode() in text for name in names)


def _without_history(place: Place) -> list[str]:
    """Remove the catalogue's former files and log; returns the keys that are gone."""
    table = open_table(place)
    if table is None:
        return []
    removed = table.vacuum(retention_hours=0, enforce_retention_duration=False, dry_run=False, full=True)
    table = open_table(place)
    table.create_checkpoint()
    version = table.version()
    log = re.compile(rf"{re.escape(TABLE)}/_delta_log/(\d+)\.(json|checkpoint\.parquet)")
    old = [
        found.key
        for found in place.list(f"{TABLE}/_delta_log")
        if (entry := log.fullmatch(found.key)) and int(entry[1]) < version
    ]
    place.delete(old)
    return [*removed, *old]
