"""Text from logs as text, in files that other programs would read as more: spreadsheets, Markdown, shells.

A name, a message or a parameter in a log is whatever a stranger has put there. In a file it stays that: a
cell is no formula, a heading no picture from elsewhere, a comment ends where flysid ends it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")
"""Beginnings that a spreadsheet takes for a formula; the last four are the wide forms of the first."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_PARTS = re.compile(r'[",;\t\r\n|]')
"""What separates cells somewhere: a spreadsheet splits by its own language's sign, not by the file's."""


def one_line(text: str) -> str:
    """`text` without control characters or line breaks: names come from logs.

    Examples
    --------
    >>> one_line("a\\nb")
    'a\\ufffdb'
    """
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def inert_cell(text: str) -> str:
    """A text as a spreadsheet shows it and does not compute it; a number stays a number.

    >>> inert_cell("=1+1"), inert_cell("-5"), inert_cell("roll")
    ("'=1+1", '-5', 'roll')
    """
    return f"'{text}" if text.startswith(_FORMULA) and not _NUMBER.fullmatch(text) else text


def csv_line(cells: Sequence[str | float | int | None]) -> str:
    """A line of a CSV file, without its end: texts inert and, where a program could split them, in quotes.

    Examples
    --------
    >>> csv_line(["a;b", -1.5, None, "@x"])
    '"a;b",-1.5,,\\'@x'
    """
    return ",".join(_cell(cell) for cell in cells)


def _cell(value: str | float | int | None) -> str:
    if value is None:
        return ""
    if not isinstance(value, str):
        return str(value)
    text = inert_cell(one_line(value))
    return '"' + text.replace('"', '""') + '"' if _PARTS.search(text) else text


def markdown(text: str) -> str:
    """Markdown's signs get a backslash; a round bracket means nothing without a square one before it.

    Examples
    --------
    >>> markdown("![x](http://a)")
    '\\\\!\\\\[x\\\\](http://a)'
    """
    return re.sub(r"([\\`*_{}\[\]#+!|<>~&$@-])", r"\\\1", one_line(text))


def toml_document(document: Mapping[str, Any]) -> str:
    """A TOML document whose texts come back as they are and show no terminal anything to obey.

    Examples
    --------
    >>> toml_document({"field": "a\u202eb"})
    'field = "a\\\\U0000202eb"\\n'
    """
    import tomli_w

    lines = tomli_w.dumps(document).split("\n")
    return "\n".join("".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in line) for line in lines)


def picture_text(text: str) -> str:
    """A text for Matplotlib, which reads $...$ as mathematics and stops where it is none.

    Examples
    --------
    >>> picture_text("$x$")
    '\\\\$x\\\\$'
    """
    return one_line(text).replace("$", r"\$")
