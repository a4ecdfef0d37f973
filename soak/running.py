"""Runs of tests in a tree: in a process that imports it anew, or in one that has loaded it, with a patch."""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NoReturn

import pytest

from soak.mutating import Mutant
from soak.patching import find_patch, import_all
from soak.ready import ONE_THREAD, forget_ours, run_pytest
from soak.selected import FAILED_FILE, NAMES_FILE, files_of

START_S = 10.0
"""CPU until the first test runs: imports, and kernels compiled anew."""
PATIENCE = 2.0
"""A run ends after so many times its expected CPU, or ten times that on the clock: others compute, too."""

OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "-p", "soak.selected")


@dataclass(frozen=True)
class Ran:
    """A run of pytest: whether none failed, what failed, the CPU seconds of it and its children."""

    passed: bool
    failed: list[str]
    cpu_s: float


def run_tests(
    tree: Path, names: Sequence[str], expected_s: float, prepare: Callable[[], None] = forget_ours
) -> Ran:
    """Run tests in a tree until the first fails; what takes far longer than expected fails, too.

    Parameters
    ----------
    names : node ids.
    expected_s : CPU seconds.
    prepare : is called in the process of the run, before pytest.
    """
    limit_s = int(PATIENCE * (START_S + expected_s))
    began = _children_s()
    with tempfile.TemporaryDirectory() as place:
        wanted, failed = Path(place) / "names", Path(place) / "failed"
        wanted.write_text("\n".join(names), "utf-8")
        failed.touch()
        environment = environment_of(tree) | {NAMES_FILE: str(wanted), FAILED_FILE: str(failed)}
        code = run_pytest(tree, [*OPTIONS, *files_of(names)], environment, limit_s, prepare)
        blamed = failed.read_text("utf-8").splitlines()
    passed = code in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
    return Ran(passed, blamed, _children_s() - began)


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def environment_of(tree: Path) -> dict[str, str]:
    """Of processes whose code is that of a tree."""
    return os.environ | ONE_THREAD | {"PYTHONPATH": str(tree)}


class Loaded:
    """A process that has imported a tree; every run of tests is a fork of it, with one function changed.

    Examples
    --------
    >>> with Loaded(tree) as loaded:
    ...     loaded.run(mutant, ["tests/model/test_line.py"], 3.0)
    """

    def __init__(self, tree: Path) -> None:
        self._tree = tree
        self._asking, answering = Pipe()
        self._pid = os.fork()
        if not self._pid:
            self._asking.close()
            _serve(tree, answering)
        answering.close()

    def __enter__(self) -> Loaded:
        return self

    def __exit__(self, *error: object) -> None:
        """End the process."""
        self._asking.close()
        os.waitpid(self._pid, 0)

    def can(self, mutant: Mutant) -> bool:
        """Whether a change can be made without importing anything anew."""
        return bool(self._ask(mutant, [], 0.0))

    def run(self, mutant: Mutant | None, names: Sequence[str], expected_s: float) -> Ran:
        """Run tests with a change that can be made, or without one, as `run_tests` does."""
        found: Ran = self._ask(mutant, list(names), expected_s)
        return found

    def _ask(self, *question: object) -> Any:
        self._asking.send(question)
        return self._asking.recv()


def _serve(tree: Path, answering: Connection) -> NoReturn:
    """Answer until nobody asks any more."""
    try:
        forget_ours(kept="soak")
        del sys.modules["soak.selected"]  # pytest warns of plugins that it finds loaded
        sys.path.insert(0, str(tree))
        import_all(tree)
        while True:
            mutant, names, expected_s = answering.recv()
            patch = mutant and find_patch(tree, mutant)
            prepare = patch.apply if patch else _leave
            answering.send(run_tests(tree, names, expected_s, prepare) if names else bool(patch))
    except EOFError:
        os._exit(0)
    except BaseException:  # noqa: BLE001 - whatever ends this process, it says so
        traceback.print_exc()  # the last words of this process
    finally:
        os._exit(1)


def _leave() -> None:
    """Change nothing."""
