"""Ingest the logs of one task: fetch, hash, read in a child process, publish.

The child is bounded in memory and time, and its end costs one log (`flysid.ingest.lake.workers`). It sees
files on this machine alone; its parent speaks to the store.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import mkdtemp

import msgspec

from flysid.catalogue import FlightFacts
from flysid.errors import PlaceError, StoreError
from flysid.facts.vehicle import vehicle_named
from flysid.fleet.lakes import DUPLICATES, QUARANTINE
from flysid.fleet.publish import find_committed, publish
from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.opening import begins_archive, begins_database
from flysid.ingest.formats.rosbag2.side_files import READ
from flysid.ingest.lake.batch import Job, Result, Task, work_on
from flysid.ingest.lake.events import mode_changes
from flysid.ingest.lake.finding import NO_LOGS, Found, judge_file
from flysid.ingest.lake.lake import StoredLog
from flysid.ingest.lake.workers import Bounds, Lost, read_bounded
from flysid.manifest import FLIGHTS
from flysid.place import Place, is_address
from flysid.store import create_data_folder
from flysid.version import __version__

NOTED = 5
TOGETHER = "together "
"""Ahead of the mark of files that may be one recording: known are its flights only once all of them are."""
TRIES = 2
"""Of a log that ends its process: the machine may be at fault the first time."""


class LogAddress(msgspec.Struct, frozen=True):
    """A log to ingest: an address or a path, and for an address the store's mark of its content.

    `beside` are names of objects in its folder that may be one recording with it.
    """

    url: str
    size: int
    etag: str = ""
    beside: tuple[str, ...] = ()

    @property
    def folder(self) -> str:
        return self.url.rpartition("/")[0]

    @property
    def name(self) -> str:
        return self.url.rpartition("/")[2]

    @property
    def digest(self) -> str:
        """Stands for this content at this address."""
        return hashlib.sha256(f"{self.url}\0{self.etag}\0{self.size}".encode()).hexdigest()[:32]


@dataclass(frozen=True)
class Settings:
    """How logs are read, alike for all of an ingest; holds nothing secret.

    Attributes
    ----------
    lake : the address to write to.
    bounds : of memory and time for each log. None reads in the process of the task, without bounds: for logs
        of one's own making.
    vehicle_in : a regular expression that finds the vehicle's name in a log's address.
    replace : read again what the lake has.
    """

    lake: str
    limits: Limits = Limits()  # noqa: RUF009 - frozen
    bounds: Bounds | None = Bounds()  # noqa: RUF009 - frozen
    vehicle_in: str = ""
    replace: bool = False


class LogOutcome(msgspec.Struct, frozen=True):
    """What became of a log.

    `status`: "ingested", "unchanged" (the lake had it), "duplicate" (of another log), "quarantined",
        "ignored" (an archive without logs), or "waiting": not done, because the store did not answer.
    `reason`: why it was quarantined, or waits; the flight that it is a duplicate of.
    """

    log: LogAddress
    status: str
    facts: FlightFacts | None = None
    reason: str = ""


def ingest_batch(
    logs: Sequence[LogAddress], settings: Settings, stopped: Callable[[], bool] = lambda: False
) -> list[LogOutcome]:
    """Ingest some logs, one after another; what was committed before, by whomever, is not read again.

    `stopped` is called before each log; logs that are left out have no outcome.
    """
    place = Place(settings.lake)
    outcomes = []
    reader = _reader_for(settings)
    for log in logs:
        if stopped():
            break
        outcomes += _ingest(log, place, settings, reader)
    return outcomes


def _ingest(log: LogAddress, place: Place, settings: Settings, reader: _Reader) -> list[LogOutcome]:
    """What became of a log, or of every log in an archive or among files that may be one recording."""
    try:
        with reader.file_of(log) as path:
            if log.beside:
                found = reader.look_into(*(path.with_name(name) for name in (log.name, *log.beside)))
                inside = LogAddress(log.folder, log.size, log.etag.removeprefix(TOGETHER))
                return _ingest_several(found, path.parent, log, inside, place, settings, reader)
            if is_address(log.url) and begins_archive(path):
                found = reader.look_into(path)
                return _ingest_several(found, path, log, log, place, settings, reader)
            return [_ingest_file(path, log, place, settings, reader)]
    except FileNotFoundError:
        return [LogOutcome(log, "waiting", reason="it is gone from where it was found")]
    except PlaceError as error:
        return [LogOutcome(log, "waiting", reason=error.message)]
    except StoreError as error:
        return [LogOutcome(log, "waiting", reason=f"{error.message} ({error.where})")]


def _ingest_several(
    found: Found,
    root: Path,
    log: LogAddress,
    whole: LogAddress,
    place: Place,
    settings: Settings,
    reader: _Reader,
) -> list[LogOutcome]:
    """The logs of an archive or a folder that was fetched; a note saves the next fetch.

    `whole` stands for what lies at `root`: the addresses of its logs begin as its own does.

    Raises what `_ingest` takes for a store that did not answer: members that were done are found again.
    """

    def named(inside: Path) -> LogAddress:
        return LogAddress(whole.url + inside.as_posix()[len(root.as_posix()) :], whole.size, whole.etag)

    outcomes = [_ingest_file(inside, named(inside), place, settings, reader) for inside in found.paths]
    outcomes += [
        LogOutcome(named(inside), "quarantined", reason=unread.reason)
        for inside, unread in found.unread.items()
    ]
    bad = [outcome.reason for outcome in outcomes if outcome.status == "quarantined"]
    folder = f"{QUARANTINE}/{__version__}" if bad else DUPLICATES
    place.put(f"{folder}/{log.digest}.json", _note(log, "; ".join(bad[:NOTED]) or "its logs are in the lake"))
    return outcomes or [LogOutcome(log, "ignored", reason=NO_LOGS)]


def _ingest_file(
    path: Path, log: LogAddress, place: Place, settings: Settings, reader: _Reader
) -> LogOutcome:
    job = reader.hash(path)
    if isinstance(job, Result):
        return _refuse(log, place, job.reason)
    there = find_committed(place, job.sha256)
    if there is not None and not settings.replace:
        return _already(log, place, there)
    result, modes = reader.read(job)
    if result.flight is None:
        return _refuse(log, place, result.reason)
    info = vehicle_named(log.url, settings.vehicle_in)
    info |= {"source_url": log.url, "source_etag": log.etag} if is_address(log.url) else {}
    info |= {"modes": ", ".join(modes)} if modes else {}
    folder = reader.data / FLIGHTS / result.flight.id
    done = publish(place, folder, info, replace=settings.replace)
    shutil.rmtree(folder, ignore_errors=True)
    if done.is_new:
        return LogOutcome(log, "ingested", done.facts)
    return _already(log, place, done.facts)


def _already(log: LogAddress, place: Place, there: FlightFacts) -> LogOutcome:
    """The lake has this content: from this log; or from another, and a note saves the next fetch."""
    source = there.info.get("source_url", "")
    if not is_address(log.url) or (source == log.url and there.info.get("source_etag") == log.etag):
        return LogOutcome(log, "unchanged", there)
    place.put(
        f"{DUPLICATES}/{log.digest}.json", _note(log, f"the same content as {source or there.log}", there.id)
    )
    return LogOutcome(log, "duplicate", there, reason=there.id)


def _refuse(log: LogAddress, place: Place, reason: str) -> LogOutcome:
    """A log that cannot be read. One that came by address is noted, so that nobody fetches it again."""
    if is_address(log.url):
        place.put(f"{QUARANTINE}/{__version__}/{log.digest}.json", _note(log, reason))
    return LogOutcome(log, "quarantined", reason=reason)


def _note(log: LogAddress, reason: str, flight: str = "") -> bytes:
    known = {"url": log.url, "etag": log.etag, "size": log.size, "reason": reason, "flysid": __version__}
    return json.dumps(known | ({"flight": flight} if flight else {}), indent=1).encode() + b"\n"


def _safe(name: str) -> str:
    return name if name not in ("", ".", "..") else "log"


_kept = threading.local()


def _reader_for(settings: Settings) -> _Reader:
    """This thread's child process, kept from batch to batch; it ends with the thread."""
    if getattr(_kept, "settings", None) != settings:
        _kept.reader = _Reader(settings)
        _kept.settings = settings
    reader: _Reader = _kept.reader
    return reader


