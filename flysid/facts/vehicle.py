"""Whose flight a log is, as far as the log knows."""

from __future__ import annotations

import re
from collections.abc import Mapping

from flysid.facts.modes import family_of

NAME = "vehicle_name"
"""The fact that names the vehicle: set by whoever ingested the log."""
SERIALS = ("sys_uuid", "board")
"""Facts that are a board's own number."""
TELEMETERED = "uid2"
"""The number that a board sends. PX4 writes it to its ULog, too; what ArduPilot logs on board has none, so
that telemetry and that log would seem to be of two vehicles."""


def vehicle_named(path: str, pattern: str) -> dict[str, str]:
    """The fact that names the vehicle, where a regular expression finds it in a log's path or address.

    What the expression's first group finds is the name; without a group, all that it finds.

    >>> vehicle_named("s3://logs/v017/2026-10-01.tlog", r"v\\d+")
    {'vehicle_name': 'v017'}
    """
    found = re.search(pattern, path) if pattern else None
    return {NAME: found[found.re.groups and 1]} if found else {}


def vehicle_of(info: Mapping[str, str]) -> str:
    """A name that no two vehicles share: the board's own number, else autopilot and kind of vehicle.

    Telemetry and the log on board name one vehicle differently ("ardupilotmega quadrotor" and "ardupilot
    copter"), so autopilots and kinds are brought to one word. "" where a log does not state it.
    A name that was given when the log was ingested stands for all of this.
    """
    if info.get(NAME):
        return info[NAME]
    autopilot = info.get("autopilot", "")
    family = "ardupilot" if autopilot.startswith("ardupilot") else autopilot
    kind = info.get("vehicle", "").lower()
    kind = family_of(kind) or kind
    serial = serial_of(info)
    return " ".join(word for word in (family, "" if serial else kind, serial) if word)


def label_of(info: Mapping[str, str]) -> str:
    """A flight's vehicle in a list: its name, else its kind, else its autopilot; "-" where none is known."""
    return info.get(NAME) or info.get("vehicle") or info.get("autopilot") or "-"


def serial_of(info: Mapping[str, str]) -> str:
    """The board's own number, by which telemetry and the log on board know it; "" where there is none."""
    keys = (*SERIALS, TELEMETERED) if info.get("autopilot") == "px4" else SERIALS
    return next((info[key] for key in keys if info.get(key)), "")


def firmware_of(info: Mapping[str, str]) -> str:
    """The family of a vehicle's firmware: "ardupilot", "px4", "betaflight"; as the log names any other.

    >>> firmware_of({"autopilot": "ardupilotmega"}), firmware_of({})
    ('ardupilot', '')
    """
    autopilot = info.get("autopilot", "").lower()
    return next((name for name in ("ardupilot", "px4") if autopilot.startswith(name)), autopilot)
