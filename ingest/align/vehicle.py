"""Whose flight a log is, as far as the log knows."""

from __future__ import annotations

from collections.abc import Mapping

from flysid.ingest.align.modes import COPTERS, PLANES

SERIALS = ("sys_uuid", "board")
"""Facts that are a board's own number."""


def vehicle_of(info: Mapping[str, str]) -> str:
    """A name that tells vehicles apart: the board's own number, else autopilot and kind of vehicle.

    Telemetry and the log on board name one vehicle differently ("ardupilotmega quadrotor" and "ardupilot
    copter"), so autopilots and kinds are brought to one word. "" where a log says nothing of it.
    """
    autopilot = info.get("autopilot", "")
    family = "ardupilot" if autopilot.startswith("ardupilot") else autopilot
    kind = info.get("vehicle", "").lower()
    kind = "copter" if kind in COPTERS else "plane" if kind in PLANES else kind
    serial = next((info[key] for key in SERIALS if info.get(key)), "")
    return " ".join(word for word in (family, "" if serial else kind, serial) if word)
