"""Tasks in worker processes, each task within bounds of memory and time.

One task at a time per worker, so that whatever ends a worker (a crash of a library, the system's killer of
processes when memory runs out, a bound) is known to belong to one task. The others go on in a new worker. The
parent watches:

    time      wall clock since the task was handed over; the worker is killed at its bound.
    memory    anonymous resident memory of the worker, looked at ten times a second (Linux); mapped logs do
              not count. One huge request fails at once: the system refuses data segments beyond the bound
              plus `HEADROOM_BYTES` (address space that Arrow's allocator reserves and never touches).

Workers die with their parent, and leave interrupts from the keyboard to it. The parent reports the progress
of a task (`flysid.progress`). Where a system lacks one of these
means (macOS, Windows), the others still hold.

Whatever lists, looks into or reads a file goes through `read_bounded`: an exception that nobody foresaw is an
error of that file, and costs no other.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkContext, ForkServerContext, SpawnContext
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from flysid import progress
from flysid.errors import FlysidError, FormatError, UsageError
from flysid.ingest.formats.blame import blaming

HEADROOM_BYTES = 1 << 30
JOIN_S = 5.0
_NEEDED_BY_ALL = "flysid.ingest.lake.batch"
_NO_BEGINNING = "a script that ingests needs 'if __name__ == \"__main__\":' around what it does"
_NO_WORKER = "no worker process can be started: {}"


def _is_script() -> bool:
    """Whether a file of the user's runs us, which a worker begins with, too: no command, no prompt."""
    begun = sys.modules["__main__"]
    return getattr(begun, "__file__", None) is not None and getattr(begun, "__spec__", None) is None


Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


@dataclass(frozen=True)
class Bounds:
    """What one task may take; None lifts a bound.

    `memory_bytes`: anonymous memory of the process.
    `seconds`: wall time.
    """

    memory_bytes: int | None = 4 * 10**9
    seconds: float | None = 600.0


@dataclass(frozen=True)
class Lost:
    """A task without an outcome: why, the process that was at it, and whether that has ended."""

    error: FlysidError
    pid: int
    has_ended: bool = True

    @property
    def reason(self) -> str:
        """Why, and what to try."""
        return self.error.advice


def read_bounded(
    function: Callable[[Task], Outcome], tasks: Iterable[Task], workers: int, bounds: Bounds | None
) -> Generator[tuple[Task, Outcome | Lost], None, None]:
    """`run_bounded` for tasks of one file each: what makes a task fail is that file's fault, and ends no run.

    `function`: as `run_bounded` takes it. Of what it raises, only errors that concern no single file end the
        run (see `blaming`).
    `bounds`: None does the tasks one after another in this process.
    """
    attempt = partial(_attempt, function)
    if bounds is not None:
        yield from run_bounded(attempt, tasks, workers, bounds)
        return
    waiting = tasks if isinstance(tasks, deque) else deque(tasks)
    while waiting:
        task = waiting.popleft()
        yield task, attempt(task)


def _attempt(function: Callable[[Task], Outcome], task: Task) -> Outcome | Lost:
    """What a task comes to, or why it fails."""
    try:
        with blaming():
            return function(task)
    except FormatError as error:
        return Lost(error, os.getpid(), has_ended=False)


def run_bounded(
    function: Callable[[Task], Outcome],
    tasks: Iterable[Task],
    workers: int,
    bounds: Bounds,
    *,
    look_every_s: float = 0.1,
) -> Generator[tuple[Task, Outcome | Lost], None, None]:
    """Do tasks in worker processes; yields each with its outcome, or `Lost`, as they finish.

    `function`: does one task; importable, as are its tasks and outcomes picklable. What it raises is raised
        here and ends the run.
    `tasks`: in the order in which they are begun. A deque is emptied; what is added to it is done too.
    `workers`: processes at a time.
    Raises UsageError: a worker could not be started.
    """
    waiting = tasks if isinstance(tasks, deque) else deque(tasks)
    crew: list[_Worker[Task, Outcome]] = []
    try:
        while waiting or any(w.is_busy for w in crew):
            crew = [w for w in crew if not w.has_ended]
            while waiting and sum(w.is_busy for w in crew) < workers:
                idle = next((w for w in crew if not w.is_busy), None)
                if idle is None:
                    crew.append(idle := _Worker(function, bounds))
                idle.give(waiting.popleft())
            wait([w.connection for w in crew if w.is_busy], timeout=look_every_s)
            for worker in [w for w in crew if w.is_busy]:
                outcome = worker.outcome()
                if outcome is not None:
                    yield outcome
    finally:
        for worker in crew:
            worker.end()


_forks_from_here = False


def fork_from_here() -> None:
    """Workers are forked from this process from now on: it has one thread, and all imports that they need.

    Not to be had by `multiprocessing`'s start method: "fork" is what that is where nobody has chosen.
    """
    global _forks_from_here
    _forks_from_here = True


def _context(function: Callable[[Any], Any]) -> ForkServerContext | ForkContext | SpawnContext:
    """Workers come from a process that has imported what they need; elsewhere each imports for itself."""
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    if _forks_from_here:
        return multiprocessing.get_context("fork")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([_NEEDED_BY_ALL, _home_of(function)])
    return context


def _home_of(function: Callable[[Any], Any]) -> str:
    """The module of the function that does the work, whatever is wrapped around it."""
    while isinstance(function, partial):
        function = function.args[0] if function.func is _attempt else function.func
    return function.__module__


