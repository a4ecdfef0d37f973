"""Whether a lake is whole: manifests, their tables, the catalogue, and what nobody refers to.

The manifests are the truth. What differs from them is put right: rows are made again, objects that belong to
no flight are removed once they are old enough not to be somebody's work right now.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from flysid.catalogue import FlightFacts, facts_of
from flysid.errors import StoreError
from flysid.fleet.compaction import find_unreferenced
from flysid.ingest.lake.flighttable import facts_in, rebuild, select
from flysid.manifest import MANIFEST_FILE, Manifest, content_stamp, parse_manifest
from flysid.mirror import GENERATION
from flysid.place import Place, StoredObject
from flysid.progress import tell


@dataclass(frozen=True)
class LakeState:
    """What a lake holds, and what is wrong with it.

    `flights`: of all manifests.
    `damaged`: manifests that cannot be read: address -> why.
    `missing`: tables that a manifest names and nobody has.
    `twice`: hashes of logs that have more than one flight.
    `unlisted`, `stale`: flights that the catalogue lacks, or has as they are not; rows without a flight.
    `orphans`: objects that belong to no flight, with their age.
    """

    flights: tuple[FlightFacts, ...]
    damaged: dict[str, str]
    missing: tuple[str, ...]
    twice: tuple[str, ...]
    unlisted: tuple[str, ...]
    stale: tuple[str, ...]
    orphans: tuple[StoredObject, ...]

    @property
    def is_whole(self) -> bool:
        """Every flight has its tables and its row, and there is nothing else."""
        return not (self.damaged or self.missing or self.twice or self.unlisted or self.stale or self.orphans)

    def orphans_older(self, age: timedelta) -> tuple[StoredObject, ...]:
        """Those that nobody can be at any more."""
        now = datetime.now(UTC)
        return tuple(found for found in self.orphans if now - found.modified >= age)


def check(place: Place) -> LakeState:
    """List a lake, read its manifests, and compare them with its objects and its catalogue."""
    tell("listing objects")
    objects = {found.key: found for found in place.list("flights")}
    keys = [key for key in objects if key.endswith(f"/{MANIFEST_FILE}")]
    tell("reading manifests")
    damaged: dict[str, str] = {}
    facts: list[FlightFacts] = []
    missing: list[str] = []
    owned = set(keys)
    for key, manifest, text in _manifests(place, keys, damaged):
        facts.append(facts_of(manifest, content_stamp(text)))
        tables = list(_tables(key, manifest))
        owned.update(tables)
        missing += [place.at(table) for table in tables if table not in objects]
    listed = {row.sha256: row for row in facts_in(select(place))}
    there = {row.sha256: row for row in facts}
    times = Counter(row.sha256 for row in facts)
    return LakeState(
        flights=tuple(sorted(facts, key=lambda row: row.id)),
        damaged=damaged,
        missing=tuple(missing),
        twice=tuple(digits for digits, count in times.items() if count > 1),
        unlisted=tuple(row.id for digits, row in there.items() if digits not in listed),
        stale=tuple(
            row.id
            for digits, row in listed.items()
            if digits not in there or there[digits].stamp != row.stamp
        ),
        orphans=(
            *(found for key, found in objects.items() if key not in owned),
            *find_unreferenced(place),
        ),
    )


def repair(place: Place, state: LakeState, age: timedelta) -> int:
    """Make the catalogue again where it differs, and remove orphans of this age; returns how many."""
    if state.unlisted or state.stale:
        rebuild(place, state.flights)
    old = state.orphans_older(age)
    place.delete(found.key for found in old)
    return len(old)


def _manifests(
    place: Place, keys: list[str], damaged: dict[str, str]
) -> Iterator[tuple[str, Manifest, bytes]]:
    for key, text in place.read_many(keys):
        if text is None:
            continue  # forgotten meanwhile
        try:
            yield key, parse_manifest(text, place.at(key)), text
        except StoreError as error:
            damaged[place.at(key)] = error.message


def _tables(key: str, manifest: Manifest) -> Iterator[str]:
    """Keys of the tables that a manifest names."""
    home = key.removesuffix(f"/{MANIFEST_FILE}")
    generation = manifest.info.get(GENERATION, "")
    return (f"{home}/{generation}/{entry.file}" for entry in manifest.streams)
