"""Changes of one constant, comparison, sign, `and`, `or` or `not` of our own code: does a test notice?

A site is one node of the syntax tree; it has one or more changes:

- number: half, twice, one more, one less; truth: True for False and the reverse.
- boundary: `<` for `<=`, `>` for `>=`; comparison: the opposite (`<` and `>=`, `==` and `!=`, `is`, `in`).
- sign: `+` for `-`, also in `+=`; a minus before a term dropped.
- logic: `and` for `or`, `not` dropped.

Left out, since no result depends on it:

- text (docstrings, f-strings, what is raised, warned of or shown as progress), annotations, decorators,
  patterns of `match`, assertions, methods of protocols, and the options of `field` but for its default.
- seeds: one is as good as another.
- arguments that guard or save time, but decide nothing (`strict` of zip, `check_finite`, `copy`,
  `overwrite_*`).
- numbers where something is drawn: in functions and modules that import matplotlib or our SVG, and in our SVG
  itself. They place ink. Comparisons and logic there are changed: they decide what is drawn.

Left out, since nobody could see it:

- half and twice of a number below 1e-6 or above 1e6 in size: these keep from zero and from infinity.
- one more or less than a number above 20: within what such a number means.
- a boundary shifted beside a number that is not whole, or a constant of the module that is such a number:
  what is measured never lies on it.
"""

from __future__ import annotations

import ast
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from soak.reach import FOLDERS, Place, find_places

_FREE_ARGUMENTS = frozenset({"strict", "check_finite", "copy", "overwrite_a", "overwrite_b", "overwrite_x"})
_SEED_ARGUMENTS = frozenset({"seed", "random_state"})
_SEEDED = frozenset({"default_rng", "Random", "SeedSequence"})
_TELLING = frozenset({"tell", "warn"})
_DRAWING = ("matplotlib", "flysid.validate.show.page.svg")
_DRAWER = "validate/show/page/svg.py"
_SMALLEST = 1e-6
_LARGEST = 1e6
_COUNTED = 20

_BOUNDARY: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
}
_OPPOSITE: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}


@dataclass(frozen=True)
class Mutant:
    """One change of a file.

    Attributes
    ----------
    place : the statement that holds it.
    line : the line of the node itself, from 1.
    kind : see the head of this module.
    start, end : the bytes that are replaced.
    before, after : what stood there, and what stands there instead.
    """

    place: Place
    line: int
    kind: str
    start: int
    end: int
    before: str
    after: str

    @property
    def key(self) -> str:
        """What tells it from every other change of the same tree."""
        return f"{self.place.path} {self.start} {self.after}"

    def apply(self, source: bytes) -> bytes:
        """The file's bytes with the change."""
        return source[: self.start] + self.after.encode() + source[self.end :]

    @property
    def change(self) -> str:
        """What becomes of what, in one line."""
        before, after = (" ".join(text.split()) for text in (self.before, self.after))
        return f"{before} -> {after}"

    def __str__(self) -> str:
        return f"{self.place.path}:{self.line}: {self.change}"


def find_sites(root: Path) -> list[list[Mutant]]:
    """The changes of every site below `root`, site by site, in the order of files and lines."""
    sites = []
    for folder in FOLDERS:
        for file in sorted((root / folder).rglob("*.py")):
            sites += sites_of(file.read_bytes(), file.relative_to(root).as_posix())
    return sites


