"""A Dask cluster for an ingest and for a fleet's models: one that runs somewhere, or processes here.

A task of an ingest is a batch of addresses and the settings; a result states what became of each log. Neither
holds a secret nor a table: workers reach the store by their own credentials. Dask may do a task twice; what
is committed is committed once.
"""

from __future__ import annotations

import hashlib
import importlib.util
import multiprocessing
import pickle
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, TypeVar

from flysid.errors import FlysidError, PlaceError, UsageError
from flysid.fleet.reading import LogAddress, LogOutcome, Settings, ingest_batch
from flysid.version import __version__

Task = TypeVar("Task")
Result = TypeVar("Result")
WINDOW = 1_000
"""Tasks in the scheduler at a time, unless it has more workers: it keeps about 10 kB of each."""
TOGETHER_S = 0.1
"""How long results are waited for that can be fetched, and followed by new tasks, together."""
RETRIES = 3
KILLED = "its workers were killed"
_CONFIG = {
    "distributed.worker.daemon": False,  # a worker starts the processes that read logs
    "distributed.scheduler.allowed-failures": 10,  # one worker's death makes all its tasks suspect
    "distributed.scheduler.worker-ttl": "300s",
    "distributed.comm.timeouts.connect": "60s",
}


@dataclass(frozen=True)
class Cluster:
    """An engine of Dask's; see `flysid.fleet.ingest_many.Engine`."""

    client: Any
    do: Callable[[Sequence[LogAddress], Settings], list[LogOutcome]] = ingest_batch

    @property
    def workers(self) -> int:
        """Threads of all workers."""
        threads: dict[str, int] = self.client.nthreads()
        return max(1, sum(threads.values()))

    @property
    def dashboard(self) -> str:
        """Its address, or what it lacks."""
        if importlib.util.find_spec("bokeh") is None:
            return "none (pip install bokeh)"
        return str(self.client.dashboard_link)

    def run(
        self, batches: Sequence[tuple[LogAddress, ...]], settings: Settings
    ) -> Iterator[tuple[tuple[LogAddress, ...], list[LogOutcome]]]:
        """Each batch with what became of its logs, as they finish.

        A batch that Dask gives up is not done; its logs wait for the next time. Raises PlaceError: the
        scheduler is gone.
        """
        for part, outcomes in self.each(partial(_ingest, self.do, settings), batches, _parts_of):
            if outcomes is None:
                yield part, [LogOutcome(log, "waiting", reason=KILLED) for log in part]
            else:
                yield part, outcomes

    def each(
        self, do: Callable[[Task], Result], tasks: Iterable[Task], parts_of: Callable[[Task], Sequence[str]]
    ) -> Iterator[tuple[Task, Result | None]]:
        """Each task with its result, as they finish; None where its workers were killed again and again.

        `do`: importable on the workers; what it raises is raised here, after the results that came with it.
        `parts_of`: texts that tell a task from others, the first its kind; equal texts are one task.
        Raises PlaceError: the scheduler is gone.
        """
        from distributed import as_completed
        from distributed.client import FutureCancelledError
        from distributed.comm.core import CommClosedError

        waiting = iter(tasks)
        pending: dict[str, Task] = {}

        def submitted(count: int) -> list[Any]:
            some = list(islice(waiting, count))
            keys = [_key(*parts_of(task)) for task in some]
            pending.update(zip(keys, some, strict=True))
            packed = [pickle.dumps(task) for task in some]
            futures: list[Any] = self.client.map(
                partial(_unpack, do), packed, key=keys, retries=RETRIES, pure=False
            )
            return futures

        running = as_completed(submitted(max(WINDOW, 2 * self.workers)))
        try:
            for futures in running.batches():
                time.sleep(TOGETHER_S)
                futures += running.next_batch(block=False)
                results = self._results(futures)
                done = [pending.pop(future.key) for future in futures]
                for future in futures:
                    future.release()
                running.update(submitted(len(futures)))
                yield from _sound(done, results)
        except (FutureCancelledError, CommClosedError) as error:
            raise PlaceError(
                "the cluster's scheduler is gone",
                hint="start it and its workers again, then run the same command: what is committed stays",
            ) from error

    def _results(self, futures: Sequence[Any]) -> list[Any]:
        """Of tasks that have ended, in one question to the workers; an exception where one raised it."""
        with suppress(Exception):  # one of them failed: the others are fetched one by one
            return list(self.client.gather(list(futures)))
        results: list[Any] = []
        for future in futures:
            error = future.exception()
            results.append(future.result() if error is None else error)
        return results


