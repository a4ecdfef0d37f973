"""The settings in the header of a blackbox log: their texts, and the numbers in them.

The first statement of a setting counts, as it does for the reader of frames. A setting that is missing may
have a value to fall back on. One whose text is no number is refused by name: a default would be a guess.
"""

from __future__ import annotations

from collections.abc import Mapping

from flysid.errors import DataError
from flysid.ingest.align.signals import Log
from flysid.ingest.align.things import find_stream
from flysid.ingest.formats.blackbox.header import numbers_of

STREAM = "parameters"
WHOLE = "log with the header whole"


def header_of(log: Log) -> dict[str, str]:
    """Settings of a blackbox header as text, by name; empty in other logs."""
    stream = find_stream(STREAM, log.rows)
    if stream is None or not {"name", "text"} <= set(log.columns(stream)):
        return {}
    table = log.table(stream, ["name", "text"]).to_pydict()
    settings: dict[str, str] = {}
    for name, text in zip(table["name"], table["text"], strict=True):
        settings.setdefault(name, text)
    return settings


def stated_numbers(settings: Mapping[str, str], *names: str, least: int = 1) -> tuple[float, ...]:
    """The numbers of the first of these settings that the header states; empty where it states none.

    `least`: so many numbers the setting has.
    Raises DataError: its text is no number, or holds fewer.
    """
    name = next((name for name in names if settings.get(name)), None)
    if name is None:
        return ()
    numbers = numbers_of(settings[name])
    if len(numbers) < least:
        wanted = "a number" if least == 1 else f"{least} numbers"
        raise DataError(f"the log's header states {name} as {settings[name]!r}, not as {wanted}", hint=WHOLE)
    return numbers


def needed_numbers(settings: Mapping[str, str], *names: str, least: int = 1) -> tuple[float, ...]:
    """The numbers of a setting that cannot be done without.

    Raises DataError: the header does not state it, or see `stated_numbers`.
    """
    numbers = stated_numbers(settings, *names, least=least)
    if not numbers:
        raise DataError(f"the log's header does not state {names[0]}", hint=WHOLE)
    return numbers


def stated_number(settings: Mapping[str, str], *names: str, otherwise: float) -> float:
    """The first number of a setting, or another value where the header does not state it.

    Raises DataError: see `stated_numbers`.
    """
    numbers = stated_numbers(settings, *names)
    return numbers[0] if numbers else otherwise