def sites_of(source: bytes, path: str) -> list[list[Mutant]]:
    """The changes of every site of one file.

    Parameters
    ----------
    source : the file.
    path : from the root of the repository, e.g. `model/arx.py`.
    """
    tree = ast.parse(source)
    places = find_places(tree, path)
    lines = _starts(source)
    measured = _measured(tree)
    sites = []
    for node, is_drawing in _nodes(tree, path == _DRAWER):
        start = lines[node.lineno - 1] + node.col_offset
        end = lines[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
        changes = _changes(node, measured, is_drawing)
        found = [
            Mutant(places[node], node.lineno, kind, start, end, source[start:end].decode(), after)
            for kind, after in changes
        ]
        sites += [found] if found else []
    return sites


def draw(sites: Sequence[Sequence[Mutant]], seed: int, count: int) -> list[Mutant]:
    """`count` sites by chance, all of them if there are fewer, and one change of each."""
    chance = random.Random(seed)
    return [chance.choice(site) for site in chance.sample(list(sites), min(count, len(sites)))]


def _starts(source: bytes) -> list[int]:
    """Where every line begins, in bytes."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    return starts


Node = ast.expr | ast.AugAssign


def _nodes(node: ast.AST, is_drawing: bool) -> Iterator[tuple[Node, bool]]:
    """Nodes that decide something, and whether they are where something is drawn."""
    if isinstance(node, ast.Module | ast.FunctionDef):
        is_drawing = is_drawing or _draws(node)
    if isinstance(node, ast.expr | ast.AugAssign):
        yield node, is_drawing
    for child in _deciding(node):
        yield from _nodes(child, is_drawing)


def _deciding(node: ast.AST) -> Iterator[ast.AST]:
    """The children of a node but for those that decide nothing."""
    if isinstance(node, ast.JoinedStr | ast.Raise | ast.Assert | ast.pattern):
        return
    if isinstance(node, ast.FunctionDef) and _is_promise(node):
        return
    if isinstance(node, ast.Call) and _name(node.func) in _TELLING | _SEEDED:
        return
    if isinstance(node, ast.Assign) and any("SEED" in (_name(t) or "") for t in node.targets):
        return
    if isinstance(node, ast.Subscript) and _name(node.value) == "Literal":
        return
    is_field = isinstance(node, ast.Call) and _name(node.func) == "field"
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_free(child, is_field):
                yield child


def _is_free(node: ast.AST, is_field: bool) -> bool:
    """Whether it is an argument that decides nothing."""
    if not isinstance(node, ast.keyword):
        return False
    return node.arg in _FREE_ARGUMENTS | _SEED_ARGUMENTS or (is_field and node.arg != "default")


def _is_promise(node: ast.FunctionDef) -> bool:
    """A method of a protocol: it never runs, and its defaults are those of others."""
    last = node.body[-1]
    return isinstance(last, ast.Expr) and isinstance(last.value, ast.Constant) and last.value.value is ...


def _name(node: ast.AST) -> str | None:
    """`f` of `f` and of `a.b.f`."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else None


def _draws(scope: ast.Module | ast.FunctionDef) -> bool:
    """Whether what draws is imported in this scope itself, not in a function inside."""
    waiting: list[ast.stmt] = list(scope.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(_DRAWING):
            return True
        if isinstance(node, ast.Import) and any(name.name.startswith(_DRAWING) for name in node.names):
            return True
        if isinstance(node, ast.If | ast.Try):
            waiting += node.body
    return False


def _measured(tree: ast.Module) -> set[str]:
    """Constants of the module that are numbers, but not whole."""
    return {
        target.id
        for node in tree.body
        if isinstance(node, ast.Assign) and _is_broken(node.value)
        for target in node.targets
        if isinstance(target, ast.Name)
    }


def _is_broken(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, float) and not node.value.is_integer()


def _changes(node: Node, measured: set[str], is_drawing: bool) -> list[tuple[str, str]]:
    """Kind and new text of every change of one node."""
    if isinstance(node, ast.Constant):
        return [] if is_drawing else _of_constant(node.value)
    if isinstance(node, ast.Compare):
        return _of_comparison(node, measured)
    if isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        return [("logic", _text(ast.BoolOp(other, node.values)))]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return [("logic", _text(node.operand))]
    if is_drawing:
        return []
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return [("sign", _text(node.operand))]
    if isinstance(node, ast.BinOp) and not any(_is_joined(n) for n in (node.left, node.right)):
        op = _other_sign(node.op)
        return [("sign", _text(ast.BinOp(node.left, op, node.right)))] if op else []
    if isinstance(node, ast.AugAssign) and not _is_joined(node.value):
        op = _other_sign(node.op)
        return [("sign", ast.unparse(ast.AugAssign(node.target, op, node.value)))] if op else []
    return []


def _text(node: ast.expr) -> str:
    return f"({ast.unparse(node)})"


def _of_constant(value: object) -> list[tuple[str, str]]:
    if isinstance(value, bool):
        return [("truth", repr(not value))]
    if not isinstance(value, int | float):
        return []
    size = abs(value)
    scaled = [value * 2, value // 2 if isinstance(value, int) else value / 2]
    found = scaled if _SMALLEST <= size <= _LARGEST else []
    found += [value + 1, value - 1] if size <= _COUNTED else []
    news = sorted(set(found) - {value})
    return [("number", repr(new) if new >= 0 else f"({new!r})") for new in news]


def _of_comparison(node: ast.Compare, measured: set[str]) -> list[tuple[str, str]]:
    found = []
    sides = [node.left, *node.comparators]
    for k, op in enumerate(node.ops):
        near = sides[k : k + 2]
        if type(op) in _BOUNDARY and not any(_is_broken(n) or _name(n) in measured for n in near):
            found.append(("boundary", _with(node, k, _BOUNDARY[type(op)]())))
        found.append(("comparison", _with(node, k, _OPPOSITE[type(op)]())))
    return found


def _with(node: ast.Compare, k: int, op: ast.cmpop) -> str:
    return _text(ast.Compare(node.left, [*node.ops[:k], op, *node.ops[k + 1 :]], node.comparators))


def _other_sign(op: ast.operator) -> ast.operator | None:
    if isinstance(op, ast.Add):
        return ast.Sub()
    return ast.Add() if isinstance(op, ast.Sub) else None


def _is_joined(node: ast.expr) -> bool:
    """Text and lists, which `+` joins."""
    if isinstance(node, ast.BinOp):
        return _is_joined(node.left) or _is_joined(node.right)
    is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return is_text or isinstance(node, ast.JoinedStr | ast.List | ast.Tuple | ast.ListComp)
