"""Every name in backticks in a module's header exists: a module, a name of the code, a name in a log."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOREIGN = (".c", ".h")
"""Ends of names of files that are not flysid's."""
NAME = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)`(?!`)")


def sources() -> list[Path]:
    tops = ("flysid", "ingest", "model", "validate")
    found = (path for top in tops for path in (ROOT / top).rglob("*.py"))
    return sorted({path.resolve() for path in found})


@cache
def words() -> frozenset[str]:
    """Everything that code and its texts call by name, and the names of modules and folders."""
    found: set[str] = set()
    for path in sources():
        found |= {path.stem, path.parent.name}
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            found |= set(_names(node))
    return frozenset(found)


def _names(node: ast.AST) -> Iterator[str]:
    for field in ("id", "attr", "arg", "name"):
        value = getattr(node, field, None)
        if isinstance(value, str):
            yield value
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and len(node.value) < 80:
        yield node.value
        yield from re.findall(r"[A-Za-z_]\w*", node.value)


def dead_names(header: str) -> list[str]:
    """Names in backticks that nothing bears."""
    return [name for name in NAME.findall(header) if not _exists(name)]


def _exists(name: str) -> bool:
    if name.startswith("flysid."):
        return name in words() or _resolves(name)
    if name.startswith("bench."):
        return (ROOT / f"{name.replace('.', '/')}.py").is_file()
    if name.endswith(FOREIGN):
        return True
    return all(part in words() for part in name.split(".") if part)


def _resolves(name: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    parent, _, last = name.rpartition(".")
    if _is_module(name):
        return True
    if _is_module(parent):
        return hasattr(importlib.import_module(parent), last)
    return _resolves(parent) and last in words()


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


@pytest.mark.parametrize("path", sources(), ids=lambda path: str(path.relative_to(ROOT)))
def test_the_names_in_a_header_exist(path: Path) -> None:
    header = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    assert not dead_names(header)


def test_dead_names_are_found() -> None:
    assert dead_names("Layout: see `mavframes` and `flysid.model.gone`.") == [
        "mavframes",
        "flysid.model.gone",
    ]
    assert not dead_names("See `flysid.model.structures.Structure`, `frames` and `flysid.load`.")
