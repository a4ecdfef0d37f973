"""Processes of flysid that need not import the libraries of others: `python -m tests.forked` has, and forks.

For trials of what only a process of its own shows (what is installed beside flysid, the exit code), where the
start of the interpreter is not the matter. Everything of flysid's own is imported anew in each.
"""

from __future__ import annotations

import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

LIBRARIES = (
    "click",
    "filelock",
    "jinja2",
    "msgspec",
    "numba",
    "pyarrow.compute",
    "pyarrow.parquet",
    "scipy.fft",
    "scipy.linalg",
    "scipy.signal",
    "scipy.special",
    "tomllib",
)
"""Those that take longest, and read nothing of the working folder when they are imported."""
LONGEST_S = 300
ROOT = Path(__file__).resolve().parents[1]
Done = subprocess.CompletedProcess[str]


class Forks:
    """`flysid WORDS` in forks of one process, each with its own folder, environment and modules."""

    def __init__(self) -> None:
        self.source = subprocess.Popen(
            [sys.executable, "-m", "tests.forked"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"},
        )

    def run(self, module: str, words: tuple[str, ...], cwd: Path, environment: Mapping[str, str]) -> Done:
        """`python -m MODULE WORDS`, until it ends."""
        assert self.source.stdin is not None
        assert self.source.stdout is not None
        with tempfile.TemporaryDirectory() as folder:
            out, err = (Path(folder, name) for name in ("out", "err"))
            order = [module, words, str(cwd), dict(environment), str(out), str(err)]
            self.source.stdin.write(json.dumps(order) + "\n")
            self.source.stdin.flush()
            code = int(self.source.stdout.readline())
            return Done([module, *words], code, out.read_text("utf-8"), err.read_text("utf-8"))


@contextmanager
def forking() -> Iterator[Forks]:
    """Within the block there is a process that forks."""
    forks = Forks()
    try:
        yield forks
    finally:
        forks.source.communicate()


def serve() -> None:
    """One fork for each line that is read."""
    for name in LIBRARIES:
        importlib.import_module(name)
    for line in sys.stdin:
        fork = os.fork()
        if not fork:
            become(*json.loads(line))
        _, status = os.waitpid(fork, 0)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(status)}\n")
        sys.stdout.flush()


def become(
    module: str, words: list[str], cwd: str, environment: dict[str, str], out: str, err: str
) -> NoReturn:
    """Run the module as a fresh interpreter would, and end."""
    signal.alarm(LONGEST_S)
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(environment)
    asked = environment["PYTHONPATH"].split(os.pathsep)
    sys.path[:] = [*asked, *(path for path in sys.path if path not in asked)]
    for number, file in ((0, os.devnull), (1, out), (2, err)):
        os.dup2(os.open(file, os.O_RDWR | os.O_CREAT), number)
    sys.argv = [module, *words]
    code: object = 0
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as end:
        code = end.code
    except BaseException:  # noqa: BLE001 - printed, as an interpreter does
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 1)


if __name__ == "__main__":
    serve()
