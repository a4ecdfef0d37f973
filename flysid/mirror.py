"""The part of a lake in an object store that has been read, as a data folder on this machine.

A mirror is an ordinary data folder in the user's cache with a file that names what it mirrors. A manifest or
a table that is not there yet is fetched when it is first read, whole; so everything that reads data folders
reads lakes, and the second reading costs nothing. It may be removed at any time.

What lies where in a lake follows from the flight's hash alone:

    flights/<first 2 digits>/<digits>/manifest.json            the commit
    flights/<first 2 digits>/<digits>/<generation>/<stream>.parquet
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import threading
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from pathlib import Path

from flysid.errors import StoreError
from flysid.files import slug, write_atomically, writing_to
from flysid.foreign import inner_path
from flysid.place import Place, StoredObject

MARKER = ".mirror"
GENERATION = "generation"
"""The fact of a manifest that names the folder of its tables."""

_FLIGHT = re.compile(r".*-([0-9a-f]{16}|[0-9a-f]{64})")


def folder_for(address: str) -> Path:
    """Where a lake is mirrored, whether or not it is yet."""
    name = f"{slug(address.partition('://')[2])}-{hashlib.sha256(address.encode()).hexdigest()[:12]}"
    return _cache() / "lakes" / name


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "flysid"


Beside = Callable[[str, Callable[[], Collection[str]]], Sequence[str]]
"""Names of the files that a log is read with, by its own name; the second argument lists its folder."""


def copy_of(place: Place, found: StoredObject, beside: Beside) -> Path:
    """An object of a folder as a file of the cache; fetched where this content of it is not there yet.

    `beside`: other objects that it is read with come with it, where they are there.
    """
    sides = {name: side for name in beside(found.key, place.names) if (side := place.head(name))}
    facts = "\0".join(f"{place.at(o.key)}\0{o.etag}\0{o.size}" for o in (found, *sides.values()))
    digest = hashlib.sha256(facts.encode()).hexdigest()[:16]
    path = _cache() / "logs" / digest / slug(str(place).rpartition("/")[2]) / slug(found.key)
    with writing_to(path):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    for name, side in sides.items():
        behind = name.removeprefix(found.key)
        _bring_once(place, side.key, path.with_name(slug(name) if behind == name else path.name + behind))
    _bring_once(place, found.key, path)
    return path


def log_at(place: Place, beside: Beside) -> Path | None:
    """The log at an address, or the member of an archive there, as a path of the cache; None for nothing.

    `beside`: see `copy_of`.
    """
    scheme, _, rest = str(place).partition("://")
    bucket, *parts = rest.split("/")
    for count in range(len(parts), 0, -1):
        folder = Place("/".join((f"{scheme}://{bucket}", *parts[: count - 1])))
        if found := folder.head(parts[count - 1]):
            return copy_of(folder, found, beside).joinpath(*parts[count:])
    return None


def mark(data: Path, address: str) -> None:
    """Say that a data folder mirrors a lake."""
    if address_of(data) != address:
        with writing_to(data):
            data.chmod(0o700)
            write_atomically(data / MARKER, address.encode())


def address_of(data: Path) -> str:
    """The lake that a data folder mirrors; "" where it is a folder of its own.

    Only a folder of the user's cache mirrors one: a stranger's could name an address to be connected to.
    """
    try:
        address = inner_path(data, MARKER, data).read_text("utf-8")
        return address if data.samefile(folder_for(address)) else ""
    except (OSError, ValueError, StoreError):
        return ""


def home_of(sha256: str) -> str:
    """Where a lake keeps a flight, by 16 or 64 digits of its log's hash."""
    return f"flights/{sha256[:2]}/{sha256}"


def fetch(path: Path) -> Path:
    """`path`, a file of a flight's folder; fetched first where its data folder is a mirror that lacks it."""
    if path.exists() or not (address := address_of(path.parents[2])):
        return path
    digits = _FLIGHT.fullmatch(path.parent.name)
    if digits is None:
        return path
    home = home_of(digits[1])
    manifest = path.parent / "manifest.json"
    key = f"{home}/{path.name}"
    if path != manifest:
        key = f"{home}/{_generation(fetch(manifest))}/{path.name}"
    with writing_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileNotFoundError):  # whoever reads it names what is missing
        _bring(Place(address), key, path)
    return path


def _bring_once(place: Place, key: str, path: Path) -> None:
    if not path.exists():
        _bring(place, key, path)


def _bring(place: Place, key: str, path: Path) -> None:
    arriving = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}")
    try:
        place.fetch(key, arriving)
        arriving.replace(path)
    finally:
        arriving.unlink(missing_ok=True)


def forget(data: Path, flight: str) -> None:
    """Remove what has been fetched of a flight."""
    shutil.rmtree(data / "flights" / flight, ignore_errors=True)


def _generation(manifest: Path) -> str:
    try:
        generation = json.loads(manifest.read_bytes())["info"][GENERATION]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoreError("damaged manifest: it does not say where its tables are", path=manifest) from error
    if not re.fullmatch(r"[0-9a-f]+", str(generation)):
        raise StoreError(f"damaged manifest: {generation!r} is no generation", path=manifest)
    return str(generation)
