"""Runs of pytest that begin in an instant: forked from a process that has loaded the libraries already.

Most of the seconds before a first test go to libraries, which no change of our own code touches. `load`
reads them once, and every run is a fork of that process. There `forget_ours` has what lies below the tree,
and that alone, imported anew.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import resource
import select
import signal
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Threads do not live on in a fork."""
OURS = ("flysid", "tests", "soak", "bench")
LIBRARIES = (
    "click",
    "jinja2",
    "matplotlib.pyplot",
    "numba",
    "numpy",
    "pandas",
    "pyarrow.parquet",
    "scipy.interpolate",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.signal",
    "scipy.special",
    "scipy.stats",
)


def load() -> None:
    """Read the libraries, single-threaded, before any other code of the process does."""
    os.environ.update(ONE_THREAD)
    os.environ.setdefault("MPLBACKEND", "agg")
    for name in LIBRARIES:
        importlib.import_module(name)
    gc.freeze()


def forget_ours(kept: str = "") -> None:
    """Forget the modules of the repository but for those of one package."""
    for name in list(sys.modules):
        package = name.partition(".")[0]
        if package in OURS and package != kept:
            del sys.modules[name]


def run_pytest(
    tree: Path,
    arguments: Sequence[str],
    environment: Mapping[str, str],
    limit_s: int,
    prepare: Callable[[], None] = forget_ours,
) -> int:
    """The exit code of a run in a tree; that of a signal is negative.

    Parameters
    ----------
    environment : whole.
    limit_s : CPU seconds after which it is ended, or ten times that on the clock: others compute, too.
    prepare : is called in the fork, before pytest.
    """
    pid = os.fork()
    if not pid:
        _become_pytest(tree, arguments, environment, limit_s, prepare)
    with os.fdopen(os.pidfd_open(pid)) as watched:
        select.select([watched], [], [], 10 * limit_s)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # with all that it started
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def _become_pytest(
    tree: Path,
    arguments: Sequence[str],
    environment: Mapping[str, str],
    limit_s: int,
    prepare: Callable[[], None],
) -> None:
    """In the fork: run, and end."""
    code = int(pytest.ExitCode.INTERNAL_ERROR)
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(nowhere, stream)
        os.chdir(tree)
        os.environ.clear()
        os.environ.update(environment)
        sys.path[:] = [str(tree), *(path for path in sys.path if Path(path).resolve() != ROOT)]
        prepare()
        sys.modules["__main__"] = types.ModuleType("__main__")  # what processes of tests would import again
        code = int(pytest.main(list(arguments)))
    finally:
        os._exit(code)
