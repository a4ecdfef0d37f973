"""What is known of a firmware's rate controller, read from the tables beside this module.

An entry holds for a range of versions and takes over what it does not state from the entry before it. For a
version outside all ranges the nearest entry is taken, and it says so: `Law.exact` is false.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from flysid.errors import DataError

Version = tuple[int, int]
BLACKBOX = ("betaflight", "inav")
"""Tables of firmwares that write a blackbox."""


@dataclass(frozen=True)
class Law:
    """The controller of one firmware in a range of versions.

    `firmware`: as it calls itself.
    `version`: of the log.
    `since`, `until`: first and last version that the entry describes.
    `scale`: of the gains: p, i, d, f, and what I of yaw is multiplied by.
    `gains`: name of the header's line with an axis' gains, by axis.
    `parts`: the other tables of the entry: derivative, boost, moving, integral, throttle, expected.
    `names`: header names of a setting, the newest first.
    `not_described`: settings that change the law where they are not 0, and what they are.

    >>> law = blackbox_law("Betaflight 4.6.0 (norevision) SITL")
    >>> law.since, law.exact, law.scale["p"]
    ((4, 6), True, 0.032029)
    """

    firmware: str
    version: Version
    since: Version
    until: Version
    scale: Mapping[str, float]
    gains: Mapping[str, str]
    parts: Mapping[str, Mapping[str, Any]]
    names: Mapping[str, tuple[str, ...]]
    not_described: Mapping[str, str]

    @property
    def exact(self) -> bool:
        """Whether the version lies inside the range."""
        return self.since <= self.version <= self.until

    @property
    def title(self) -> str:
        """For people: "Betaflight 4.6", or which version's law stands in for an unknown one."""
        own = f"{self.firmware} {_dotted(self.version)}"
        if self.exact:
            return own
        nearest = self.since if self.version < self.since else self.until
        return f"{own}, which is not described: the law of {_dotted(nearest)} stands in"

    def name_of(self, role: str, **fields: str) -> str:
        """The parameter of a role: "p" of an axis, "notch_hz" of a number.

        >>> parameter_law("arducopter").name_of("p", axis="RLL")
        'ATC_RAT_RLL_P'
        """
        return self.names[role][0].format(**fields)

    def part(self, name: str) -> Mapping[str, Any]:
        """One of the entry's tables; empty where the law has no such part."""
        return self.parts.get(name, {})


def _dotted(version: Version) -> str:
    return ".".join(str(number) for number in version)


def blackbox_law(revision: str) -> Law:
    """The law of a blackbox header's `Firmware revision`.

    Raises DataError: a firmware that no table describes.

    >>> blackbox_law("INAV 7.1.2 (8ae2c5b) X").firmware
    'INAV'
    """
    tables = [_table(name) for name in BLACKBOX]
    for table in tables:
        found = re.match(table["pattern"], revision)
        if found:
            return _nearest(table, (int(found[1]), int(found[2])))
    known = ", ".join(f"{table['firmware']} {_span(table)}" for table in tables)
    raise DataError(
        f"the controller of {revision or 'an unnamed firmware'} is not described",
        hint=f"gains are known of {known}; the loop itself: flysid tf LOG -r betaflight-rate",
    )


def parameter_law(name: str, version: Version | None = None) -> Law:
    """The law of an autopilot that states parameters: px4 or arducopter; the last one without a version.

    >>> parameter_law("px4", (1, 12)).part("derivative")["order"]
    2
    """
    table = _table(name)
    return _nearest(table, version or tuple(table["law"][-1]["until"]))


def _span(table: Mapping[str, Any]) -> str:
    return f"{_dotted(table['law'][0]['since'])} to {_dotted(table['law'][-1]['until'])}"


def _nearest(table: Mapping[str, Any], version: Version) -> Law:
    """The last entry that begins at or before a version; the first one for older versions."""
    entries = _whole(table["law"])
    begun = [entry for entry in entries if tuple(entry["since"]) <= version]
    entry = begun[-1] if begun else entries[0]
    rest = {k: v for k, v in entry.items() if isinstance(v, dict)}
    return Law(
        table["firmware"],
        version,
        tuple(entry["since"]),
        tuple(entry["until"]),
        rest.pop("scale", {}),
        rest.pop("gains", {}),
        {name: rest[name] for name in rest if name not in ("names", "not_described")},
        {name: (found,) if isinstance(found, str) else tuple(found) for name, found in rest["names"].items()},
        rest.get("not_described", {}),
    )


def _whole(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Entries with what they take over from the one before."""
    found: list[dict[str, Any]] = []
    for entry in entries:
        before = found[-1] if found else {}
        found.append(_over(before, entry))
    return found


def _over(before: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any]:
    """A table, and where it is silent the one before."""
    merged = dict(before)
    for name, value in entry.items():
        below = before.get(name)
        merged[name] = _over(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return merged


@cache
def _table(name: str) -> dict[str, Any]:
    return tomllib.loads(files(__package__).joinpath(f"{name}.toml").read_text("utf-8"))
