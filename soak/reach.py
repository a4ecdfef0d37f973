"""Which tests reach a line of `model/` and `validate/`: coverage with one context a test, kept as a file.

As a pytest plugin (`-p soak.reach`, with the variable REACH_FILE set) it notes, for every test that passes,
the lines that it reaches and the CPU seconds that it takes. What a fixture of a class, a module or the
session reaches counts for every test that uses the fixture, and what a door's processes reach for the door.

A map is measured once. Later code takes it over: lines that did not change keep their tests, and only new and
changed files of tests are measured again.

Coverage does not see inside compiled kernels, and what runs once, at import (constants, defaults), belongs to
no test. For these `Reach.tests_of` takes the tests that reach a line which names the kernel or the constant.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import tempfile
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from functools import cached_property
from pathlib import Path
from typing import Any

import coverage
import pytest

from soak.private_tree import imported, module_name

FOLDERS = ("model", "validate")
"""Whose lines are noted."""
REACH_FILE = "REACH_FILE"
DOORS = "tests/doors"
"""Whose tests start processes: what these reach is noted where `STARTED` lies on their path."""
STARTED = {"sitecustomize.py": "import coverage\n\ncoverage.process_startup()\n"}
_NONE = ""


@dataclass(frozen=True)
class Place:
    """Lines of one statement (without the statements inside), and what it belongs to.

    Attributes
    ----------
    path : of the file, from the root of the repository, e.g. `model/arx.py`.
    first, last : its lines, from 1.
    names : what stands for these lines where they are not seen to run: the names of the functions around it
        (the innermost first), or of the constant or field that the statement sets.
    """

    path: str
    first: int
    last: int
    names: tuple[str, ...] = ()


@dataclass
class Mentions:
    """Which statements of `model/` and `validate/` read a name: alone, after a dot, or as a keyword.

    Attributes
    ----------
    places : name -> statements.
    imports : file -> modules that it imports.
    """

    places: dict[str, list[Place]] = field(default_factory=dict)
    imports: dict[str, set[str]] = field(default_factory=dict)

    @classmethod
    def find(cls, root: Path) -> Mentions:
        """Read all files."""
        found = cls()
        for file in sorted(file for folder in FOLDERS for file in (root / folder).rglob("*.py")):
            path = file.relative_to(root).as_posix()
            tree = ast.parse(file.read_bytes())
            found.imports[path] = imported(tree)
            for node, place in find_places(tree, path).items():
                name = _name_read(node)
                if name:
                    found.places.setdefault(name, []).append(place)
        return found

    def of(self, name: str, path: str) -> list[Place]:
        """Where a name of a file is read: there and where it is imported; if nowhere, under any such name."""
        module = module_name(path)
        every = self.places.get(name, [])
        near = [p for p in every if p.path == path or module in self.imports[p.path]]
        return near or every


@dataclass
class Reach:
    """Tests, and the lines that they reach.

    Attributes
    ----------
    seconds : node id of every test that passed -> its CPU seconds, measured under coverage.
    lines : file -> line -> node ids.
    texts : file -> its lines as they were measured.
    files : file of tests -> digest of what was measured.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    lines: dict[str, dict[int, list[str]]] = field(default_factory=dict)
    texts: dict[str, list[str]] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, files: Iterable[Path]) -> Reach:
        """What several runs of the plugin wrote, as one."""
        whole = cls()
        for file in files:
            part = json.loads(file.read_text("utf-8"))
            names = list(part["seconds"])
            whole.seconds.update(part["seconds"])
            whole.texts.update(part["texts"])
            whole.files.update(part["files"])
            for path, lines in part["lines"].items():
                kept = whole.lines.setdefault(path, {})
                for line, tests in lines.items():
                    kept.setdefault(int(line), []).extend(names[k] for k in tests)
        return whole

    def write(self, file: Path) -> None:
        """Write JSON, tests as numbers."""
        number = {name: k for k, name in enumerate(self.seconds)}
        lines = {
            path: {line: [number[name] for name in tests] for line, tests in kept.items()}
            for path, kept in self.lines.items()
        }
        whole = {"seconds": self.seconds, "lines": lines, "texts": self.texts, "files": self.files}
        file.write_text(json.dumps(whole), "utf-8")

    def taken_over(self, root: Path) -> Reach:
        """What still holds in a tree of later code: unchanged lines, unchanged files of tests."""
        files = {name: digest for name, digest in self.files.items() if digest_of(root / name) == digest}
        seconds = {name: s for name, s in self.seconds.items() if name.partition("::")[0] in files}
        taken = Reach(seconds, files=files)
        for path, kept in self.lines.items():
            if not (root / path).exists():
                continue
            taken.texts[path] = lines_of(root / path)
            place = _places_now(self.texts[path], taken.texts[path])
            taken.lines[path] = {
                place[line]: [name for name in tests if name in seconds]
                for line, tests in kept.items()
                if line in place
            }
        return taken

    @cached_property
    def reached(self) -> dict[str, int]:
        """Node id -> how many lines the test reaches: few tell that it is about these."""
        counts = dict.fromkeys(self.seconds, 0)
        for kept in self.lines.values():
            for tests in kept.values():
                for name in tests:
                    counts[name] += 1
        return counts

    def tests_of(self, place: Place, mentions: Mentions) -> list[str]:
        """Tests that reach a place, those first that reach little else and cost little.

        Parameters
        ----------
        place : see Place.
        mentions : of the same tree.

        Returns
        -------
        Node ids; behind those that reach the place come the others of the same files, which may share with
        them what a file computes once.
        """
        found = self._direct(place) or self._by_name(place, mentions)
        files = {name.partition("::")[0] for name in found}
        beside = {name for name in self.seconds if name.partition("::")[0] in files} - found
        near = {name for name in beside if not name.startswith(DOORS)}  # doors share nothing
        return [name for group in (found, near) for name in sorted(group, key=self._price)]

    def _price(self, name: str) -> tuple[float, str]:
        """Lines reached times seconds: few lines tell that a test is about these, and a second buys many."""
        return self.reached[name] * self.seconds[name], name

    def _direct(self, place: Place) -> set[str]:
        kept = self.lines.get(place.path, {})
        return {name for line in range(place.first, place.last + 1) for name in kept.get(line, [])}

    def _by_name(self, place: Place, mentions: Mentions) -> set[str]:
        """Tests of the lines that name what the place belongs to; through kernels that call kernels."""
        seen: set[tuple[str, str]] = set()
        waiting = [place]
        found: set[str] = set()
        while waiting:
            at = waiting.pop()
            for name in at.names:
                if (at.path, name) in seen:
                    continue
                seen.add((at.path, name))
                for other in mentions.of(name, at.path):
                    tests = self._direct(other)
                    found |= tests
                    waiting += [] if tests else [other]
        return found


