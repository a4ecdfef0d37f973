"""Many logs into one folder: hashed, read in parallel; one bad log never stops the rest.

Each worker hashes or reads one log at a time, within bounds of memory and time (`workers`). First all logs
are hashed: those whose content is in the folder already, or in another log of the run, are not read. A log
that breaks the bounds, or the process that is at it, is named; it costs no other log.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from flysid.catalogue import FlightFacts, catalogue, facts_of
from flysid.errors import FlysidError, FormatError, WriteError
from flysid.facts.vehicle import vehicle_named
from flysid.flight import Damage, Source
from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.blame import blamed
from flysid.ingest.formats.common.packed_names import readable
from flysid.ingest.formats.opening import identify, locate, open_log
from flysid.ingest.formats.registry import format_of
from flysid.ingest.lake.finding import FoundLogs
from flysid.ingest.lake.workers import Bounds, Lost, memory_reason, read_bounded
from flysid.manifest import FLIGHTS, stamp_of
from flysid.progress import part, tell
from flysid.store import clean, create_data_folder, discard, locked, remove_empty, write_flight

NO_MEMORY = "not enough memory"


@dataclass(frozen=True)
class Result:
    """What became of one log.

    `flight`: the flight it became, or became earlier (`unchanged`); None where it was skipped.
    `reason`: why it was skipped.
    `damage`: what of it was lost, where it has been read.
    """

    path: Path
    flight: FlightFacts | None = None
    unchanged: bool = False
    reason: str = ""
    damage: Damage = Damage()  # noqa: RUF009 - frozen

    @property
    def skipped(self) -> bool:
        return self.flight is None


@dataclass(frozen=True)
class Job:
    """A log to read, with the hash and the state it had when it was hashed."""

    path: Path
    sha256: str
    size: int
    modified_ns: int


Task = Path | Job
"""A log to hash, or to read."""


# ------------------------------------------------------------------------------------------ ingesting


def ingest_logs(
    logs: FoundLogs,
    data: str | Path,
    *,
    jobs: int = 0,
    force: bool = False,
    limits: Limits | None = None,
    bounds: Bounds | None = Bounds(),  # noqa: B008 - frozen
    vehicle_in: str = "",
) -> Iterator[Result]:
    """Read logs into a folder; yields one result per log, as they finish.

    `logs`: from `finding.find_logs`.
    `data`: the folder; made where it does not exist.
    `jobs`: worker processes; 0 means one per core, one where there is little to read.
    `force`: read again what is there unchanged.
    `limits`: what readers hold to.
    `bounds`: of memory and time for each log. None reads in this process, without bounds: for logs of one's
        own making.
    `vehicle_in`: a regular expression that finds the vehicle's name in a log's path; "" where it has none.
    Raises WriteError: the folder cannot be written to; logs finished before stay. Raises UsageError: `data`
    is something else.
    """
    is_new = not Path(data).exists()
    folder = create_data_folder(data)
    try:
        yield from _ingest_into(folder, logs, jobs, force, limits or Limits(), bounds, vehicle_in)
    finally:
        if is_new:
            remove_empty(folder)  # an error, or no log could be read


def _ingest_into(
    folder: Path,
    logs: FoundLogs,
    jobs: int,
    force: bool,
    limits: Limits,
    bounds: Bounds | None,
    vehicle_in: str,
) -> Iterator[Result]:
    yield from (Result(item.path, reason=item.reason) for item in logs.unread)
    with locked(folder):
        clean(folder)
        present = () if force else catalogue(folder)
        known = {facts.sha256: facts for facts in present}
        work = partial(work_on, data=folder, limits=limits, replace=force, vehicle_in=vehicle_in)
        tasks: deque[Task] = deque(logs.paths)
        hashed: dict[Path, Job | Result] = {}
        read = 0
        to_read = 0
        for task, outcome in _done(work, tasks, _workers(logs.paths, jobs), bounds, folder):
            if isinstance(outcome, Result) and isinstance(task, Job):
                read += task.size
                tell("read", log=task.path.name, share=read / max(to_read, 1))
                yield outcome
                continue
            hashed[outcome.path] = outcome
            tell("hashed", log=outcome.path.name)
            if len(hashed) == len(logs.paths):
                waiting, settled = _sorted_out([hashed[path] for path in logs.paths], known)
                yield from settled
                to_read = sum(job.size for job in waiting)
                tasks.extend(waiting)
        if any(isinstance(outcome, Job) and outcome.sha256 not in known for outcome in hashed.values()):
            catalogue(folder)  # whoever lists next need not


def _sorted_out(
    hashed: Sequence[Job | Result], known: Mapping[str, FlightFacts]
) -> tuple[list[Job], list[Result]]:
    """The logs to read, the largest first, so that none is begun when all others are done; the other logs."""
    waiting: dict[str, Job] = {}
    settled: list[Result] = []
    for found in hashed:
        if isinstance(found, Result):
            settled.append(found)
        elif found.sha256 in known:
            settled.append(Result(found.path, known[found.sha256], unchanged=True))
        elif found.sha256 in waiting:
            settled.append(Result(found.path, reason=f"the same content as {waiting[found.sha256].path}"))
        else:
            waiting[found.sha256] = found
    return sorted(waiting.values(), key=lambda job: -job.size), settled


def _workers(paths: Sequence[Path], jobs: int, *, one_worker_bytes: int = 12 << 20) -> int:
    cores = jobs or len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    size = 0
    for path in paths:
        with suppress(OSError):
            size += locate(path)[0].stat().st_size
    small = not jobs and size <= one_worker_bytes
    return 1 if small else max(1, min(cores, len(paths)))


def _done(
    work: Callable[[Task], Job | Result], tasks: deque[Task], workers: int, bounds: Bounds | None, data: Path
) -> Iterator[tuple[Task, Job | Result]]:
    """Each task with what it came to, as they finish; tasks may be added meanwhile."""
    bounded = bounds.memory_bytes if bounds else None
    for task, outcome in read_bounded(work, tasks, workers, bounds):
        path = task if isinstance(task, Path) else task.path
        if isinstance(outcome, Lost):
            discard(data, outcome.pid)
            yield task, Result(path, reason=outcome.reason)
        elif isinstance(outcome, Result) and outcome.reason == NO_MEMORY and bounded:
            yield task, Result(path, reason=memory_reason(bounded))
        else:
            yield task, outcome


def work_on(task: Task, data: Path, limits: Limits, replace: bool, vehicle_in: str = "") -> Job | Result:
    """Hash a log or read it."""
    path = task if isinstance(task, Path) else task.path
    with part(log=path.name):
        tell("hashing" if isinstance(task, Path) else "reading")
        if isinstance(task, Path):
            return hash_one(task, limits)
        return ingest_one(task, data, limits, replace, vehicle_in)


def hash_one(path: Path, limits: Limits) -> Job | Result:
    """Hash a log, or say why it cannot be."""
    try:
        state = locate(path)[0].stat()
        return Job(path, *identify(path, limits), state.st_mtime_ns)
    except MemoryError:
        return Result(path, reason=NO_MEMORY)
    except (FormatError, OSError) as error:
        return Result(path, reason=blamed(error).advice)


def ingest_one(job: Job, data: Path, limits: Limits, replace: bool, vehicle_in: str = "") -> Result:
    """Read one log into `data`. Only a folder that cannot be written to raises."""
    try:
        with open_log(job.path, limits) as log:
            state = locate(job.path)[0].stat()
            if (log.size, state.st_mtime_ns) != (job.size, job.modified_ns):
                return Result(job.path, reason="changed while it was being read; is it still being written?")
            fmt = format_of(log, limits)
            source = Source(log.name, fmt.name, job.size, job.sha256)
            parts = log.read(fmt, limits)
            info = vehicle_named(readable(str(job.path)), vehicle_in)
            manifest = write_flight(data, source, parts, replace=replace, info=info)
            facts = facts_of(manifest, stamp_of(data / FLIGHTS / manifest.id))
            return Result(job.path, facts, damage=manifest.damage)
    except WriteError as error:
        need = f"this log needs about {max(job.size // 10**6, 1)} MB; "
        raise WriteError(error.message, hint=need + error.hint, path=error.path) from error
    except MemoryError:
        return Result(job.path, reason=NO_MEMORY)
    except (FlysidError, OSError) as error:
        return Result(job.path, reason=blamed(error).advice)
