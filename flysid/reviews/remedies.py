"""What logs next time what a log lacks, in the words of its firmware."""

from __future__ import annotations

from flysid.reviews.logged import LoggedFlight

REMEDIES = {
    "ardupilot": {
        "motors": "LOG_BITMASK with RCOUT",
        "current": "LOG_BITMASK with CURRENT, BATT_MONITOR 4",
        "rate": "LOG_BITMASK bit 0 (fast attitude), which logs RATE at the loop's rate",
        "attitude": "LOG_BITMASK bit 0 (fast attitude) or 1 (medium)",
        "velocity": "LOG_BITMASK bit 5 (navigation tuning)",
        "position": "LOG_BITMASK bit 5 (navigation tuning)",
    },
    "px4": {
        "motors": "SDLOG_PROFILE 1 and more",
        "current": "a power module: BAT1_SOURCE, BAT1_A_PER_V",
        "rate": "SDLOG_PROFILE bits 0 and 2 (default and high rate)",
        "attitude": "SDLOG_PROFILE bit 0 (default)",
        "velocity": "SDLOG_PROFILE bit 0 (default), and a mode that holds the velocity",
        "position": "SDLOG_PROFILE bit 0 (default), and a mode that holds the position",
    },
    "betaflight": {
        "motors": "motor fields of the blackbox",
        "current": "a current sensor: current_meter",
        "rate": "blackbox_disable_setpoint = OFF and blackbox_disable_gyro = OFF",
    },
    "inav": {
        "rate": "axisRate and gyroADC of the blackbox, which are there by default",
        "velocity": "blackbox flag NAV_POS",
        "position": "blackbox flag NAV_POS",
    },
    "crazyflie": {
        "rate": "controller.rollRate, pitchRate, yawRate and gyro in the card's config.txt",
        "attitude": "controller.roll, pitch, yaw and stateEstimate in the card's config.txt",
        "velocity": "ctrltarget.vx, vy, vz and stateEstimate in the card's config.txt",
        "position": "ctrltarget.x, y, z and stateEstimate in the card's config.txt",
    },
}
"""Firmware -> what is missing -> the parameter that logs it."""


def remedy(flight: LoggedFlight, of: str) -> str:
    """The parameter of this log's firmware; "" where none is known."""
    whose = flight.family or flight.info.get("vehicle", "").lower()  # a Crazyflie names no autopilot
    return REMEDIES.get(whose, {}).get(of, "")
