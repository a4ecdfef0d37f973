"""What costs seconds is made once in a run of the tests, by the first worker that wants it."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest
from filelock import FileLock

T = TypeVar("T")


def make_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """A folder that `make` has filled; other workers wait for it and read it.

    What was shared is not to be changed.
    """
    own = factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / f"shared-{name}"
    with FileLock(folder.with_suffix(".lock")):
        ready = folder / "ready"
        if not ready.exists():
            folder.mkdir(exist_ok=True)
            make(folder)
            ready.touch()
    return folder


def find_once(factory: pytest.TempPathFactory, name: str, find: Callable[[], T]) -> T:
    """What `find` returns, found by the first worker that wants it; every worker gets a copy of its own."""

    def write(to: Path) -> None:
        (to / "found").write_bytes(pickle.dumps(find()))

    folder = make_once(factory, name, write)
    found: T = pickle.loads((folder / "found").read_bytes())
    return found
