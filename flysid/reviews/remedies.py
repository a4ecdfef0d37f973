"""What logs next time what a log lacks, in the words of its firmware."""

from __future__ import annotations

from flysid.reviews.logged import LoggedFlight

REMEDIES = {
    "ardupilot": {"motors": "LOG_BITMASK with RCOUT", "current": "LOG_BITMASK with CURRENT, BATT_MONITOR 4"},
    "px4": {"motors": "SDLOG_PROFILE 1 and more", "current": "a power module: BAT1_SOURCE, BAT1_A_PER_V"},
    "betaflight": {"motors": "motor fields of the blackbox", "current": "a current sensor: current_meter"},
}
"""Firmware -> what is missing -> the parameter that logs it."""


def remedy(flight: LoggedFlight, of: str) -> str:
    """The parameter of this log's firmware; "" where none is known."""
    return REMEDIES.get(flight.family, {}).get(of, "")
