"""The sentences of the program's errors, and those of them that no test has the words of.

    python -m bench.messages            # how many there are, by package
    python -m bench.messages --unheld   # those of whose words no test has three in a row

A sentence is a string of three words or more in the call of an error that flysid raises: what happened, or
what to try. A test holds it if one of its own strings has three of its words in a row; that it is also caused
there is likely, not certain.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import flysid.errors
from flysid.errors import FlysidError

ROOT = Path(__file__).parents[1]
PACKAGES = ("flysid", "ingest", "model", "validate")
ERRORS = {
    name
    for name, kind in vars(flysid.errors).items()
    if isinstance(kind, type) and issubclass(kind, FlysidError)
}
WORD = re.compile(r"[A-Za-z0-9']+")


class Sentence(NamedTuple):
    """What an error says, without what is filled in; `words` are those of its pieces, three in a row."""

    place: str
    text: str
    words: frozenset[tuple[str, ...]]


def sentences() -> list[Sentence]:
    """All that errors say, in the order of files."""
    found = []
    for package in PACKAGES:
        for file in sorted((ROOT / package).rglob("*.py")):
            for call in ast.walk(ast.parse(file.read_text())):
                if isinstance(call, ast.Call) and ast.unparse(call.func).rpartition(".")[2] in ERRORS:
                    place = f"{file.relative_to(ROOT)}:{call.lineno}"
                    given = [*call.args[:1], *(k.value for k in call.keywords if k.arg == "hint")]
                    found += [
                        Sentence(place, "...".join(p), threes(p))
                        for p in map(pieces, given)
                        if is_sentence(p)
                    ]
    return found


def pieces(value: ast.expr) -> list[str]:
    """The literal parts of a text."""
    return [text for node in ast.walk(value) if (text := _string(node))]


def is_sentence(parts: list[str]) -> bool:
    """Whether it says something in words."""
    text = " ".join(parts)
    return len(re.findall("[A-Za-z]{2,}", text)) >= 3


def threes(parts: list[str]) -> frozenset[tuple[str, ...]]:
    """Every three words in a row."""
    return frozenset(three for part in parts for three in _threes(part))


def _threes(text: str) -> Iterator[tuple[str, ...]]:
    words = WORD.findall(re.sub(r"\\(.)", r"\1", text))
    return zip(words, words[1:], words[2:], strict=False)


def said_by_tests() -> frozenset[tuple[str, ...]]:
    """Every three words in a row of the tests' strings."""
    trees = (ast.parse(file.read_text()) for file in sorted((ROOT / "tests").rglob("*.py")))
    return frozenset(three for tree in trees for node in ast.walk(tree) for three in _threes(_string(node)))


def _string(node: ast.AST) -> str:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def main() -> None:
    """Print the counts, or the sentences that no test holds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--unheld", action="store_true")
    unheld_only: bool = parser.parse_args().unheld
    tested = said_by_tests()
    all_of_them = sentences()
    unheld = [one for one in all_of_them if not one.words & tested]
    if unheld_only:
        for one in unheld:
            print(f"{one.place}: {one.text}")
        return
    print("package   sentences  held by a test")
    total = Counter(one.place.partition("/")[0] for one in all_of_them)
    lacking = Counter(one.place.partition("/")[0] for one in unheld)
    for package in PACKAGES:
        print(f"{package:8}  {total[package]:9}  {total[package] - lacking[package]:14}")
    print(f"{'all':8}  {len(all_of_them):9}  {len(all_of_them) - len(unheld):14}")


if __name__ == "__main__":
    main()
