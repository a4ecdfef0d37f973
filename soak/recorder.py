"""Measures the map of `soak.reach`: a pytest plugin (`-p soak.recorder`, with REACH_FILE in the environment).

It notes, for every test that passes, the lines that it reaches and the CPU seconds that it takes. What a
fixture of a class, a module or the session reaches counts for every test that uses the fixture, and what a
door's processes reach for the door. The seconds of such fixtures and of collection are noted apart.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import coverage
import pytest

from soak.reach import DOORS, FOLDERS, Reach, digest_of, file_of, lines_of

REACH_FILE = "REACH_FILE"
STARTED = {"sitecustomize.py": "import coverage\n\ncoverage.process_startup()\n"}
"""What lies on the path of the processes that doors start, so that they are noted."""
_NONE = ""


def _cpu_seconds() -> float:
    """CPU time of this process and of those that it waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class Recorder:
    """Notes the lines of every test; a pytest plugin."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._root = Path.cwd()
        self._context = _NONE
        self._seconds: dict[str, float] = {}
        self._shared: dict[str, float] = {}
        self._apart_s = 0.0
        self._failed: set[str] = set()
        self._users: dict[str, tuple[str, str]] = {}
        self._fixtures: dict[str, list[str]] = {}
        self._started: dict[str, dict[str, set[int]]] = {}
        include = [str(self._root / folder / "*") for folder in FOLDERS]
        self._include = include
        self._coverage = coverage.Coverage(data_file=None, config_file=False, include=include)
        self._coverage.start()

    def _switch(self, context: str) -> None:
        self._context = context
        self._coverage.switch_context(context)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """One context for the test."""
        self._fixtures[item.nodeid] = list(getattr(item, "fixturenames", []))
        self._switch(item.nodeid)
        began, apart_s = _cpu_seconds(), self._apart_s
        try:
            if not item.nodeid.startswith(DOORS):
                return (yield)
            with tempfile.TemporaryDirectory() as place:
                self._watch_started(Path(place))
                try:
                    return (yield)
                finally:
                    del os.environ["COVERAGE_PROCESS_START"]
                    self._started[item.nodeid] = dict(_lines_in(Path(place)))
        finally:
            self._seconds[item.nodeid] = max(0.0, _cpu_seconds() - began - (self._apart_s - apart_s))
            self._switch(_NONE)

    @contextmanager
    def _apart(self, name: str) -> Iterator[None]:
        """What is computed inside is shared: it has seconds of its own, less those of what it uses."""
        began, apart_s = _cpu_seconds(), self._apart_s
        try:
            yield
        finally:
            whole_s = _cpu_seconds() - began
            own_s = max(0.0, whole_s - (self._apart_s - apart_s))
            self._shared[name] = self._shared.get(name, 0.0) + own_s
            self._apart_s = apart_s + whole_s

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(self, collector: pytest.Collector) -> Generator[None, object, object]:
        """What the collection of a file costs."""
        with self._apart(file_of(collector.nodeid)):
            return (yield)

    def _watch_started(self, place: Path) -> None:
        """Have processes that begin now note their lines there."""
        settings = place / "settings"
        include = "".join(f"\n    {pattern}" for pattern in self._include)
        settings.write_text(
            f"[run]\nparallel = True\nsigterm = True\nconcurrency =\n    multiprocessing\n    thread\n"
            f"data_file = {place / 'lines'}\ninclude ={include}\n",
            "utf-8",
        )
        os.environ["COVERAGE_PROCESS_START"] = str(settings)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
    ) -> Generator[None, object, object]:
        """A context of its own for what several tests share."""
        if fixturedef.scope == "function":
            return (yield)
        outer = self._context
        context = f"{fixturedef.argname} of {request.node.nodeid}"
        self._users[context] = (request.node.nodeid, fixturedef.argname)
        self._switch(context)
        try:
            with self._apart(context):
                return (yield)
        finally:
            self._switch(outer)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test that fails or is skipped here selects nothing."""
        if not report.passed:
            self._failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        """Write the file."""
        self._coverage.stop()
        passed = {name: s for name, s in self._seconds.items() if name not in self._failed}
        files = {file_of(name) for name in self._seconds}
        needs: dict[str, list[str]] = {name: [file_of(name)] for name in passed}
        for context in self._users:
            for name in self._tests_behind(context):
                if name in passed:
                    needs[name].append(context)
        reach = Reach(
            passed,
            self._shared,
            {name: tuple(sorted(of)) for name, of in needs.items()},
            files={name: digest_of(self._root / name) for name in sorted(files)},
        )
        data = self._coverage.get_data()
        for name in sorted(data.measured_files()):
            kept = self._kept(reach, name)
            for line, contexts in data.contexts_by_lineno(name).items():
                tests = {test for context in contexts for test in self._tests_behind(context)}
                kept.setdefault(line, []).extend(sorted(tests & passed.keys()))
        for test in sorted(self._started.keys() & passed.keys()):
            for name, lines in self._started[test].items():
                kept = self._kept(reach, name)
                for line in lines:
                    kept.setdefault(line, []).append(test)
        reach.write(self._file)

    def _kept(self, reach: Reach, name: str) -> dict[int, list[str]]:
        path = Path(name).resolve().relative_to(self._root.resolve()).as_posix()
        reach.texts.setdefault(path, lines_of(self._root / path))
        return reach.lines.setdefault(path, {})

    def _tests_behind(self, context: str) -> list[str]:
        if context not in self._users:
            return [context]
        scope, fixture = self._users[context]
        return [name for name, used in self._fixtures.items() if fixture in used and name.startswith(scope)]


def _lines_in(place: Path) -> Iterator[tuple[str, set[int]]]:
    """Files and their lines that processes have noted in a folder."""
    found: dict[str, set[int]] = {}
    for file in place.glob("lines.*"):
        data = coverage.CoverageData(str(file))
        data.read()
        for name in data.measured_files():
            found.setdefault(name, set()).update(data.lines(name) or ())
    yield from found.items()


def pytest_configure(config: pytest.Config) -> None:
    """Start before the first test imports what it tests."""
    config.pluginmanager.register(Recorder(Path(os.environ[REACH_FILE])), "reach recorder")
