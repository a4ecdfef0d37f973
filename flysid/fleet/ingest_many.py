"""Many logs into a lake: found, sorted out against the catalogue, read by an engine, entered into it.

At-least-once tasks and a commit that one writer can make are together exactly once: whatever is killed, the
same command goes on where it was. Workers never write the catalogue; what is missing there after a kill is
found again by its hash, or by `flysid fleet check --repair`.
"""

from __future__ import annotations

import fnmatch
import os
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Protocol

from flysid.catalogue import FlightFacts
from flysid.errors import UsageError
from flysid.fleet.lakes import DUPLICATES, QUARANTINE, create_lake
from flysid.fleet.reading import Log, LogOutcome, Settings, ingest_batch
from flysid.ingest.formats.opening import own_name
from flysid.ingest.formats.registry import known_suffixes
from flysid.ingest.lake.finding import GLOB_MARKS, find_logs
from flysid.ingest.lake.flighttable import merge, select
from flysid.manifest import DATA_FILE
from flysid.place import Place, StoredObject, is_address
from flysid.progress import tell
from flysid.version import __version__


@dataclass(frozen=True)
class Sorted:
    """The logs of an ingest.

    Attributes
    ----------
    waiting : to be read, the largest first.
    known : how many the lake has, or has as a duplicate.
    quarantined : how many this version could not read before.
    passed_over : files that no reader knows by their names.
    """

    waiting: tuple[Log, ...]
    known: int = 0
    quarantined: int = 0
    passed_over: tuple[str, ...] = ()


class Engine(Protocol):
    """Who does the tasks: threads here, or a cluster."""

    @property
    def workers(self) -> int: ...

    def run(
        self, batches: Sequence[tuple[Log, ...]], settings: Settings
    ) -> Iterator[tuple[tuple[Log, ...], list[LogOutcome]]]:
        """Each batch with what became of its logs, as they finish."""
        ...


# ------------------------------------------------------------------------------------------ finding


def find(
    given: Sequence[str], lake: str, since: datetime | None = None, retry: bool = False, force: bool = False
) -> Sorted:
    """The logs that addresses and paths name, less those that the lake knows.

    An address is an object, a folder or a pattern; its objects are listed, a thousand a request, and none is
    read. Logs on this machine are sorted out later, by their hashes.

    Parameters
    ----------
    since : only objects that arrived at this moment or later.
    retry : those in quarantine, too.
    force : all of them, whatever the lake knows.

    Raises
    ------
    UsageError : nothing there is a log.
    """
    addresses = [item for item in given if is_address(item)]
    paths = [item for item in given if not is_address(item)]
    found: dict[str, Log] = {}
    passed: list[str] = []
    for address in addresses:
        for log in _list_logs(address, since):
            if _is_log(log.name):
                found[log.url] = log
            else:
                passed.append(log.url)
    if paths:
        here = find_logs(paths)
        passed += [str(item.path) for item in here.passed_over]
        for path in here.paths:
            found[str(path)] = Log(os.path.abspath(path), path.stat().st_size if path.is_file() else 0)
    if not found and not passed and since is None:
        raise UsageError("no flight log in there", path=", ".join(given))
    place = Place(lake)
    known = frozenset[tuple[str, str]]() if force else _known(place)
    duplicates = frozenset[str]() if force else _read_notes(place, DUPLICATES)
    bad = frozenset[str]() if retry or force else _read_notes(place, f"{QUARANTINE}/{__version__}")
    fresh = [
        log for log in found.values() if (log.url, log.etag) not in known and log.digest not in duplicates
    ]
    waiting = sorted((log for log in fresh if log.digest not in bad), key=lambda log: (-log.size, log.url))
    return Sorted(tuple(waiting), len(found) - len(fresh), len(fresh) - len(waiting), tuple(passed))


def _list_logs(address: str, since: datetime | None) -> Iterator[Log]:
    """Objects that an address names: one, those below a folder, those that fit a pattern."""
    scheme, _, rest = address.partition("://")
    bucket, _, key = rest.partition("/")
    place = Place(f"{scheme}://{bucket}")
    fixed = key[: min((key.find(mark) for mark in GLOB_MARKS if mark in key), default=len(key))]
    pattern = key if fixed != key else ""
    folder = key.rstrip("/") if not pattern else fixed.rpartition("/")[0]
    exact = place.head(key) if key and not pattern and not key.endswith("/") else None
    every = [exact] if exact else list(place.list(folder))
    lakes = tuple(f.key.removesuffix(DATA_FILE) for f in every if f"/{f.key}".endswith(f"/{DATA_FILE}"))
    for found in every:
        if _is_meant(found, pattern, since) and not found.key.startswith(lakes):
            yield Log(f"{scheme}://{bucket}/{found.key}", found.size, found.etag)


def _is_meant(found: StoredObject, pattern: str, since: datetime | None) -> bool:
    is_hidden = found.key.rpartition("/")[2].startswith(".")
    fits = not pattern or fnmatch.fnmatchcase(found.key, pattern)
    return fits and not is_hidden and found.size > 0 and (since is None or found.modified >= since)


def _is_log(name: str) -> bool:
    return own_name(name).lower().endswith(known_suffixes())


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
    logs: Sequence[Log], most: int, workers: int, *, most_bytes: int = 64 << 20, shares: int = 4
) -> list[tuple[Log, ...]]:
    """Logs in batches of at most `most` and about 64 MB; of few logs, some for every worker.

    `shares`: tasks that a worker gets at least, where there are logs enough: the last one is then short.
    """
    most = max(1, min(most, len(logs) // (shares * workers)))
    batches: list[tuple[Log, ...]] = []
    batch: list[Log] = []
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
        self, batches: Sequence[tuple[Log, ...]], settings: Settings
    ) -> Iterator[tuple[tuple[Log, ...], list[LogOutcome]]]:
        """See `Engine`."""
        stopped = threading.Event()
        with ThreadPoolExecutor(self.workers) as pool:
            try:
                tasks = {pool.submit(ingest_batch, part, settings, stopped.is_set): part for part in batches}
                yield from as_they_finish(tasks)
            finally:
                stopped.set()
                pool.shutdown(wait=False, cancel_futures=True)


Tasks = dict["Future[list[LogOutcome]]", tuple[Log, ...]]


def as_they_finish(tasks: Tasks) -> Iterator[tuple[tuple[Log, ...], list[LogOutcome]]]:
    """Batches with their outcomes."""
    waiting = set(tasks)
    while waiting:
        done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        for task in done:
            yield tasks.pop(task), task.result()
