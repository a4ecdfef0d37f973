"""Many logs into one folder: hashed, read in parallel; one bad log never stops the rest.

Logs whose content is in the folder already are recognised by their hash before any worker starts. Each
worker reads one log at a time, within bounds of memory and time (`workers`). A log that breaks them, or the
process that reads it, is named; it costs no other log.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from flysid.errors import FlysidError, FormatError, WriteError
from flysid.flight import Source
from flysid.ingest.formats.base import Limits, hash_log
from flysid.ingest.formats.opening import locate, open_log
from flysid.ingest.formats.registry import detect
from flysid.ingest.lake.finding import Found
from flysid.ingest.lake.workers import Bounds, Lost, memory_reason, run_bounded
from flysid.manifest import Manifest, list_flights
from flysid.store import clean, create_data_folder, discard, locked, remove_empty, write_flight

ONE_WORKER_BYTES = 12 << 20
NO_MEMORY = "needs more memory than there is"


@dataclass(frozen=True)
class Result:
    """What became of one log: ingested (`manifest`), `unchanged`, or skipped for a `reason`."""

    path: Path
    manifest: Manifest | None = None
    unchanged: bool = False
    reason: str = ""

    @property
    def skipped(self) -> bool:
        return self.manifest is None


@dataclass(frozen=True)
class Job:
    """A log to read, with the hash and the state it had when it was hashed."""

    path: Path
    sha256: str
    size: int
    modified_ns: int


# ------------------------------------------------------------------------------------------ ingesting


def ingest_logs(
    logs: Found,
    data: str | Path,
    *,
    jobs: int = 0,
    force: bool = False,
    limits: Limits | None = None,
    bounds: Bounds | None = Bounds(),  # noqa: B008 - frozen
) -> Iterator[Result]:
    """Read logs into a folder; yields one result per log, as they finish.

    Parameters
    ----------
    logs : from `finding.find_logs`.
    data : the folder; made where it does not exist.
    jobs : worker processes; 0 means one per core, one where there is little to read.
    force : read again what is there unchanged.
    limits : what readers hold to.
    bounds : of memory and time for each log. None reads in this process, without bounds: for logs of
        one's own making.

    Raises
    ------
    WriteError : the folder cannot be written to; logs finished before stay.
    UsageError : `data` is something else.
    """
    is_new = not Path(data).exists()
    folder = create_data_folder(data)
    try:
        yield from _ingest_into(folder, logs, jobs, force, limits or Limits(), bounds)
    finally:
        if is_new:
            remove_empty(folder)  # an error, or no log could be read


def _ingest_into(
    folder: Path, logs: Found, jobs: int, force: bool, limits: Limits, bounds: Bounds | None
) -> Iterator[Result]:
    yield from (Result(item.path, reason=item.reason) for item in logs.unread)
    with locked(folder):
        clean(folder)
        known = {} if force else {m.source.sha256: m for m in list_flights(folder)}
        waiting: list[Job] = []
        for path in logs.paths:
            prepared = _prepare(path)
            if isinstance(prepared, Result):
                yield prepared
            elif prepared.sha256 in known:
                yield Result(path, known[prepared.sha256], unchanged=True)
            elif any(job.sha256 == prepared.sha256 for job in waiting):
                yield Result(path, reason="the same content as another log of this run")
            else:
                waiting.append(prepared)
        read = partial(ingest_one, data=folder, limits=limits, replace=force)
        if bounds is None:
            yield from map(read, waiting)
        else:
            yield from _in_workers(read, waiting, _workers(waiting, jobs), bounds, folder)


def _prepare(path: Path) -> Job | Result:
    """Hash a log, or say why it cannot be."""
    try:
        with open_log(path) as log:
            state = locate(path)[0].stat()
            return Job(path, hash_log(log.view), len(log.view), state.st_mtime_ns)
    except (FormatError, OSError) as error:
        return Result(path, reason=getattr(error, "message", None) or str(error))


def _workers(waiting: Sequence[Job], jobs: int) -> int:
    cores = jobs or len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    small = not jobs and sum(job.size for job in waiting) <= ONE_WORKER_BYTES
    return 1 if small else max(1, min(cores, len(waiting)))


def _in_workers(
    read: Callable[[Job], Result], waiting: Sequence[Job], workers: int, bounds: Bounds, data: Path
) -> Iterator[Result]:
    """Large logs first, so that none is begun when all others are done."""
    for job, result in run_bounded(read, sorted(waiting, key=lambda job: -job.size), workers, bounds):
        if isinstance(result, Lost):
            discard(data, result.pid)
            yield Result(job.path, reason=result.reason)
        else:
            memory = bounds.memory_bytes
            lacks = result.reason == NO_MEMORY and memory is not None
            yield Result(job.path, reason=memory_reason(memory or 0)) if lacks else result


def ingest_one(job: Job, data: Path, limits: Limits, replace: bool) -> Result:
    """Read one log into `data`. Only a folder that cannot be written to raises."""
    try:
        with open_log(job.path, limits) as log:
            state = locate(job.path)[0].stat()
            if (len(log.view), state.st_mtime_ns) != (job.size, job.modified_ns):
                return Result(job.path, reason="changed while it was being read; is it still being written?")
            fmt = detect(log.head, log.name)
            source = Source(log.name, fmt.name, job.size, job.sha256)
            parts = log.read(fmt, limits)
            return Result(job.path, write_flight(data, source, parts, replace=replace))
    except WriteError as error:
        need = f"this log needs about {max(job.size // 10**6, 1)} MB; "
        raise WriteError(error.message, hint=need + error.hint, path=error.path) from error
    except MemoryError:
        return Result(job.path, reason=NO_MEMORY)
    except FlysidError as error:
        return Result(job.path, reason=error.advice)
    except OSError as error:
        return Result(job.path, reason=f"cannot be read: {error.strerror}")
    except Exception as error:  # noqa: BLE001 - a reader's own fault must not cost the other logs
        return Result(job.path, reason=f"internal error, please report: {type(error).__name__}: {error}")
