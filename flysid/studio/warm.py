"""Jobs that read logs, forked from a process that has imported what they need (Linux).

`python -m flysid.studio.warm` says "ready" when it has. Then every line of its input is the folder of a job:
it forks the job and says its process id. It ends with its input; its jobs do not.
"""

from __future__ import annotations

import importlib
import os
import runpy
import select
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from flysid.ingest.lake.workers import fork_from_here
from flysid.studio.runner import note, words_of

NEEDED = ("flysid.cli.ingest", "flysid.ingest.lake.batch", "flysid.studio.quick_look", "filelock")


class Warm:
    """Such a process, begun."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "flysid.studio.warm"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
            text=True,
        )
        self._is_ready = False

    @property
    def pid(self) -> int:
        return self._process.pid

    def begin(self, folder: Path) -> int:
        """The process id of a job that has been begun, in a group of its own; 0 where that cannot be."""
        asked, told = self._process.stdin, self._process.stdout
        assert asked is not None
        assert told is not None
        try:
            if not self._is_ready and not (select.select([told], [], [], 0.0)[0] and told.readline()):
                return 0
            self._is_ready = True
            asked.write(f"{folder.absolute()}\n")
            asked.flush()
            return int(told.readline() or 0)
        except OSError:  # it is gone
            return 0

    def close(self) -> None:
        """Let it end, at once where it still imports."""
        if not self._is_ready:
            self._process.terminate()
        with suppress(BrokenPipeError):
            self._process.communicate()


def main() -> None:
    """Fork jobs on request."""
    for module in NEEDED:
        importlib.import_module(module)
    fork_from_here()  # a job's workers
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # a job that has ended is gone at once
    _say("ready")
    for line in iter(sys.stdin.readline, ""):
        begun, begins = os.pipe()
        job = os.fork()
        os.close(begun if not job else begins)
        if not job:
            os.setsid()
            folder = Path(line.rstrip("\n"))
            _redirect(folder)
            os.close(begins)
            _do(folder)
            break
        os.read(begun, 1)  # until the job has closed it: it is a group of its own, and holds no pipe
        os.close(begun)
        _say(str(job))


def _say(word: str) -> None:
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


def _redirect(folder: Path) -> None:
    """What a job prints goes into its folder."""
    for number, name in enumerate((os.devnull, "out", "log")):
        handle = os.open(folder / name, os.O_RDWR | os.O_CREAT, 0o666)
        os.dup2(handle, number)
        os.close(handle)


def _do(folder: Path) -> None:
    """A job: its command in a process of its own, and a note how that has ended."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    command = os.fork()
    if command:
        _, status = os.waitpid(command, 0)
        note(folder, os.waitstatus_to_exitcode(status))
        return
    sys.argv = ["flysid", *words_of(folder)]
    runpy.run_module("flysid", run_name="__main__")


if __name__ == "__main__":
    main()
