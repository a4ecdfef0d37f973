"""Which tests reach a line of `model/` and `validate/`: coverage with one context a test, kept as a file.

A map is measured once, by `soak.recorder`. Later code takes it over: lines that did not change keep their
tests, and only new and changed files of tests are measured again.

Coverage does not see inside compiled kernels, and what runs once, at import (constants, defaults), belongs to
no test. For these `Reach.tests_of` takes the tests that reach a line which names the kernel or the constant,
and those that name it themselves.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from functools import cached_property
from pathlib import Path

from soak.private_tree import imported, module_name

FOLDERS = ("model", "validate")
"""Whose lines are noted."""
DOORS = "tests/doors"
"""Whose tests start processes."""


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
    tests : full name, as `flysid.model.arx.SIZE` -> beginnings of the node ids of tests that read it.
    """

    places: dict[str, list[Place]] = field(default_factory=dict)
    imports: dict[str, set[str]] = field(default_factory=dict)
    tests: dict[str, set[str]] = field(default_factory=dict)

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
        for file in sorted((root / "tests").rglob("test_*.py")):
            for full, test in _names_in_tests(
                ast.parse(file.read_bytes()), file.relative_to(root).as_posix()
            ):
                found.tests.setdefault(full, set()).add(test)
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
    seconds : node id of every test that passed -> its CPU seconds, measured under coverage, without what it
        shares.
    shared : what several tests share -> its CPU seconds: a file, which is collected, and fixtures of a class,
        a module or the session.
    needs : node id -> what of this it needs.
    lines : file -> line -> node ids.
    texts : file -> its lines as they were measured.
    files : file of tests -> digest of what was measured.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    shared: dict[str, float] = field(default_factory=dict)
    needs: dict[str, tuple[str, ...]] = field(default_factory=dict)
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
            whole.shared.update(part["shared"])
            whole.needs.update({name: tuple(needs) for name, needs in part["needs"].items()})
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
        whole = {
            "seconds": self.seconds,
            "shared": self.shared,
            "needs": self.needs,
            "lines": lines,
            "texts": self.texts,
            "files": self.files,
        }
        file.write_text(json.dumps(whole), "utf-8")

    def taken_over(self, root: Path) -> Reach:
        """What still holds in a tree of later code: unchanged lines, unchanged files of tests."""
        files = {name: digest for name, digest in self.files.items() if digest_of(root / name) == digest}
        seconds = {name: s for name, s in self.seconds.items() if file_of(name) in files}
        needs = {name: self.needs[name] for name in seconds}
        taken = Reach(seconds, dict(self.shared), needs, files=files)
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
        """Node ids of the tests that reach a place.

        Parameters
        ----------
        place : see Place.
        mentions : of the same tree.
        """
        return sorted(self._direct(place) or self._by_name(place, mentions))

    def affordable(self, names: Iterable[str], left_s: float, paid: set[str]) -> list[str]:
        """The tests that buy most for their seconds, at least one where there is one.

        A test is worth the more, the fewer lines it reaches: it is about these. The second case of a test is
        worth half as much, and so on. What tests share is paid by the first of them.

        Parameters
        ----------
        left_s : CPU seconds.
        paid : what is shared and was computed already; what these tests need comes in.
        """
        waiting: dict[tuple[str, ...], list[str]] = {}
        for name in sorted(names, key=self._price_alone, reverse=True):
            waiting.setdefault(self.needs[name], []).append(name)
        cases: Counter[str] = Counter()
        chosen: list[str] = []

        def cost(name: str) -> float:
            return self.seconds[name] + sum(self.shared[n] for n in self.needs[name] if n not in paid)

        def price(name: str) -> float:
            return self.reached[name] * cost(name) * (1 + cases[_test_of(name)])

        while waiting:
            needs = min(waiting, key=lambda needs: price(waiting[needs][-1]))
            name = waiting[needs].pop()
            if not waiting[needs]:
                del waiting[needs]
            if chosen and cost(name) > left_s:
                continue
            left_s -= cost(name)
            paid.update(needs)
            cases[_test_of(name)] += 1
            chosen.append(name)
        return chosen

    def side_by_side(self, names: list[str]) -> list[str]:
        """In an order in which nothing that is shared is made twice: by file, then by what is shared."""
        place: dict[object, int] = {}
        for k, name in enumerate(names):
            place.setdefault(file_of(name), k)
            place.setdefault(self.needs[name], k)
        return sorted(names, key=lambda name: (place[file_of(name)], place[self.needs[name]]))

    def _price_alone(self, name: str) -> tuple[float, str]:
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
                naming = mentions.tests.get(f"{module_name(at.path)}.{name}", set())
                found |= {test for test in self.seconds if {file_of(test), _test_of(test)} & naming}
                for other in mentions.of(name, at.path):
                    tests = self._direct(other)
                    found |= tests
                    waiting += [] if tests else [other]
        return found


def file_of(name: str) -> str:
    """`a.py` of the node id `a.py::test[case]`."""
    return name.partition("::")[0]


def _test_of(name: str) -> str:
    """Without its case."""
    return name.partition("[")[0]


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


def _names_in_tests(tree: ast.Module, path: str) -> Iterator[tuple[str, str]]:
    """What a file of tests imports by name, and the test that reads it, or the file where a helper does."""
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    full = {name.asname or name.name: f"{node.module}.{name.name}" for node in imports for name in node.names}
    for node in tree.body:
        test = path
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test"):
            test = f"{path}::{node.name}"
        names = (n.id for n in ast.walk(node) if isinstance(n, ast.Name))
        yield from ((full[name], test) for name in names if name in full)


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
