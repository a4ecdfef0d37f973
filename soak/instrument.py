"""Counts how often each block of `flysid/ingest` runs, at a twentieth of a tracer's cost.

Sources are rewritten as they are imported: every branch, loop body, handler and operand of `and`, `or` and
conditional expressions adds to its place in `HITS`. `install` must come before the first import of a reader.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType, ModuleType

PACKAGE = "flysid.ingest."
NAME = "__hits__"
COMPILED = "numba"  # modules that are compiled cannot count
HITS: list[int] = []


def hit(place: int) -> None:
    """Count one block; None, so that it can stand in an expression."""
    HITS[place] += 1


def reset() -> None:
    """Forget all counts."""
    HITS[:] = [0] * len(HITS)


def taken() -> set[tuple[int, int]]:
    """(place, magnitude of its count) of every block that ran since `reset`."""
    return {(place, count.bit_length()) for place, count in enumerate(HITS) if count}


class _Counting(ast.NodeTransformer):
    """Adds counts inside functions; what is outside runs once, at import."""

    def _count(self) -> ast.stmt:
        return ast.Expr(self._call())

    def _call(self) -> ast.Call:
        HITS.append(0)
        return ast.Call(ast.Name(NAME, ast.Load()), [ast.Constant(len(HITS) - 1)], [])

    def _within(self, value: ast.expr) -> ast.expr:
        return ast.BoolOp(ast.Or(), [self._call(), value])

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        body = [self._inside(s) for s in node.body]
        node.body = [body[0], self._count(), *body[1:]] if ast.get_docstring(node) else [self._count(), *body]
        return node

    def _inside(self, node: ast.stmt) -> ast.stmt:
        found: ast.stmt = _Blocks(self).visit(node)
        return found


class _Blocks(ast.NodeTransformer):
    """The transformation of one function's statements."""

    def __init__(self, owner: _Counting) -> None:
        self._owner = owner

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        return self._owner.visit_FunctionDef(node)

    def visit_If(self, node: ast.If) -> ast.AST:
        self.generic_visit(node)
        node.body.insert(0, self._owner._count())
        node.orelse.insert(0, self._owner._count())
        return node

    def _body(self, node: ast.For | ast.While | ast.ExceptHandler | ast.match_case) -> ast.AST:
        self.generic_visit(node)
        node.body.insert(0, self._owner._count())
        return node

    visit_For = visit_While = visit_ExceptHandler = visit_match_case = _body

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        node.values = [node.values[0], *(self._owner._within(value) for value in node.values[1:])]
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        self.generic_visit(node)
        node.body, node.orelse = self._owner._within(node.body), self._owner._within(node.orelse)
        return node


def counting(source: str, path: str) -> CodeType:
    """The code of a module that calls `__hits__` with the place of every block that it reaches."""
    return compile(ast.fix_missing_locations(_Counting().visit(ast.parse(source, path))), path, "exec")


class _Loader(SourceFileLoader):
    """Compiles the rewritten source, past all caches."""

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002
        return counting(self.get_data(self.path).decode(), self.path)

    def exec_module(self, module: ModuleType) -> None:
        setattr(module, NAME, hit)
        super().exec_module(module)


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(PACKAGE):
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        loader = spec.loader if spec is not None else None
        if spec is None or not isinstance(loader, SourceFileLoader):
            return spec
        if COMPILED.encode() not in loader.get_data(loader.path):
            spec.loader = _Loader(loader.name, loader.path)
        return spec


def install() -> None:
    """Count from the next import on. Raises RuntimeError where readers are there already."""
    if any(name.startswith(PACKAGE) for name in sys.modules):
        raise RuntimeError("readers are imported already: they would not be counted")
    sys.meta_path.insert(0, _Finder())