class _Reader:
    """A child process, kept from log to log, and its scratch folder."""

    def __init__(self, settings: Settings) -> None:
        self._scratch = Path(mkdtemp(prefix="flysid-"))
        weakref.finalize(self, shutil.rmtree, self._scratch, ignore_errors=True)
        self.data = create_data_folder(self._scratch / "data")
        self._tasks: deque[Task] = deque()
        work = partial(read_log, data=self.data, limits=settings.limits)
        self._outcomes = read_bounded(work, self._tasks, 1, settings.bounds)
        self._archives: deque[Path] = deque()
        self._looks = read_bounded(judge_file, self._archives, 1, settings.bounds)

    @contextmanager
    def file_of(self, log: LogAddress) -> Iterator[Path]:
        """The log as a file on this machine, for as long as it is needed."""
        if not is_address(log.url):
            yield Path(log.url)
            return
        folder = self._scratch / "logs" / _safe(log.folder.rpartition("/")[2])
        path = folder / _safe(log.name)
        place = Place(log.folder)
        try:
            folder.mkdir(parents=True)
            place.fetch(log.name, path)
            for name in log.beside:
                place.fetch(name, folder / name)
            databases = [file for file in folder.iterdir() if begins_database(file)]
            for name in (file.name + suffix for file in databases for suffix in READ):
                with suppress(FileNotFoundError):
                    place.fetch(name, folder / name)
            yield path
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def look_into(self, *paths: Path) -> Found:
        """What is in an archive, or what files of a folder are."""
        every = Found()
        for path in paths:
            self._archives.append(path)
            _, found = next(self._looks)
            every.take(path, found)
        return every

    def hash(self, path: Path) -> Job | Result:
        """The log's hash, or why it cannot be had."""
        outcome, _ = self._do(path)
        return outcome

    def read(self, job: Job) -> tuple[Result, tuple[str, ...]]:
        """The log as a flight in the scratch folder, and its modes; or why it cannot be read."""
        outcome, modes = self._do(job)
        assert isinstance(outcome, Result)
        return outcome, modes

    def _do(self, task: Task) -> tuple[Job | Result, tuple[str, ...]]:
        path = task if isinstance(task, Path) else task.path
        reason = ""
        for _ in range(TRIES):
            self._tasks.append(task)
            _, outcome = next(self._outcomes)
            if not isinstance(outcome, Lost):
                return outcome
            reason = outcome.reason
            if not outcome.has_ended:
                return Result(path, reason=reason), ()
            shutil.rmtree(self.data / FLIGHTS, ignore_errors=True)
            (self.data / FLIGHTS).mkdir()
        return Result(path, reason=f"{reason}, {TRIES} times"), ()


def read_log(task: Task, data: Path, limits: Limits) -> tuple[Job | Result, tuple[str, ...]]:
    """Hash a log, or read it into a scratch folder; and the names of the modes that were flown."""
    outcome = work_on(task, data, limits, replace=True)
    if not isinstance(outcome, Result) or outcome.flight is None:
        return outcome, ()
    changes = mode_changes(StoredLog(data, outcome.flight))
    return outcome, tuple(dict.fromkeys(change.text for change in changes))
