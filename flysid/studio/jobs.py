"""Jobs: commands of flysid in processes of their own, one at a time in each lane.

A job is a folder: `job.json` (what and how far), `log` (stderr), `out` (stdout), `ended.json` (the exit code,
written by the job itself). A server that is started later finds the jobs of the one before it, goes on with
those that still run, and begins those that were waiting, where the user has made them (`flysid.studio.seal`).
"""

from __future__ import annotations

import asyncio
import hmac
import json
import os
import secrets
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

import msgspec

from flysid.errors import StoreError
from flysid.files import write_atomically
from flysid.foreign import inner_path
from flysid.studio.folders import NotThere
from flysid.studio.runner import NOTE
from flysid.studio.seal import own_key, sealed, state_folder
from flysid.studio.warm import Warm

PROGRAM = "flysid"
"""What a job runs, as `python -m` does."""
State = Literal["queued", "running", "done", "failed", "cancelled", "interrupted"]
Lane = Literal["read", "fit"]
LOOK_EVERY_S = 0.1
PATIENCE_S = 0.5  # between asking a job to end and killing it
PARTIAL = 3  # the exit code of what is done with losses
ENDED: tuple[State, ...] = ("done", "failed", "cancelled", "interrupted")


class Job(msgspec.Struct, frozen=True):
    """One command.

    `words`: after `flysid`.
    `lane`: jobs of one lane run one after the other, so that reading a log does not wait for a fit.
    `about`: what it makes: {"flight": ...}, {"run": ...}, {"upload": ...}.
    `pid`, `born`: of its process: the number, and when the system says that it began.
    `code`: the exit code; None before it ended, or where it was killed.
    `then`: the words of the job that follows where this one is done.
    `seal`: of its words and its folder, by the user's key.
    """

    id: str
    words: tuple[str, ...]
    lane: Lane
    state: State = "queued"
    about: dict[str, str] = {}
    made: float = 0.0
    began: float | None = None
    ended: float | None = None
    pid: int = 0
    born: str = ""
    code: int | None = None
    then: tuple[str, ...] = ()
    seal: str = ""

    @property
    def command(self) -> str:
        """What a person would type."""
        return shlex.join(["flysid", *self.words])

    @property
    def has_ended(self) -> bool:
        return self.state in ENDED


class Jobs:
    """The jobs of a studio. `work` must run for as long as the server does.

    `warm`: begins those that read logs sooner; None where each begins from nothing.
    """

    warm: Warm | None = None

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._jobs: dict[str, Job] = {}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._key = own_key(state_folder(os.environ))
        for path in sorted(folder.glob("*/job.json")):
            with suppress(OSError, msgspec.DecodeError, StoreError):
                found = inner_path(folder, f"{path.parent.name}/{path.name}", folder)
                job = msgspec.json.decode(found.read_bytes(), type=Job)
                if job.id == path.parent.name:
                    self._jobs[job.id] = job if self._is_own(job) else _not_to_be_run(job)

    def listing(self) -> list[Job]:
        """All jobs, the newest first."""
        return sorted(self._jobs.values(), key=lambda job: -job.made)

    def get(self, job_id: str) -> Job:
        """A job by its id; raises NotThere."""
        if job_id not in self._jobs:
            raise NotThere(f"no job {job_id!r}")
        return self._jobs[job_id]

    def text(self, job_id: str, name: Literal["log", "out"]) -> bytes:
        """What a job has printed so far; raises StoreError where the file is a link that leads elsewhere."""
        path = inner_path(self._folder, f"{self.get(job_id).id}/{name}", self._folder)
        return path.read_bytes() if path.is_file() else b""

    def add(self, words: Sequence[str], lane: Lane, about: dict[str, str], then: Sequence[str] = ()) -> Job:
        """A job that waits for its turn, and the words of the one that follows it.

        Raises StoreError: the folder cannot be written to.
        """
        made = time.time()
        job_id = f"{int(made * 1000):x}-{secrets.token_hex(3)}"
        job = Job(job_id, tuple(words), lane, about=about, made=made, then=tuple(then))
        job = msgspec.structs.replace(job, seal=self._seal_of(job))
        try:
            (self._folder / job.id).mkdir()
        except OSError as error:
            raise StoreError(f"no job can be made: {error.strerror}", path=self._folder) from error
        return self._note(job)

    def cancel(self, job_id: str) -> Job:
        """End a job and every process that it has begun; one that has ended stays as it is."""
        job = self.get(job_id)
        if job.has_ended:
            return job
        job = self._note(msgspec.structs.replace(job, state="cancelled", ended=time.time()))
        _end_group(job)
        return job

    async def work(self) -> None:
        """Begin jobs in their turn and note how they end, until it is cancelled."""
        while True:
            for job in [j for j in self._jobs.values() if j.state == "running"]:
                self._follow(job)
            for lane in ("read", "fit"):
                await self._begin_next(lane)
            await asyncio.sleep(LOOK_EVERY_S)

    async def events(self, job_id: str, after: int) -> AsyncIterator[tuple[int, str]]:
        """Lines of a job's log as (number, text) beyond the first `after`, until it has ended."""
        number = 0
        read = 0
        while True:
            has_ended = self.get(job_id).has_ended
            text = self.text(job_id, "log")[read:]
            whole = text[: text.rfind(b"\n") + 1] if not has_ended else text
            read += len(whole)
            for line in whole.decode("utf-8", "replace").splitlines():
                number += 1
                if number > after and line.strip():
                    yield number, line
            if has_ended:
                return
            await asyncio.sleep(LOOK_EVERY_S)

    def running(self) -> list[Job]:
        """Jobs with a process."""
        return [job for job in self._jobs.values() if job.state == "running"]

    def _seal_of(self, job: Job) -> str:
        return sealed(self._key, str((self._folder / job.id).resolve()), job.words, job.lane, job.then)

    def _is_own(self, job: Job) -> bool:
        return hmac.compare_digest(job.seal.encode(), self._seal_of(job).encode())

    async def _begin_next(self, lane: str) -> None:
        own = [job for job in self._jobs.values() if job.lane == lane]
        waiting = [job for job in own if job.state == "queued"]
        if not waiting or any(job.state == "running" for job in own):
            return
        job = min(waiting, key=lambda j: j.made)
        pid = await asyncio.to_thread(self._begun, job)
        job = msgspec.structs.replace(job, state="running", began=time.time(), pid=pid, born=_born(pid))
        if self._jobs[job.id].has_ended:  # cancelled meanwhile
            await asyncio.to_thread(_end_group, job)
            return
        self._note(job)

    def _begun(self, job: Job) -> int:
        """The process id of a job that has been begun."""
        folder = self._folder / job.id
        pid = self.warm.begin(folder) if self.warm is not None and job.lane == "read" else 0
        if pid:
            return pid
        process = self._processes[job.id] = _process_of(folder)
        return process.pid

    def _follow(self, job: Job) -> None:
        process = self._processes.get(job.id)
        is_alive = _is_alive(job) if process is None else process.poll() is None
        if is_alive:
            return
        self._processes.pop(job.id, None)
        code = _noted_code(self._folder / job.id)
        state: State = "done" if code in (0, PARTIAL) else "interrupted" if code is None else "failed"
        self._note(msgspec.structs.replace(job, state=state, ended=time.time(), code=code))
        if state == "done" and job.then:
            self.add(job.then, job.lane, job.about)

    def _note(self, job: Job) -> Job:
        self._jobs[job.id] = job
        with suppress(OSError):  # the disk is full: the job goes on, and is known as long as this server is
            write_atomically(self._folder / job.id / "job.json", msgspec.json.encode(job))
        return job


