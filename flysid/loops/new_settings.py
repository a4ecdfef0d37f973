"""Other settings than a log's own: read from words or a file, and put in the places of the stated ones."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flysid.errors import DataError, UsageError
from flysid.files import remedy_unread, why_unread
from flysid.ingest.lake.headers import stated_numbers
from flysid.laws.described import Law, blackbox_law
from flysid.loops.betaflight import AXES

WORDS = {"ON": "1", "OFF": "0", "PT1": "0", "BIQUAD": "1", "PT2": "2", "PT3": "3"}
"""Of a command line, as the header's numbers."""


def settings_in(words: str) -> dict[str, str]:
    """Settings of "NAME=VALUE,NAME=VALUE".

    Raises UsageError: a word is not NAME=VALUE.

    >>> settings_in("p_roll=58, d_roll = 38")
    {'p_roll': '58', 'd_roll': '38'}
    """
    found: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in words.split(","))):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not (name and equals and value):
            raise UsageError(f"{part!r} is not NAME=VALUE", hint="--set 'p_roll=58,d_roll=38'")
        found[name] = value
    return found


def read_settings(path: Path, *, numbers: bool = False) -> dict[str, str]:
    """Names and values of a file: a ground station's, NAME VALUE lines, or Betaflight's `set` lines.

    `numbers`: values are numbers; else words stand too, as a command line has them.
    Raises UsageError: no such file. Raises DataError: a line is not a setting, or a name stands twice with
    two values.
    """
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(
            f"the parameter file cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
        ) from error
    commands = bool(re.search(r"^set \w+ = ", text, re.MULTILINE))
    found: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.split("#")[0].strip()
        if commands and not bare.startswith("set "):
            continue
        words = re.split(r"[\s,=:]+", bare.removeprefix("set "))
        if words == [""]:
            continue
        if len(words) == 5 and words[0].isdigit() and words[1].isdigit():  # QGroundControl: two ids, a type
            words = words[2:4]
        if len(words) < 2 or not words[1] or (numbers and not _is_number(words[1])):
            raise DataError(
                f"line {number} is not a parameter: {line[:60]!r}", path=path, hint="one NAME VALUE a line"
            )
        name, value = words[:2]
        if found.setdefault(name, value) != value:
            raise DataError(f"{name} stands twice, with two values", path=path)
    return found


def with_settings(stated: Mapping[str, Any], changes: Mapping[str, str]) -> dict[str, Any]:
    """What a log states, with changes in the places of its own values.

    `stated`: a blackbox header's settings, or parameters by name.
    `changes`: by the names of the firmware's command line, or of its parameters.
    Raises UsageError: a name that the log does not state, a value that is no number.
    """
    if "Firmware revision" in stated:
        return _in_header(stated, changes)
    found = dict(stated)
    for name, value in changes.items():
        if name not in found:
            raise _unknown(name, found)
        found[name] = _number(name, value)
    return found


def value_of(stated: Mapping[str, Any], name: str) -> float:
    """The present value of a setting.

    Raises UsageError: the log does not state it. Raises DataError: its line does not hold a number there.
    """
    if "Firmware revision" not in stated:
        if name not in stated:
            raise _unknown(name, stated)
        return float(stated[name])
    line, place = _place(blackbox_law(stated["Firmware revision"]), stated, name)
    numbers = stated_numbers(stated, line)
    if place >= len(numbers):
        raise DataError(
            f"the header's line {line} has no place {place + 1}", hint="log with the header whole"
        )
    return numbers[place]


def _in_header(stated: Mapping[str, str], changes: Mapping[str, str]) -> dict[str, str]:
    """The header's lines with other numbers at their places."""
    law = blackbox_law(stated["Firmware revision"])
    found = dict(stated)
    for name, value in changes.items():
        number = _number(name, WORDS.get(value.upper(), value))
        line, place = _place(law, found, name)
        numbers = re.split("([,/])", found[line])
        numbers[2 * place] = f"{number:.12g}"
        found[line] = "".join(numbers)
    return found


def _place(law: Law, stated: Mapping[str, str], name: str) -> tuple[str, int]:
    """The header's line that holds a setting, and at which place."""
    stem, _, axis = name.rpartition("_")
    cli = law.part("cli")
    if axis in AXES and stem in cli:
        where = cli[stem]
        if isinstance(where, int):
            return law.gains[axis], where
        return _line(law, stated, where, name), list(AXES).index(axis)
    pairs = law.part("pairs")
    if name in pairs:
        known, place = pairs[name]
        return _line(law, stated, known, name), place
    of_law = {own for names in law.names.values() for own in names}
    aliases = next((names for names in law.names.values() if name in names), ())
    line = next((own for own in (name, *aliases) if own in stated and own in of_law), None)
    if line is None:
        every = [f"{own}_{axis}" for own in cli for axis in AXES]
        raise _unknown(name, [*every, *pairs, *(own for own in of_law if own in stated)])
    return line, 0


def _line(law: Law, stated: Mapping[str, str], known: str, name: str) -> str:
    line = next((own for own in law.names.get(known, ()) if own in stated), None)
    if line is None:
        raise UsageError(f"{name}: the log's header does not state it", hint="log with the header whole")
    return line


def _is_number(value: str) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def _number(name: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise UsageError(f"{name}: {value!r} is not a number", hint="--set 'p_roll=58,d_roll=38'") from None


def _unknown(name: str, known: Any) -> UsageError:
    near = difflib.get_close_matches(name, list(known), 3)
    return UsageError(
        f"{name} is no setting of the rate controller that this log states",
        hint=f"near it: {', '.join(near)}" if near else "its gains and filters: flysid gains LOG",
    )
