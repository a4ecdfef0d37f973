"""A word of docs/glossary.md has one meaning: one row, one class. Functions begin with its verbs."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

import flysid
from tests.flysid.test_headers import ROOT, sources

GLOSSARY = (ROOT / "docs" / "glossary.md").read_text("utf-8")


def defined(heading: str) -> list[str]:
    """The words of the table below the heading of its column, as often as they are defined."""
    table = GLOSSARY.partition(f"| {heading} | meaning |")[2].partition("\n\n")[0]
    return re.findall(r"^\| ([^|]+?) \| [^|]", table, re.M)


def class_of(word: str) -> str:
    """The name that a class of this word has: `free run` is `FreeRun`."""
    return "".join(part.capitalize() for part in re.split(r"[ -]", word))


def definitions() -> Iterator[tuple[Path, ast.ClassDef | ast.FunctionDef]]:
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                yield path, node


@pytest.fixture(scope="module")
def homes() -> Mapping[str, list[str]]:
    """Class -> the modules that define one of that name."""
    found: dict[str, list[str]] = defaultdict(list)
    for path, node in definitions():
        if isinstance(node, ast.ClassDef):
            found[node.name].append(str(path.relative_to(ROOT)))
    return found


NOUNS = defined("word")
VERBS = defined("verb")


def test_the_glossary_defines_every_word_once() -> None:
    assert len(NOUNS) > len(VERBS) > 1
    words = NOUNS + VERBS
    assert [word for word in dict.fromkeys(words) if words.count(word) > 1] == []


def test_a_word_of_the_glossary_names_one_class(homes: Mapping[str, list[str]]) -> None:
    exported = {name for name in flysid.__all__ if name[0].isupper()}
    names = exported | {class_of(word) for word in NOUNS}
    assert {name: homes[name] for name in sorted(names) if len(homes[name]) > 1} == {}


def test_functions_begin_with_the_verbs_of_the_glossary() -> None:
    begun = {node.name.lstrip("_").partition("_")[0] for _, node in definitions()}
    assert [verb for verb in VERBS if verb not in begun] == []
