"""Private copies of the repository, in which its code is changed and tested."""

from __future__ import annotations

import ast
import hashlib
import shutil
from pathlib import Path

_TESTED = ("flysid", "ingest", "model", "validate", "tests")
_LEFT_OUT = shutil.ignore_patterns(
    ".git", ".venv", ".bench", ".hypothesis", ".mypy_cache", ".pytest_cache", ".ruff_cache", "_build"
)
_SHARED = "shared"
_COMPILING = frozenset({"numba", "compiled"})
"""A module that imports one of these has kernels."""


def stamp(root: Path) -> str:
    """Sixteen digits that change with any Python file of the package or of its tests."""
    digest = hashlib.sha256()
    for file in sorted(file for folder in _TESTED for file in (root / folder).rglob("*.py")):
        digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def copy_tree(root: Path, into: Path) -> Path:
    """Copy what tests need from `root` to the new folder `into`, with what is compiled already.

    The logs that lie beside the repository lie beside the copy, too.
    """
    shutil.copytree(root, into, symlinks=True, ignore=_LEFT_OUT)
    shared = into.parent / _SHARED
    if (root.parent / _SHARED).is_dir() and not shared.exists():
        shared.symlink_to((root.parent / _SHARED).resolve(), target_is_directory=True)
    return into


def forget_compiled(tree: Path, path: str, line: int) -> list[str]:
    """Delete what was compiled from a file, and kernels of others that may have compiled its line in.

    Numba compares a kernel's own file with its cache, not the kernels and constants that it takes from
    others: kernels of the modules that import the file go too, however indirectly. Functions and classes of a
    file without kernels are in no kernel, and there they stay.

    Parameters
    ----------
    tree, path : the file, e.g. `model/arx.py` of a tree.
    line : of the change, from 1.

    Returns
    -------
    The names of the deleted files.
    """
    stale = {path, *(_importers(tree, path) if _is_compiled_in(tree / path, line) else ())}
    found = []
    for name in sorted(stale):
        file = tree / name
        kinds = ("pyc", "nbi", "nbc") if name == path else ("nbi", "nbc")
        found += [f for kind in kinds for f in (file.parent / "__pycache__").glob(f"{file.stem}.*{kind}")]
    for file in found:
        file.unlink()
    return [file.name for file in found]


def has_kernels(tree: ast.Module) -> bool:
    """Whether a module compiles functions."""
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom))
    names = {
        name for node in imports for name in (getattr(node, "module", ""), *(n.name for n in node.names))
    }
    return not names.isdisjoint(_COMPILING)


def _is_compiled_in(file: Path, line: int) -> bool:
    """Whether a kernel may hold what a line says: it is in a file with kernels, or sets a constant."""
    tree = ast.parse(file.read_bytes())
    around = next((node for node in tree.body if node.lineno <= line <= (node.end_lineno or line)), None)
    return has_kernels(tree) or not isinstance(around, ast.FunctionDef | ast.ClassDef)


def _importers(tree: Path, path: str) -> set[str]:
    """Files of the package that import a file, or import one that does."""
    imports = {
        file.relative_to(tree).as_posix(): imported(ast.parse(file.read_bytes()))
        for folder in _TESTED[:-1]
        for file in (tree / folder).rglob("*.py")
    }
    found: set[str] = set()
    waiting = [path]
    while waiting:
        module = module_name(waiting.pop())
        new = {name for name, modules in imports.items() if module in modules} - found
        found |= new
        waiting += new
    return found


def module_name(path: str) -> str:
    """`flysid.model.arx` of `model/arx.py`."""
    name = path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    return name if name.startswith("flysid") else f"flysid.{name}"


def imported(tree: ast.Module) -> set[str]:
    """Modules that a module imports, anywhere; among them names that may be modules."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
        elif isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
    return found
