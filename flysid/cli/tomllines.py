"""On which line of a TOML file a key stands; `tomllib` does not tell."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

Keys = tuple[str, ...]
_TOKEN = re.compile(
    r"""
        \"{3}(?:\\.|[^\\])*?\"{3,5} | '{3}.*?'{3,5}        # texts of many lines
      | "(?:\\.|[^"\\\n])*" | '[^'\n]*' | \#[^\n]*         # texts and comments, which hold no brackets
      | (?P<opens>[\[{]) | (?P<closes>[\]}]) | (?P<ends>\n)
    """,
    re.VERBOSE | re.DOTALL,
)


def lines_of(text: str) -> dict[Keys, int]:
    """Where every key of a TOML text stands: its place in the document, and the line, from 1.

    Keys of an inline table stand on the line of the table. The text must be sound TOML.
    """
    found: dict[Keys, int] = {}
    table: Keys = ()
    for line, statement in _statements(text):
        parsed = tomllib.loads(statement)
        if statement.lstrip().startswith("["):
            table = _headed(parsed)
            for depth in range(1, len(table) + 1):
                found.setdefault(table[:depth], line)
            continue
        for keys in _places(parsed):
            found.setdefault(table + keys, line)
    return found


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Every header and every key with its value, and the line that it begins on."""
    depth = 0
    begin = 0
    line = 1
    for token in _TOKEN.finditer(text):
        depth += bool(token["opens"]) - bool(token["closes"])
        if token["ends"] and not depth:
            statement = text[begin : token.end()]
            yield line, statement
            line += statement.count("\n")
            begin = token.end()
    yield line, text[begin:]


def _headed(parsed: Mapping[str, Any]) -> Keys:
    """The table that a header opens."""
    keys: list[str] = []
    below: Any = parsed
    while isinstance(below, Mapping) and below:
        key, below = next(iter(below.items()))
        keys.append(key)
        below = below[0] if isinstance(below, list) else below
    return tuple(keys)


def _places(parsed: Mapping[str, Any]) -> Iterator[Keys]:
    for key, value in parsed.items():
        yield (key,)
        if isinstance(value, Mapping):
            yield from ((key, *below) for below in _places(value))