def _not_to_be_run(job: Job) -> Job:
    """A job that another user or machine has made: to be seen, and neither begun nor ended."""
    state: State = job.state if job.has_ended else "interrupted"
    return msgspec.structs.replace(job, state=state, pid=0, born="", then=())


def _process_of(folder: Path) -> subprocess.Popen[bytes]:
    """A job, begun in a process group of its own."""
    with (folder / "log").open("wb") as log, (folder / "out").open("wb") as out:
        return subprocess.Popen(
            [sys.executable, "-m", "flysid.studio.runner", PROGRAM, str(folder.absolute())],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=log,
            start_new_session=True,
        )


def _noted_code(folder: Path) -> int | None:
    try:
        return int(json.loads((folder / NOTE).read_bytes())["code"])
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _end_group(job: Job) -> None:
    """Ask the process group of a job to end, then kill it."""
    if not job.pid or not _is_alive(job):
        return
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(job.pid, number)
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            with suppress(ChildProcessError):
                os.waitpid(job.pid, os.WNOHANG)
            if not group_exists(job.pid):
                return
            time.sleep(0.02)


def group_exists(pid: int) -> bool:
    """Whether a process of a group still runs; one that has ended and was not fetched yet does not."""
    try:
        os.killpg(pid, 0)
    except (ProcessLookupError, PermissionError):
        return False
    if not Path("/proc/self/stat").exists():
        return True
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError):
            fields = (place / "stat").read_text("utf-8", errors="replace").rpartition(")")[2].split()
            if int(fields[2]) == pid and fields[0] != "Z":
                return True
    return False


def _is_alive(job: Job) -> bool:
    """Whether the job's own process is there: its number may have been given to another since."""
    return bool(job.born) and _born(job.pid) == job.born


def _born(pid: int) -> str:
    """When a process began, in the system's own count; "" where it is gone or has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text("utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return _born_elsewhere(pid)
    return "" if fields[0] == "Z" else fields[19]


def _born_elsewhere(pid: int) -> str:
    """As `_born` where there is no /proc: ps knows."""
    if Path("/proc/self").exists():
        return ""
    found = subprocess.run(["ps", "-o", "lstart=", "-p", str(pid)], capture_output=True, check=False)
    return found.stdout.decode(errors="replace").strip()
