"""What a hostile log could make a reader do, as tasks for worker processes."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from flysid.errors import WriteError
from flysid.ingest.formats.base import Limits
from flysid.ingest.lake.batch import Job, Result, Task, ingest_one


def act(kind: str) -> str:
    """Do what `kind` says; whatever returns, returns `kind`."""
    if kind == "endless":
        while True:
            time.sleep(0.05)
    if kind == "grows":
        held = []
        while True:
            held.append(bytearray(os.urandom(1) * (16 << 20)))
    if kind == "huge":
        try:
            bytearray(1 << 40)
        except MemoryError:
            return "refused"
    if kind == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if kind == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "exit":
        os._exit(9)
    if kind == "raise":
        raise WriteError("disk full", path="there")
    return kind


def read_or_act(job: Task, data: Path) -> Result:
    """Ingest a log, unless its name says what to do instead."""
    assert isinstance(job, Job)
    if job.path.stem in ("endless", "grows", "crash", "killed", "exit"):
        (data / "flights" / f".incoming-{job.path.stem}-{os.getpid()}").mkdir()
        act(job.path.stem)
    return ingest_one(job, data, Limits(), replace=False)
