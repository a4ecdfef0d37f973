"""Columns of tables that name themselves: what a header says of units, and which column tells the time.

pitch_cmd [deg]   v_x (m/s)   alt_m   rate_radps   vx_m_s   time_ms   TimeUS
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

from flysid.ingest.formats.common.units import is_known

_BRACKETS = re.compile(r"^(.*?)(\s*)[\[(]([^\])]*)[\])]$")
_WORD = re.compile(r"[_ .]+")
# "ms" may be milliseconds or m/s, "s", "g" and "n" may be anything: these state no unit behind a name
_LAST_WORDS: Mapping[str, str] = {
    "deg": "deg",
    "cdeg": "cdeg",
    "degE7": "degE7",
    "dege7": "degE7",
    "rad": "rad",
    "mrad": "mrad",
    "m": "m",
    "cm": "cm",
    "mm": "mm",
    "km": "km",
    "m s": "m/s",
    "mps": "m/s",
    "cm s": "cm/s",
    "cmps": "cm/s",
    "mm s": "mm/s",
    "mmps": "mm/s",
    "km h": "km/h",
    "kmh": "km/h",
    "kph": "km/h",
    "rad s": "rad/s",
    "radps": "rad/s",
    "deg s": "deg/s",
    "degps": "deg/s",
    "dps": "deg/s",
    "m s2": "m/s/s",
    "m s s": "m/s/s",
    "mps2": "m/s/s",
    "rad s2": "rad/s/s",
    "rad s s": "rad/s/s",
    "radps2": "rad/s/s",
    "deg s2": "deg/s/s",
    "deg s s": "deg/s/s",
    "degps2": "deg/s/s",
    "rpm": "rpm",
    "RPM": "rpm",
    "hz": "Hz",
    "Hz": "Hz",
    "pct": "%",
    "percent": "%",
    "us": "us",
    "V": "V",
    "volt": "V",
    "volts": "V",
    "mV": "mV",
    "A": "A",
    "amp": "A",
    "amps": "A",
    "Nm": "Nm",
}
_TIME_UNITS = {
    "s": "s",
    "sec": "s",
    "secs": "s",
    "seconds": "s",
    "ms": "ms",
    "msec": "ms",
    "msecs": "ms",
    "millis": "ms",
    "millisecond": "ms",
    "milliseconds": "ms",
    "us": "us",
    "\u00b5s": "us",  # micro sign
    "\u03bcs": "us",  # mu
    "usec": "us",
    "usecs": "us",
    "micros": "us",
    "microsecond": "us",
    "microseconds": "us",
    "ns": "ns",
    "nsec": "ns",
    "nsecs": "ns",
    "nanos": "ns",
    "nanosec": "ns",
    "nanosecs": "ns",
    "nanosecond": "ns",
    "nanoseconds": "ns",
    "min": "min",
    "mins": "min",
    "minutes": "min",
    "h": "h",
    "hours": "h",
    "d": "d",
    "day": "d",
    "days": "d",
    "\u0441": "s",  # Russian
    "\u0441\u0435\u043a": "s",
    "\u043c\u0441": "ms",
    "\u043c\u043a\u0441": "us",
    "\u79d2": "s",  # Chinese and Japanese
    "\u6beb\u79d2": "ms",
    "\u30df\u30ea\u79d2": "ms",
    "\u5fae\u79d2": "us",
    "\ucd08": "s",  # Korean
    "\ubc00\ub9ac\ucd08": "ms",
}
_NO_NAMES = frozenset({"s", "h", "min", "mins", "hours", "minutes", "d", "day"})  # alone they may be anything
_DAY_NAMES = frozenset({"datenum", "serialdate", "serialtime", "exceltime", "exceldate", "mjd", "jd"}) | {
    "juliandate",
    "julianday",
}
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[^\W\d_A-Za-z]+")
_TIME_WORDS = frozenset(
    {"time", "timestamp", "stamp", "datetime", "clock", "epoch", "unixtime", "tempo", "temps", "tiempo"}
    | {"zeit", "zeitstempel", "uhrzeit", "laufzeit", "hora", "heure", "czas", "tijd", "zaman"}
    | {"\u0432\u0440\u0435\u043c\u044f"}  # Russian
    | {"\u65f6\u95f4", "\u6642\u9593", "\u6642\u523b", "\u65f6\u523b"}  # Chinese and Japanese
    | {"\uc2dc\uac04"}  # Korean
)
_COUNTED = frozenset({"tick", "ticks"})  # of a clock that nothing states
_TIME_NAMES = (_TIME_WORDS - {"clock"}) | {
    *("t", "utc", "date", "unix", "elapsed", "elapsedtime", "timeboot", "utctime", "timeutc", "epochtime"),
    *("ts", "tow", "gpstow", "sow"),
    *("timeus", "timems", "timens"),
}


@dataclass(frozen=True)
class TimeName:
    """What the name of a time says.

    Attributes
    ----------
    unit : "" where it states none.
    is_plain : "time", "t_ms"; not "sim_time" or "time_since_start", which may be another time than the rows'.
    """

    unit: str
    is_plain: bool


def named_and_measured(headers: Sequence[str]) -> list[tuple[str, str]]:
    """(name, unit) of every column by its header: a unit in brackets leaves the name, one at its end stays.

    Brackets are an index, and stay, where they hold a number right behind the name, or where those of columns
    with the same name count up, or hold anything that is no unit.

    Examples
    --------
    >>> named_and_measured(["v_x [m/s]", "vx_m_s", "", "q[0]", "q[1]"])
    [('v_x', 'm/s'), ('vx_m_s', 'm/s'), ('c3', ''), ('q[0]', ''), ('q[1]', '')]
    """
    matches = [_BRACKETS.match(header) for header in headers]
    inside: dict[str, set[str]] = {}
    for match in matches:
        if match:
            inside.setdefault(match[1], set()).add(match[3].strip())
    found = []
    for index, (header, match) in enumerate(zip(headers, matches, strict=True)):
        unit = unit_in(match[3]) if match and match[1] and not _is_index(match, inside[match[1]]) else None
        if match and unit is not None:
            found.append((match[1], unit))
        else:
            found.append((header or nameless(index), unit_behind(header)))
    return found


def nameless(index: int) -> str:
    """What a column without a name is called."""
    return f"c{index + 1}"


def _is_index(match: re.Match[str], alike: set[str]) -> bool:
    """Whether brackets hold an index; `alike` is what those of columns with the same name hold."""
    is_number = match[3].strip().isdecimal()
    return (is_number and (not match[2] or len(alike) > 1)) or any(unit_in(text) is None for text in alike)


def unit_behind(name: str) -> str:
    """The unit that the last words of a name state; "" where they state none."""
    words = _WORD.split(name)
    for count in (3, 2, 1):
        if len(words) > count and (unit := _LAST_WORDS.get(" ".join(words[-count:]), "")):
            return unit
    return ""


def unit_in(cell: str) -> str | None:
    """The unit that a cell or brackets hold; None where they hold something else."""
    bare = cell.strip()
    bare = bare[1:-1].strip() if bare[:1] + bare[-1:] in ("[]", "()") else bare
    return bare if is_known(bare) else _TIME_UNITS.get(bare.lower())


def time_name(name: str) -> TimeName | None:
    """What a column's name says of time; None where it is not called one.

    Examples
    --------
    >>> time_name("t_ms"), time_name("GPSTime"), time_name("thrust")
    (TimeName(unit='ms', is_plain=True), TimeName(unit='', is_plain=False), None)
    """
    words = [word.lower() for word in _WORDS.findall(name)]
    if not words:
        return None
    unit = _TIME_UNITS.get(words[-1], "")
    if not unit and not _COUNTED.isdisjoint(words):
        return None
    if len(words) == 1 and unit and words[0] not in _NO_NAMES:
        return TimeName(unit, is_plain=True)
    if len(words) > 1 and unit:
        words.pop()
    joined = "".join(words)
    if joined in _DAY_NAMES:
        return TimeName("d", is_plain=True)
    if joined in _TIME_NAMES:
        return TimeName(unit or _TIME_UNITS.get(joined.removeprefix("time"), ""), is_plain=True)
    is_time = words[0] in _TIME_WORDS or words[-1] in _TIME_WORDS
    return TimeName(unit, is_plain=False) if is_time else None


def fraction_beside(name: str, others: Sequence[str]) -> str:
    """The column of nanoseconds that belongs to one of whole seconds, as ROS splits times; "" for none.

    Examples
    --------
    >>> fraction_beside("header.stamp.secs", ["header.stamp.secs", "header.stamp.nsecs", "x"])
    'header.stamp.nsecs'
    """
    words = [word.lower() for word in _WORDS.findall(name)]
    if not words or words[-1] not in ("sec", "secs", "seconds"):
        return ""
    for other in others:
        its = [word.lower() for word in _WORDS.findall(other)]
        if its[:-1] == words[:-1] and its and _TIME_UNITS.get(its[-1]) == "ns":
            return other
    return ""


def names_in_groups(groups: Sequence[Sequence[str]], names: Sequence[str]) -> list[str]:
    """The names of columns below lines that group them: equal ones get what tells their groups apart.

    A group reaches to the right until the next one. A column that the last line leaves empty is named above.

    Examples
    --------
    >>> names_in_groups([["", "left", "", "right", ""]], ["t", "x", "y", "x", "y"])
    ['t', 'left.x', 'left.y', 'right.x', 'right.y']
    >>> names_in_groups([["", "imu", "", "gps", ""]], ["t", "ax", "ay", "lat", "lon"])
    ['t', 'ax', 'ay', 'lat', 'lon']
    """
    own = [next(filter(None, column), "") for column in zip(names, *reversed(groups), strict=True)]
    counts = Counter(own)
    spread = [list(accumulate(cells, _filled)) for cells in groups]
    telling = [cells for cells in spread if _tells_apart(cells, own)]
    keys = list(zip(*telling, strict=True)) if telling else [() for _ in own]
    shared = {key for key, name in zip(keys, own, strict=True) if counts[name] > 1}
    return [
        ".".join(filter(None, (*key, name))) if key in shared and name not in key else name
        for key, name in zip(keys, own, strict=True)
    ]


def _filled(left: str, cell: str) -> str:
    return cell or left


def _tells_apart(cells: Sequence[str], names: Sequence[str]) -> bool:
    """Whether a line of groups differs between columns of one name."""
    found: dict[str, set[str]] = {}
    for cell, name in zip(cells, names, strict=True):
        found.setdefault(name, set()).add(cell)
    return any(len(different) > 1 for different in found.values())


def once_each(names: Sequence[str], taken: Collection[str] = ()) -> list[str]:
    """Names of which those that occur again, or are `taken`, get a number behind them that makes them new.

    Examples
    --------
    >>> once_each(["u", "u", "u_2"])
    ['u', 'u_3', 'u_2']
    """
    wanted = set(names)
    used = set(taken)
    found: list[str] = []
    for name in names:
        free = name
        number = 2
        while free in used or (free != name and free in wanted):
            free = f"{name}_{number}"
            number += 1
        used.add(free)
        found.append(free)
    return found