def digest_of(file: Path) -> str:
    """Of a file's content; "" where it is not there."""
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.exists() else ""


def lines_of(file: Path) -> list[str]:
    """The lines of a file of code."""
    return file.read_text("utf-8").splitlines()


def _places_now(old: list[str], new: list[str]) -> dict[int, int]:
    """Line of a text -> line of a later one, from 1, of those that are in both."""
    blocks = SequenceMatcher(None, old, new, autojunk=False).get_matching_blocks()
    return {block.a + k + 1: block.b + k + 1 for block in blocks for k in range(block.size)}


def find_places(tree: ast.Module, path: str) -> dict[ast.AST, Place]:
    """Every node of a module -> the statement that holds it."""
    places: dict[ast.AST, Place] = {}

    def walk(node: ast.AST, place: Place, functions: tuple[str, ...]) -> None:
        if isinstance(node, ast.stmt):
            inner = [
                n for name in ("body", "orelse", "finalbody", "handlers") for n in getattr(node, name, [])
            ]
            last = min((n.lineno - 1 for n in inner), default=node.end_lineno or node.lineno)
            place = Place(path, node.lineno, max(node.lineno, last), functions or _targets(node))
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                functions = (node.name, *functions)
                is_class = isinstance(node, ast.ClassDef)
                last = place.last if is_class else node.end_lineno or place.last  # defaults act in the body
                place = Place(path, place.first, last, functions)
                functions = () if is_class else functions
        places[node] = place
        for child in ast.iter_child_nodes(node):
            walk(child, place, functions)

    walk(tree, Place(path, 0, 0), ())
    return places


def _targets(node: ast.stmt) -> tuple[str, ...]:
    targets: list[ast.expr] = []
    if isinstance(node, ast.Assign):
        targets = node.targets
    elif isinstance(node, ast.AnnAssign | ast.AugAssign):
        targets = [node.target]
    return tuple(n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name))


def _name_read(node: ast.AST) -> str | None:
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
        return node.id
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
        return node.attr
    return node.arg if isinstance(node, ast.keyword) else None


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
        began = _cpu_seconds()
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
            self._seconds[item.nodeid] = _cpu_seconds() - began
            self._switch(_NONE)

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
        files = {name.partition("::")[0] for name in self._seconds}
        reach = Reach(passed, files={name: digest_of(self._root / name) for name in sorted(files)})
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
