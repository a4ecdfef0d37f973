"""A flight from a scratch folder into a lake: tables first, then the manifest, which one writer can create.

The names of the tables follow from their bytes: equal logs read by equal versions give equal objects, so
that two writers at once overwrite each other with the same. Another version's tables have another generation
beside them, and the manifest names the one that counts.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from flysid.catalogue import FlightFacts, facts_of
from flysid.files import slug
from flysid.manifest import MANIFEST_FILE, Manifest, content_stamp, parse_manifest, read_manifest, to_json
from flysid.mirror import GENERATION, home_of
from flysid.place import Place

DIGITS = (16, 64)
"""Of a hash in a flight's id: all of them where another log has the first."""


@dataclass(frozen=True)
class Published:
    """A flight of the lake, and whether it was this writer who committed it."""

    facts: FlightFacts
    is_new: bool


def find_committed(place: Place, sha256: str) -> FlightFacts | None:
    """The flight of a log with this hash, if the lake has it."""
    for digits in DIGITS:
        key = f"{home_of(sha256[:digits])}/{MANIFEST_FILE}"
        text = place.read_if_there(key)
        if text is None:
            return None
        manifest = parse_manifest(text, place.at(key))
        if manifest.source.sha256 == sha256:
            return facts_of(manifest, content_stamp(text))
    return None


def publish(place: Place, folder: Path, info: Mapping[str, str], *, replace: bool = False) -> Published:
    """Put a flight that lies in a scratch folder into a lake.

    `folder`: the flight's: tables and manifest.
    `info`: more facts for the manifest, such as the log's address.
    `replace`: put it in the place of a flight of the same log.
    Raises PlaceError: the store does not answer. Nothing is visible then.
    """
    manifest = read_manifest(folder)
    files = [entry.file for entry in manifest.streams]
    generation = _generation(folder, files)
    for digits in DIGITS:
        home = home_of(manifest.source.sha256[:digits])
        place.put_many([(f"{home}/{generation}/{file}", folder / file) for file in files])
        own = _name(manifest, digits, dict(info) | {GENERATION: generation})
        text = to_json(own)
        key = f"{home}/{MANIFEST_FILE}"
        if place.create(key, text):
            return Published(facts_of(own, content_stamp(text)), is_new=True)
        there, tag = place.read_tagged(key)
        theirs = parse_manifest(there, place.at(key))
        if theirs.source.sha256 != own.source.sha256:
            continue
        if replace and there != text and place.replace(key, text, tag):
            return Published(facts_of(own, content_stamp(text)), is_new=True)
        if replace and there != text:  # another writer was faster, and has read the same log again
            theirs = parse_manifest(there := place.read(key), place.at(key))
        return Published(facts_of(theirs, content_stamp(there)), is_new=False)
    raise AssertionError("two logs have one sha256")


def _generation(folder: Path, files: list[str]) -> str:
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(name.encode() + b"\0")
        with (folder / name).open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()[:12]


def _name(manifest: Manifest, digits: int, info: Mapping[str, str]) -> Manifest:
    import msgspec

    name = f"{slug(Path(manifest.source.name).stem)}-{manifest.source.sha256[:digits]}"
    return msgspec.structs.replace(manifest, id=name, info=dict(manifest.info) | dict(info))
