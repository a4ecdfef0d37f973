"""Ingest many logs into a lake: find them, drop those it has, read the rest, add them to the catalogue.

At-least-once tasks and a commit that one writer can make are together exactly once: whatever is killed, the
same command goes on where it was. Workers never write the catalogue; what is missing there after a kill is
found again by its hash, or by `flysid fleet check --repair`.
"""

from __future__ import annotations

import fnmatch
import os
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Protocol

from flysid.catalogue import FlightFacts
from flysid.errors import FormatError, UsageError
from flysid.fleet.lakes import DUPLICATES, QUARANTINE, create_lake
from flysid.fleet.reading import TOGETHER, LogAddress, LogOutcome, Settings, ingest_batch
from flysid.ingest.formats.base import HEAD_BYTES
from flysid.ingest.formats.blame import blaming
from flysid.ingest.formats.opening import is_archive, unpacked_head
from flysid.ingest.formats.recordings.names import METADATA, companies
from flysid.ingest.formats.rosbag2.side_files import READ, names_beside
from flysid.ingest.lake.finding import GLOB_MARKS, LOG, Found, find_logs, judge_head, judge_name, part_of
from flysid.ingest.lake.flighttable import merge, select
from flysid.ingest.lake.workers import Bounds
from flysid.manifest import DATA_FILE
from flysid.place import Place, StoredObject, is_address
from flysid.progress import tell
from flysid.version import __version__


@dataclass(frozen=True)
class Sorted:
    """The logs of an ingest.

    `waiting`: to be read, the largest first.
    `known`: how many the lake has, or has as a duplicate.
    `quarantined`: how many this version could not read before.
    `passed_over`: what is no log, by name or by its first bytes.
    `unread`: what may be a log and cannot be read, and why.
    """

    waiting: tuple[LogAddress, ...]
    known: int = 0
    quarantined: int = 0
    passed_over: tuple[str, ...] = ()
    unread: tuple[tuple[str, str], ...] = ()


class Engine(Protocol):
    """Who does the tasks: threads here, or a cluster."""

    @property
    def workers(self) -> int: ...

    def run(
        self, batches: Sequence[tuple[LogAddress, ...]], settings: Settings
    ) -> Iterator[tuple[tuple[LogAddress, ...], list[LogOutcome]]]:
        """Each batch with what became of its logs, as they finish."""
        ...


# ------------------------------------------------------------------------------------------ finding


def find(
    given: Sequence[str],
    lake: str,
    since: datetime | None = None,
    retry: bool = False,
    force: bool = False,
    bounds: Bounds | None = None,
) -> Sorted:
    """The logs that addresses and paths name, less those that the lake knows.

    An address is an object, a folder or a pattern; its objects are listed, a thousand a request. Where their
    names do not tell, their first bytes do, as of files on this machine. Archives count as one log until
    they are read; logs on this machine are sorted out later, by their hashes.

    `since`: only objects that arrived at this moment or later.
    `retry`: those in quarantine, too.
    `force`: all of them, whatever the lake knows.
    `bounds`: of memory and time for looking into one file of this machine; see `find_logs`.
    Raises UsageError: nothing there is a log.
    """
    addresses = [item for item in given if is_address(item)]
    paths = [item for item in given if not is_address(item)]
    found: dict[str, LogAddress] = {}
    passed: list[str] = []
    unread: list[tuple[str, str]] = []
    for address in addresses:
        objects = _list_objects(address, since)
        for one, kind in _judge(objects):
            log = _log_of(objects, one)
            if kind.paths:
                found[log.url] = log
            unread += [(log.url, item.reason) for item in kind.unread.values()]
            passed += [log.url] * len(kind.passed_over)
    if paths:
        here = find_logs(paths, bounds)
        passed += [str(item.path) for item in here.passed_over]
        unread += [(str(item.path), item.reason) for item in here.unread]
        for path in here.paths:
            found[str(path)] = LogAddress(os.path.abspath(path), path.stat().st_size if path.is_file() else 0)
    if not found and not passed and not unread and since is None:
        raise UsageError("no flight log in there", path=", ".join(given))
    place = Place(lake)
    known = frozenset[tuple[str, str]]() if force else _known(place)
    duplicates = frozenset[str]() if force else _read_notes(place, DUPLICATES)
    bad = frozenset[str]() if retry or force else _read_notes(place, f"{QUARANTINE}/{__version__}")
    fresh = [
        log for log in found.values() if (log.url, log.etag) not in known and log.digest not in duplicates
    ]
    waiting = sorted((log for log in fresh if log.digest not in bad), key=lambda log: (-log.size, log.url))
    return Sorted(
        tuple(waiting), len(found) - len(fresh), len(fresh) - len(waiting), tuple(passed), tuple(unread)
    )