class _Worker(Generic[Task, Outcome]):
    """One process and the task that it is at."""

    def __init__(self, function: Callable[[Task], Outcome], bounds: Bounds) -> None:
        context = _context(function)
        try:
            self.connection, theirs = context.Pipe()
        except OSError as error:
            raise FlysidError(_NO_WORKER.format(error.strerror)) from error
        self._bounds = bounds
        self._task: Task | None = None
        self._since = 0.0
        self._is_ready = False
        self.has_ended = False
        self._process: BaseProcess = context.Process(
            target=_serve, args=(theirs, function, bounds.memory_bytes, dict(os.environ)), daemon=True
        )
        try:
            self._process.start()
        except OSError as error:
            raise FlysidError(_NO_WORKER.format(error.strerror)) from error
        finally:
            theirs.close()

    @property
    def is_busy(self) -> bool:
        return self._task is not None

    def give(self, task: Task) -> None:
        self._task = task
        self._since = time.monotonic()
        with suppress(OSError):  # it has died: `outcome` finds out
            self.connection.send(task)

    def outcome(self) -> tuple[Task, Outcome | Lost] | None:
        """The task and what became of it; None while the worker is at it."""
        assert self._task is not None
        try:
            if not self.connection.poll():
                broken = self._broken_bound()
                return self._lost(broken) if broken else None
            kind, content = self.connection.recv()
        except (EOFError, OSError):
            return self._lost("")
        if kind == "ready":
            self._is_ready = True
            self._since = time.monotonic()
            return None
        if kind == "told":
            progress.relay(content)
            return None
        if kind == "raised" and isinstance(content, MemoryError) and self._bounds.memory_bytes is not None:
            return self._lost(memory_reason(self._bounds.memory_bytes))  # sooner than it was watched
        if kind == "raised":
            raise content
        task = self._task
        self._task = None
        if self._is_grown():
            self.end()
        return task, content

    def _broken_bound(self) -> str:
        seconds = self._bounds.seconds
        memory = self._bounds.memory_bytes
        if not self._is_ready:
            return ""
        if seconds is not None and time.monotonic() - self._since > seconds:
            return f"took longer than {seconds:g} s, the time limit for one log"
        if memory is not None and anonymous_bytes(self._process.pid) > memory:
            return memory_reason(memory)
        return ""

    def _is_grown(self) -> bool:
        """Does it hold on to memory that the next task would be blamed for?"""
        memory = self._bounds.memory_bytes
        return memory is not None and anonymous_bytes(self._process.pid) > memory // 2

    def _lost(self, broken: str) -> tuple[Task, Lost]:
        assert self._task is not None
        task = self._task
        self._task = None
        if not broken:
            self._process.join(JOIN_S)
        code = self._process.exitcode
        self.end()
        if not self._is_ready and not broken:
            raise UsageError(
                f"a worker process ended ({ended_how(code)}) before it could begin",
                hint=_NO_BEGINNING if _is_script() else "what it wrote above says why",
            )
        return task, Lost(FormatError(broken or f"its process {ended_how(code)}"), self._process.pid or 0)

    def end(self) -> None:
        """Kill it; what it was at is not finished."""
        self.has_ended = True
        self._task = None
        self.connection.close()
        self._process.kill()
        self._process.join(JOIN_S)


def memory_reason(memory_bytes: int) -> str:
    """Why a log was given up."""
    return f"needs more memory than {memory_bytes / 1e9:.3g} GB, the memory limit for one log"


def ended_how(code: int | None) -> str:
    """How a process ended, in words."""
    if code is None:
        return "stopped answering"
    if code == -getattr(signal, "SIGKILL", 9):
        return "was killed by the system (out of memory?)"
    if code == -getattr(signal, "SIGBUS", 7):
        return "lost the file that it was reading (cut short meanwhile, or the disk failed)"
    if code < 0:
        with suppress(ValueError):
            return f"crashed ({signal.Signals(-code).name}); please report"
    return f"ended with code {code}"


def anonymous_bytes(pid: int | None) -> int:
    """Resident memory of a process that no file backs; 0 where the system does not tell (not Linux)."""
    try:
        with open(f"/proc/{pid}/statm", "rb") as file:
            _, resident, shared, *_ = file.read().split()
    except (OSError, ValueError):
        return 0
    return max(int(resident) - int(shared), 0) * os.sysconf("SC_PAGESIZE")


# ------------------------------------------------------------------------------------- in the worker


def _serve(
    connection: Connection,
    function: Callable[[Any], Any],
    memory_bytes: int | None,
    environment: dict[str, str],
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.clear()  # it is the one of the day when the first worker began
    os.environ.update(environment)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if memory_bytes is not None:
        cap_data(memory_bytes + HEADROOM_BYTES)
    connection.send(("ready", None))
    while True:
        try:
            task = connection.recv()
        except (EOFError, OSError):
            return
        try:
            with progress.listening(lambda step: connection.send(("told", step))):
                answer = ("done", function(task))
        except Exception as error:  # noqa: BLE001 - raised again in the parent
            answer = ("raised", error)
        connection.send(answer)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def cap_data(more_bytes: int) -> None:
    """Let this process's writable private memory grow by at most `more_bytes`, where the system can."""
    try:
        import resource

        with open("/proc/self/status", encoding="ascii") as file:
            now_kb = next(int(line.split()[1]) for line in file if line.startswith("VmData:"))
    except (ImportError, OSError, StopIteration, ValueError):
        return
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = (now_kb << 10) + more_bytes
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_DATA, (wanted if hard < 0 else min(wanted, hard), hard))
