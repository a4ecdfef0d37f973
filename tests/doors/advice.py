"""The commands that a command advises: those of its lines "next: ..." and "try: ..."."""

from __future__ import annotations

import re
from collections.abc import Sequence

_ADVICE = re.compile(r"\b(?:next|try): +(.*)", re.IGNORECASE)
_QUOTED = re.compile(r"'(flysid [^']+)'")
_BARE = re.compile(r"\bflysid [^;]+")
_FOLDED = 80
"""A line as long as this goes on in the next, set in by two blanks (`flysid.showing.fold`)."""


def commands_in(printed: str) -> list[str]:
    """Every command that is advised, as printed; a verb that is named without arguments is none.

    >>> commands_in("next: flysid validate run; a report")
    ['flysid validate run']
    >>> commands_in("  try:   'flysid ls data' lists its flights, or 'flysid tf'")
    ['flysid ls data']
    """
    found = []
    for advice in _advice(printed.splitlines()):
        quoted = _QUOTED.findall(advice)
        bare = _BARE.findall(_QUOTED.sub("", advice))
        found += [command.strip() for command in (*quoted, *bare) if len(command.split()) > 2]
    return found


def _advice(lines: Sequence[str]) -> list[str]:
    found = []
    for n, line in enumerate(lines):
        told = _ADVICE.search(line)
        if told is not None:
            text = told[1]
            while len(lines[n]) > _FOLDED and lines[n + 1 : n + 2] and lines[n + 1].startswith("  "):
                n += 1
                text += " " + lines[n].strip()
            found.append(text)
    return found