@dataclass(frozen=True)
class _Objects:
    """A bucket, the objects in it that are meant, and all that lie where they do, by key.

    `together` has the keys of files that may be one recording, by the key of each.
    """

    place: Place
    meant: list[StoredObject]
    there: Mapping[str, StoredObject]

    @cached_property
    def together(self) -> Mapping[str, tuple[str, ...]]:
        folders: dict[str, list[str]] = {}
        for key in self.there:
            folder, slash, name = key.rpartition("/")
            folders.setdefault(folder + slash, []).append(name)
        found: dict[str, tuple[str, ...]] = {}
        meant = {one.key for one in self.meant}
        for folder, names in folders.items():
            for group in companies(names):
                ordered = sorted(group, key=lambda name: (name == METADATA, folder + name not in meant))
                keys = tuple(folder + name for name in ordered)
                found |= dict.fromkeys(keys, keys)
        return found


def _list_objects(address: str, since: datetime | None) -> _Objects:
    """Objects that an address names: one, those below a folder, those that fit a pattern."""
    scheme, _, rest = address.partition("://")
    bucket, _, key = rest.partition("/")
    place = Place(f"{scheme}://{bucket}")
    fixed = key[: min((key.find(mark) for mark in GLOB_MARKS if mark in key), default=len(key))]
    pattern = key if fixed != key else ""
    folder = key.rstrip("/") if not pattern else fixed.rpartition("/")[0]
    exact = place.head(key) if key and not pattern and not key.endswith("/") else None
    every = [exact, *_beside(place, exact)] if exact else list(place.list(folder))
    lakes = tuple(f.key.removesuffix(DATA_FILE) for f in every if f"/{f.key}".endswith(f"/{DATA_FILE}"))
    named = [exact] if exact else every
    meant = [f for f in named if _is_meant(f, pattern, since) and not f.key.startswith(lakes)]
    return _Objects(place, meant, {found.key: found for found in every})


def _beside(place: Place, found: StoredObject) -> list[StoredObject]:
    """The objects that one is read with."""
    folder, slash, name = found.key.rpartition("/")
    names = names_beside(name, lambda: place.names(folder))
    return [side for other in names if (side := place.head(f"{folder}{slash}{other}"))]


def _judge(objects: _Objects) -> Iterator[tuple[StoredObject, Found]]:
    """What each object is, by its name or, where that does not tell, by its first bytes."""
    unknown: list[StoredObject] = []
    for one in objects.meant:
        first = objects.together.get(one.key, (one.key,))[0]
        if first != one.key:
            continue
        if one.key in objects.together:
            yield one, Found({Path(one.key): None})
        elif kind := part_of(one.key, objects.there) or judge_name(one.key.rpartition("/")[2]):
            found = Found()
            found.sort_in(Path(one.key), kind)
            yield one, found
        else:
            unknown.append(one)
    for one, head in zip(unknown, objects.place.read_beginnings(unknown, HEAD_BYTES), strict=True):
        yield one, _judge_bytes(Path(one.key), head)


def _judge_bytes(path: Path, head: bytes) -> Found:
    """An object by its first bytes; an archive counts as a log until it is read."""
    found = Found()
    try:
        with blaming():
            if is_archive(head):
                found.sort_in(path, LOG)
            else:
                judge_head(found, path, *unpacked_head(path.name, head))
    except FormatError as error:
        found.fail(path, error.advice)
    return found


def _log_of(objects: _Objects, one: StoredObject) -> LogAddress:
    """An object as a log; it is another log once what it is read with is another."""
    files = objects.together.get(one.key, (one.key,))
    keys = [key for file in files for suffix in ("", *READ) if (key := file + suffix) in objects.there]
    etag = " ".join(objects.there[key].etag for key in keys)
    size = sum(objects.there[file].size for file in files)
    names = tuple(file.rpartition("/")[2] for file in files[1:])
    return LogAddress(objects.place.at(one.key), size, (TOGETHER if names else "") + etag, names)


