"""Changes of our own code in a process that has loaded it: a function's code is replaced where it stands.

Whoever imported the function sees the change, and nothing is imported anew. That holds for the bodies of
functions that Python itself runs. Constants, defaults and class bodies act while a module is imported, and
kernels are compiled: such changes need a tree of their own. Processes that a test starts do not see a patch.
"""

from __future__ import annotations

import ast
import gc
import importlib
import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FunctionType

from soak.mutating import Mutant
from soak.private_tree import has_kernels, module_name
from soak.reach import FOLDERS


@dataclass(frozen=True)
class Patch:
    """New code of functions.

    Attributes
    ----------
    functions : that live now, at least one.
    code : what they run instead.
    """

    functions: tuple[FunctionType, ...]
    code: CodeType

    def apply(self) -> None:
        """Replace it."""
        for function in self.functions:
            function.__code__ = self.code


def import_all(tree: Path) -> None:
    """Import every module whose lines are changed, from a tree that is first on the path."""
    for folder in FOLDERS:
        for file in sorted((tree / folder).rglob("*.py")):
            importlib.import_module(module_name(file.relative_to(tree).as_posix()))


def find_patch(tree: Path, mutant: Mutant) -> Patch | None:
    """The patch that makes a change; None where it needs a tree of its own.

    Parameters
    ----------
    tree : from which the code was imported.
    """
    source = (tree / mutant.place.path).read_bytes()
    if has_kernels(ast.parse(source)):
        return None
    filename = inspect.getfile(importlib.import_module(module_name(mutant.place.path)))
    old, new = (compile(text, filename, "exec") for text in (source, mutant.apply(source)))
    pairs = [pair for pair in _functions(old, new) if not _is_same(*pair)]
    if len(pairs) != 1 or not _is_same(old, new, without=pairs[0]):
        return None
    functions = _functions_of(pairs[0][0])
    return Patch(functions, pairs[0][1]) if functions else None


def _functions_of(code: CodeType) -> tuple[FunctionType, ...]:
    """Those that live, wherever they are."""
    gc.unfreeze()  # what is frozen is not among the objects
    found = (value for value in gc.get_objects() if type(value) is FunctionType)
    return tuple(f for f in found if _place_of(f.__code__) == _place_of(code))


def _place_of(code: CodeType) -> tuple[str, str, int]:
    return code.co_filename, code.co_qualname, code.co_firstlineno


def _functions(old: CodeType, new: CodeType) -> Iterator[tuple[CodeType, CodeType]]:
    """Functions of a module and of its classes, without those inside them."""
    for pair in zip(_inner(old), _inner(new), strict=True):
        if pair[0].co_flags & inspect.CO_OPTIMIZED:
            yield pair
        else:
            yield from _functions(*pair)


def _inner(code: CodeType) -> list[CodeType]:
    return [value for value in code.co_consts if isinstance(value, CodeType)]


def _is_same(old: CodeType, new: CodeType, without: tuple[CodeType, CodeType] | None = None) -> bool:
    """Whether two codes do the same, wherever they stand in their file; one pair inside may differ."""
    if (old, new) == without:
        return True
    if (old.co_code, old.co_names, len(old.co_consts)) != (new.co_code, new.co_names, len(new.co_consts)):
        return False
    for one, other in zip(old.co_consts, new.co_consts, strict=True):
        if isinstance(one, CodeType) and isinstance(other, CodeType):
            if not _is_same(one, other, without):
                return False
        elif repr(one) != repr(other):
            return False
    return True
