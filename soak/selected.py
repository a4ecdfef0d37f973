"""A pytest plugin (`-p soak.selected`): runs the tests that a file names, in its order, and notes what fails.

Names that are not there are passed over: a changed constant may have changed the name of a case. A name may
be a test, a file or a folder.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import pytest

NAMES_FILE = "SELECTED_NAMES"
FAILED_FILE = "SELECTED_FAILED"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep those that are named."""
    names = Path(os.environ[NAMES_FILE]).read_text("utf-8").split("\n")
    place = {name: k for k, name in enumerate(names)}
    found = {item: _place(item.nodeid, place) for item in items}
    config.hook.pytest_deselected(items=[item for item, k in found.items() if k is None])
    kept = [(k, n, item) for n, (item, k) in enumerate(found.items()) if k is not None]
    items[:] = [item for _, _, item in sorted(kept, key=lambda entry: entry[:2])]


def _place(nodeid: str, places: dict[str, int]) -> int | None:
    """That of the test, of its file or of a folder above."""
    file = nodeid.partition("::")[0]
    above = [folder.as_posix() for folder in Path(file).parents]
    return next((places[name] for name in (nodeid, file, *above) if name in places), None)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note a failure."""
    _note(report)


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Note a file that cannot be imported."""
    _note(report)


def _note(report: pytest.TestReport | pytest.CollectReport) -> None:
    if report.failed:
        with Path(os.environ[FAILED_FILE]).open("a", encoding="utf-8") as file:
            file.write(report.nodeid + "\n")


def files_of(names: Sequence[str]) -> list[str]:
    """The files and folders that names are in, for the command line."""
    return list(dict.fromkeys(name.partition("::")[0] for name in names))