def _is_meant(found: StoredObject, pattern: str, since: datetime | None) -> bool:
    is_hidden = found.key.rpartition("/")[2].startswith(".")
    fits = not pattern or fnmatch.fnmatchcase(found.key, pattern)
    return fits and not is_hidden and found.size > 0 and (since is None or found.modified >= since)


def _known(place: Place) -> frozenset[tuple[str, str]]:
    """Address and tag of every log that the catalogue has."""
    rows = select(place, columns=("source_url", "source_etag"))
    pairs = zip(rows["source_url"].to_pylist(), rows["source_etag"].to_pylist(), strict=True)
    return frozenset(pair for pair in pairs if pair[0])


def _read_notes(place: Place, folder: str) -> frozenset[str]:
    return frozenset(Path(found.key).stem for found in place.list(folder))


# ------------------------------------------------------------------------------------------ ingesting


def ingest(
    logs: Sorted, settings: Settings, engine: Engine, batch: int = 32, *, commit_s: float = 10.0
) -> Iterator[LogOutcome]:
    """Ingest logs into a lake; yields what became of each, as batches finish.

    The catalogue is written every few seconds, and at the end, however it comes.

    `commit_s`: between two commits of the catalogue; longer where a commit itself takes long.

    Raises
    ------
    UsageError : the store refuses. PlaceError : the engine is gone, or the catalogue cannot be written.
    """
    place = create_lake(settings.lake)
    batches = batched(logs.waiting, batch, engine.workers)
    total = sum(log.size for log in logs.waiting) or 1
    read = 0
    fresh: list[FlightFacts] = []
    due = time.monotonic() + commit_s
    try:
        for part, outcomes in engine.run(batches, settings):
            read += sum(log.size for log in part)
            for outcome in outcomes:
                tell(outcome.status, log=outcome.log.name, share=read / total)
                if outcome.facts is not None:
                    fresh.append(outcome.facts)
                yield outcome
            if time.monotonic() > due:
                began = time.monotonic()
                merge(place, _once(fresh))
                fresh.clear()
                due = time.monotonic() + max(commit_s, 20.0 * (time.monotonic() - began))
    finally:
        merge(place, _once(fresh))


def _once(flights: Iterable[FlightFacts]) -> list[FlightFacts]:
    """Each flight once, as it was seen last: a row can be merged once only."""
    return list({facts.sha256: facts for facts in flights}.values())


def batched(
    logs: Sequence[LogAddress], most: int, workers: int, *, most_bytes: int = 64 << 20, shares: int = 4
) -> list[tuple[LogAddress, ...]]:
    """Logs in batches of at most `most` and about 64 MB; of few logs, some for every worker.

    `shares`: tasks that a worker gets at least, where there are logs enough: the last one is then short.
    """
    most = max(1, min(most, len(logs) // (shares * workers)))
    batches: list[tuple[LogAddress, ...]] = []
    batch: list[LogAddress] = []
    size = 0
    for log in logs:
        if batch and (len(batch) >= most or size + log.size > most_bytes):
            batches.append(tuple(batch))
            batch = []
            size = 0
        batch.append(log)
        size += log.size
    return [*batches, tuple(batch)] if batch else batches


@dataclass(frozen=True)
class Threads:
    """An engine on this machine: a thread and a child process for each worker."""

    workers: int

    def run(
        self, batches: Sequence[tuple[LogAddress, ...]], settings: Settings
    ) -> Iterator[tuple[tuple[LogAddress, ...], list[LogOutcome]]]:
        """See `Engine`."""
        stopped = threading.Event()
        with ThreadPoolExecutor(self.workers) as pool:
            try:
                tasks = {pool.submit(ingest_batch, part, settings, stopped.is_set): part for part in batches}
                yield from as_they_finish(tasks)
            finally:
                stopped.set()
                pool.shutdown(wait=False, cancel_futures=True)


Tasks = dict["Future[list[LogOutcome]]", tuple[LogAddress, ...]]


def as_they_finish(tasks: Tasks) -> Iterator[tuple[tuple[LogAddress, ...], list[LogOutcome]]]:
    """Batches with their outcomes."""
    waiting = set(tasks)
    while waiting:
        done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        for task in done:
            yield tasks.pop(task), task.result()
