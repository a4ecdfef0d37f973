"""Columns of tables that name themselves: what a header says of units, and which column tells the time.

pitch_cmd [deg]   v_x (m/s)   alt_m   rate_radps   vx_m_s   time_ms   TimeUS
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from flysid.ingest.formats.common.units import is_known

_BRACKETS = re.compile(r"^(.*?)\s*[\[(]([^\])]*)[\])]$")
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
    "millis": "ms",
    "us": "us",
    "usec": "us",
    "micros": "us",
    "ns": "ns",
    "nsec": "ns",
    "min": "min",
    "mins": "min",
    "minutes": "min",
    "h": "h",
    "hours": "h",
}
_TIME_NAME = re.compile(
    r"^_*(t|time|(time)?stamp|seconds|elapsed([ _]?time)?|date([ _]?time)?|utc|time[ _]?boot"
    r"|tempo|temps|tiempo|zeit)"
    rf"([ _.]({'|'.join(_TIME_UNITS)}))?$"
)
_TIME_JOINED = re.compile(r"^time(us|ms|ns)$|^(millis|micros)$")


def named_and_measured(header: str, index: int) -> tuple[str, str]:
    """(name, unit) of a column by its header: a unit in brackets leaves the name, one at its end stays.

    Examples
    --------
    >>> named_and_measured("v_x [m/s]", 0), named_and_measured("vx_m_s", 1), named_and_measured("", 2)
    (('v_x', 'm/s'), ('vx_m_s', 'm/s'), ('c3', ''))
    """
    match = _BRACKETS.match(header)
    if match and match[1] and is_known(match[2].strip()):
        return match[1], match[2].strip()
    return header or f"c{index + 1}", unit_behind(header)


def unit_behind(name: str) -> str:
    """The unit that the last words of a name state; "" where they state none."""
    words = _WORD.split(name)
    for count in (3, 2, 1):
        if len(words) > count and (unit := _LAST_WORDS.get(" ".join(words[-count:]), "")):
            return unit
    return ""


def time_unit_of(name: str) -> str | None:
    """None where a column is not called a time; else the unit that its name states, or ""."""
    lower = name.lower()
    if joined := _TIME_JOINED.match(lower):
        return _TIME_UNITS[joined[1] or joined[2]]
    match = _TIME_NAME.match(lower)
    return None if match is None else _TIME_UNITS.get(match[6] or "", "s" if lower == "seconds" else "")


def once_each(names: Sequence[str]) -> list[str]:
    """Names of which those that occur again get a number."""
    seen: Counter[str] = Counter()
    found: list[str] = []
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return found