def _sound(tasks: Sequence[Task], results: Sequence[Any]) -> Iterator[tuple[Task, Any]]:
    """Tasks with their results, None where workers were killed; then what one of the others raised."""
    from distributed.scheduler import KilledWorker

    raised: list[Exception] = []
    for task, result in zip(tasks, results, strict=True):
        if isinstance(result, KilledWorker):
            yield task, None
        elif isinstance(result, Exception):
            raised.append(result)
        else:
            yield task, result
    if raised:
        raise raised[0]


def _unpack(do: Callable[[Task], Result], packed: bytes) -> Result:
    """Do a task that is one piece for the scheduler, which unpacks and keeps what it passes on."""
    return do(pickle.loads(packed))


def _ingest(
    do: Callable[[Sequence[LogAddress], Settings], list[LogOutcome]],
    settings: Settings,
    part: Sequence[LogAddress],
) -> list[LogOutcome]:
    return do(part, settings)


def _parts_of(part: Sequence[LogAddress]) -> list[str]:
    return ["ingest", *(f"{log.url}\0{log.etag}\0{log.size}" for log in part)]


def _key(kind: str, *parts: str) -> str:
    return f"{kind}-{hashlib.sha256(chr(0).join(parts).encode()).hexdigest()[:24]}"


@contextmanager
def connect(address: str = "", workers: int = 0) -> Iterator[Cluster]:
    """A cluster: the scheduler at an address; or one of this many processes here, for as long as the block.

    Raises UsageError: Dask is not installed; workers have another flysid, or may not start processes.
    Raises PlaceError: nobody answers there.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise UsageError(
            "a cluster needs the extra flysid[fleet]", hint="pip install 'flysid[fleet]'"
        ) from error
    with dask.config.set(_CONFIG):
        if address:
            with _client(Client, address) as client:
                _check_workers(client, address)
                yield Cluster(client)
            return
        with (
            LocalCluster(
                n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0"
            ) as local,
            Client(local) as client,
        ):
            _check_workers(client, str(local.scheduler_address))
            yield Cluster(client)


@contextmanager
def _client(client_of: Callable[..., Any], address: str) -> Iterator[Any]:
    try:
        client = client_of(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise PlaceError(
            "no Dask scheduler answers there",
            path=address,
            hint="start one with: dask scheduler; and workers with: dask worker ADDRESS --nthreads 1",
        ) from error
    try:
        yield client
    finally:
        with suppress(Exception):  # a scheduler that is gone needs no good-bye
            client.close(timeout=5)


def worker_facts() -> tuple[str, str, bool]:
    """Return flysid's version, Python's, and whether this process may start others."""
    return __version__, sys.version.partition(" ")[0], not multiprocessing.current_process().daemon


def _check_workers(client: Any, address: str) -> None:
    """Raise UsageError where workers would read logs otherwise than this process, or not at all."""
    try:
        client.wait_for_workers(1, timeout=60)
        found = client.run(worker_facts)
    except FlysidError:
        raise
    except TimeoutError as error:
        raise PlaceError(
            "the cluster has no workers", path=address, hint="start some: dask worker ADDRESS --nthreads 1"
        ) from error
    except Exception as error:  # what the worker raised comes as it is
        raise UsageError(
            f"the workers cannot run flysid: {type(error).__name__}: {error}",
            path=address,
            hint="install the same flysid[fleet] on them",
        ) from error
    here = worker_facts()
    for worker, (version, python, may_start) in found.items():
        if (version, python) != here[:2]:
            raise UsageError(
                f"worker {worker} has flysid {version} and Python {python}; "
                f"here it is flysid {here[0]} and Python {here[1]}",
                path=address,
                hint="install the same versions on all machines",
            )
        if not may_start:
            raise UsageError(
                f"worker {worker} may not start the processes that read logs",
                path=address,
                hint="start workers with --no-nanny, or DASK_DISTRIBUTED__WORKER__DAEMON=False",
            )
