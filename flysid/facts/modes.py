"""Names of flight modes, which logs carry as numbers only.

The tables stand in `modes.toml`: ArduPilot's numbers by kind of vehicle, PX4's by release, the flags of
Betaflight and its relatives by release. A number without a name stays a number, with the vehicle it is of.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cache
from importlib.resources import files
from math import isfinite
from typing import Any

from flysid.flight import message_of, stem_of

NUMBERS = (
    ("MODE", "ModeNum"),
    ("MODE", "Mode"),
    ("vehicle_status", "nav_state"),
    ("HEARTBEAT", "custom_mode"),
)
"""Columns that hold a mode's number, the surest first."""
FLAGS = (("slow", "flightModeFlags"),)
"""Columns whose bits are modes."""
COLUMNS = (*NUMBERS, *FLAGS)
_MAIN_SHIFT, _SUB_SHIFT = 16, 24  # of PX4's custom_mode


def mode_names(stream: str, field: str, info: Mapping[str, str]) -> Mapping[int, str]:
    """Number -> name of the modes in a column of a log; empty where the column holds none, or none is known.

    `stream`: key of the stream, e.g. "1.1/HEARTBEAT".
    `info`: facts about the vehicle: "autopilot", "vehicle", "firmware".

    >>> mode_names("MODE", "ModeNum", {"autopilot": "ardupilot", "vehicle": "rover"})[11]
    'RTL'
    """
    column = (_message(stream), field)
    autopilot = info.get("autopilot", "")
    if column == ("vehicle_status", "nav_state"):
        return _nav_states(_release(info.get("firmware", "")))
    if column not in NUMBERS:
        return {}
    if autopilot.startswith("px4"):
        return _custom_modes()
    if autopilot.startswith("ardupilot"):
        return _ardupilot_modes(family_of(info.get("vehicle", "")))
    return {}


def mode_texts(values: Iterable[float], stream: str, field: str, info: Mapping[str, str]) -> list[str]:
    """The modes that values of a column stand for, in words; "" for a value that is missing.

    >>> mode_texts([6, 42], "MODE", "ModeNum", {"autopilot": "ardupilot", "vehicle": "copter"})
    ['RTL', 'mode 42 (copter)']
    """
    numbers = [int(value) if isfinite(value) else None for value in values]
    if (_message(stream), field) in FLAGS:
        table = _flag_table(info.get("autopilot", ""), _release(info.get("firmware", "")))
        return ["" if number is None else _flag_text(number, table, info) for number in numbers]
    names = mode_names(stream, field, info)
    return ["" if number is None else names.get(number) or _unnamed(number, info) for number in numbers]


def holds_modes(stream: str, field: str) -> bool:
    """Whether a column of a stream is one of `COLUMNS`."""
    return (_message(stream), field) in COLUMNS


def all_names() -> frozenset[str]:
    """Every name that some firmware gives to a mode."""
    table = _tables()
    found = {name for family in table["ardupilot"].values() for name in family["modes"].values()}
    found |= {row[1] for row in table["px4"]["nav_state"]} | set(_custom_modes().values())
    return frozenset(found)


def family_of(vehicle: str) -> str:
    """ArduPilot's firmware for a kind of vehicle: "copter", "plane", "rover", "sub"...; "" for others.

    >>> family_of("hexarotor"), family_of("vtol_tiltrotor"), family_of("surface_boat"), family_of("gcs")
    ('copter', 'plane', 'rover', '')
    """
    kind = vehicle.lower()
    for family, facts in _tables()["ardupilot"].items():
        if any(fnmatchcase(kind, pattern) for pattern in facts["vehicles"]):
            return str(family)
    return ""


def family_by_parameters(names: Iterable[str]) -> str:
    """ArduPilot's firmware that alone has some of these parameters; "" where none or several have."""
    held = frozenset(names)
    found = [name for name, facts in _tables()["ardupilot"].items() if held & set(facts["parameters"])]
    return str(found[0]) if len(found) == 1 else ""


def _message(stream: str) -> str:
    return stem_of(message_of(stream)).partition("#")[0]


@cache
def _tables() -> Mapping[str, Any]:
    return tomllib.loads(files(__package__).joinpath("modes.toml").read_text("utf-8"))


@cache
def _ardupilot_modes(family: str) -> Mapping[int, str]:
    modes = _tables()["ardupilot"].get(family, {}).get("modes", {})
    return {int(number): name for number, name in modes.items()}


@cache
def _nav_states(release: tuple[int, ...]) -> Mapping[int, str]:
    """PX4's states of a release; where it is not known, those whose number never had another name."""
    rows = _tables()["px4"]["nav_state"]
    if release:
        return {number: name for number, name, *bounds in rows if _is_within(release, *bounds)}
    numbers = [number for number, *_ in rows]
    return {number: name for number, name, *_ in rows if numbers.count(number) == 1}


def _is_within(release: tuple[int, ...], since: str, until: str) -> bool:
    return (not since or release >= _release(since)) and (not until or release < _release(until))


@cache
def _custom_modes() -> Mapping[int, str]:
    """PX4's custom_mode: a main mode, and in some of them a mode below."""
    px4 = _tables()["px4"]
    found: dict[int, str] = {}
    for main, name in px4["main"].items():
        found[int(main) << _MAIN_SHIFT] = name
        for sub, inner in px4["sub"].get(name, {}).items():
            found[int(main) << _MAIN_SHIFT | int(sub) << _SUB_SHIFT] = inner
    return found


@cache
def _flag_table(autopilot: str, release: tuple[int, ...]) -> Mapping[str, Any]:
    """Bits and their modes in a firmware of this release; {} where they are not known."""
    tables: Sequence[Mapping[str, Any]] = _tables()["flags"].get(autopilot, ())
    known = [table for table in tables if not table["since"] or _release(table["since"]) <= release]
    return known[-1] if known and release else {}


def _flag_text(flags: int, table: Mapping[str, Any], info: Mapping[str, str]) -> str:
    if not table:
        return _unnamed(flags, info)
    return str(next((name for bit, name in table["bits"] if flags >> bit & 1), table["otherwise"]))


def _unnamed(number: int, info: Mapping[str, str]) -> str:
    whose = info.get("vehicle") or f"{info.get('autopilot') or 'autopilot unknown'}, vehicle type unknown"
    return f"mode {number} ({whose})"


@cache
def _release(text: str) -> tuple[int, ...]:
    """ "1.15.0 beta" as (1, 15, 0); () for what begins with no number."""
    found = re.match(r"\d+(\.\d+)*", text)
    return tuple(map(int, found[0].split("."))) if found else ()
