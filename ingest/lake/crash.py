"""Crashes that a log does not state: it hits something, or leaves its command, and never flies again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from flysid.ingest.lake.attitude import sink_speed, tilt, tilt_error
from flysid.ingest.lake.clocked import ClockedLog, Column
from flysid.ingest.lake.motors import Motor, read_motors

Flight = TypeVar("Flight", bound=ClockedLog)
TIPPED_DEG = 60.0
"""PX4's FD_FAIL_R and FD_FAIL_P."""
IMPACT_M_S2 = 60.0
"""Six times gravity: no more than aerobatics take."""
OUTSTANDING = 3.0
"""An impact is so many times what 99.9 % of the flight before feels."""
UPRIGHT_DEG = 30.0
"""ArduPilot's crash check: it leans more, or is so far from its commanded tilt."""
BACK = 1.0 / 3.0
"""Of `UPRIGHT_DEG`: closer than that to its command it is under control again."""
RESTS_DEG_S = 20.0
"""PX4's LNDMC_ROT_MAX: what turns faster is not at rest."""
BACK_S = 2.0 * BACK * UPRIGHT_DEG / RESTS_DEG_S
"""What tumbles passes through its command, from `BACK` on one side to the other, in less than this."""
FALLING_M_S = 5.0
"""Faster than any landing: the fall from little more than a metre."""
STANDS_M_S = 1.0
"""ArduPilot's LAND_DETECTOR_VEL_Z_MAX: slower than that a vehicle may stand on the ground."""
STOPS_S = 2.0
"""A pilot disarms so soon after a crash."""
BEFORE_S = 5.0
"""Tipping over comes at most so long before the impact."""


@dataclass(frozen=True)
class Crash:
    """When a flight ended badly.

    `begins_s`: when it tipped over, else the impact: what follows says nothing of how it flies.
    `tipped_s`: when it leant more than 60 deg; NaN where it did not, or the attitude is not logged.
    `impact_s`, `impact_m_s2`: of the hardest blow; NaN where none was logged.
    `field`: of the accelerometer, or of the attitude where no blow was logged.
    `away_deg`: from its commanded tilt, where that shows the crash; else NaN.
    """

    begins_s: float
    tipped_s: float
    impact_s: float
    impact_m_s2: float
    field: str
    away_deg: float = float("nan")

    @property
    def words(self) -> str:
        """How it shows: "impact of 392 m/s2"."""
        if np.isfinite(self.impact_s):
            return f"impact of {self.impact_m_s2:.0f} m/s2"
        return f"{self.away_deg:.0f} deg away from its commanded tilt, and never back"


def acceleration(flight: ClockedLog) -> Column | None:
    """Size of the acceleration that the first accelerometer felt, in m/s2."""
    imu = (flight.things("IMU") or ["IMU"])[0]
    for fields in (
        [f"{imu}.Acc{axis}" for axis in "XYZ"],
        [f"sensor_combined.accelerometer_m_s2[{i}]" for i in range(3)],
        [f"vehicle_acceleration.xyz[{i}]" for i in range(3)],
        [f"main.accSmooth[{i}]" for i in range(3)],
    ):
        parts = [flight.quantity(field, unit="m/s/s", stated="m/s/s") for field in fields]
        known = [part for part in parts if part is not None]
        if len(known) == 3 and len({len(part) for part in known}) == 1:
            size = np.sqrt(sum(part.values**2 for part in known))
            if not size.any():
                continue  # a sensor that is not there, or whose scale is not logged
            return Column(known[0].address, "m/s2", known[0].time_s, size)
    return None


def find_crash(flight: ClockedLog) -> Crash | None:
    """By its hardest blow, else by its attitude: an accelerometer that is logged slowly misses the blow."""
    if not flight.was_flown:
        return None
    return _find_blow(flight) or _find_loss(flight)


def _find_loss(flight: ClockedLog) -> Crash | None:
    """Where it left its commanded tilt and was not under control again before the flight's end."""
    error = tilt_error(flight)
    if error is None:
        return None
    first_s, last_s = flight.air_s[-1]
    flown = error.where((error.time_s >= first_s) & (error.time_s <= last_s))
    gone = np.flatnonzero(flown.values > UPRIGHT_DEG)
    if not len(gone):
        return None
    after = flown.values[gone[-1] + 1 :] < BACK * UPRIGHT_DEG
    samples = max(2, round(BACK_S * flown.rate_hz))
    if len(after) >= samples and np.convolve(after, np.ones(samples), "valid").max() >= samples:
        return None
    near = gone[flown.time_s[gone] > flown.time_s[gone[-1]] - BEFORE_S]
    begins_s, away_deg = float(flown.time_s[near[0]]), float(flown.values[near].max())
    none = float("nan")
    return Crash(begins_s, _tipped(flight, begins_s + BACK_S), none, none, flown.address, away_deg)


def _find_blow(flight: ClockedLog) -> Crash | None:
    """The hardest blow in the air, if it had tipped over before it or its motors never carry again."""
    felt = acceleration(flight)
    if felt is None:
        return None
    last_s = max(last for _, last in flight.air_s)
    first_s = min(first for first, _ in flight.air_s)
    flown = felt.where((felt.time_s > first_s) & (felt.time_s < last_s + BEFORE_S))
    if len(flown) < 100:
        return None
    at = int(np.argmax(flown.values))
    hardest, impact_s = float(flown.values[at]), float(flown.time_s[at])
    usual = flown.values[flown.time_s < impact_s - BEFORE_S]
    if hardest < IMPACT_M_S2 or not len(usual) or hardest < OUTSTANDING * np.percentile(usual, 99.9):
        return None
    tipped_s = _tipped(flight, impact_s)
    if not np.isfinite(tipped_s) and not _breaks_off(flight, impact_s, first_s):
        return None
    begins_s = tipped_s if np.isfinite(tipped_s) else impact_s
    return Crash(begins_s, tipped_s, impact_s, hardest, felt.address)


def end_at_crash(flight: Flight) -> Flight:
    """The same flight, which ends where it tips over or hits something for good."""
    crash = find_crash(flight)
    return replace(flight, crashed_s=crash.begins_s) if crash else flight


def _tipped(flight: ClockedLog, impact_s: float) -> float:
    """When it leant too far in the seconds before the impact; NaN where it did not."""
    if flight.family not in ("ardupilot", "px4", "inav"):
        return float("nan")
    lean = tilt(flight)
    if lean is None:
        return float("nan")
    inside = lean.where((lean.time_s >= impact_s - BEFORE_S) & (lean.time_s <= impact_s + 0.5))
    over = inside.values > TIPPED_DEG
    return float(inside.time_s[np.argmax(over)]) if over.any() else float("nan")


def _breaks_off(flight: ClockedLog, impact_s: float, first_s: float) -> bool:
    """Whether the flight ends at an impact that is no landing: it stood upright, and had hardly sunk."""
    if _lands(flight, impact_s):
        return False
    return _never_carries(read_motors(flight), impact_s, first_s) or _never_moves(flight, impact_s)


def _lands(flight: ClockedLog, impact_s: float) -> bool:
    """Whether it came down upright and no faster than a landing that went wrong, at the end of a flight."""
    lean, down = tilt(flight), sink_speed(flight)
    if down is None:
        return False
    before = down.where((down.time_s > impact_s - 1.0) & (down.time_s <= impact_s + 0.1))
    if not len(before) or before.values.max() >= FALLING_M_S:
        return False
    if lean is None:  # what hit something in the air falls, what landed stands
        rest = down.where((down.time_s > impact_s + 0.1) & (down.time_s < impact_s + 1.0))
        return bool(len(rest)) and float(np.abs(rest.values).max()) < STANDS_M_S
    after = lean.where((lean.time_s > impact_s - 0.5) & (lean.time_s < impact_s + 1.0))
    return bool(len(after)) and float(after.values.max()) < UPRIGHT_DEG


def _never_moves(flight: ClockedLog, impact_s: float) -> bool:
    """Whether a vehicle that flew or drove fast stands still for good from the impact on."""
    thing = next(iter(flight.things("GPS")), "GPS")
    speed = flight.quantity(f"{thing}.Spd", "sensor_gps.vel_m_s", unit="m/s", stated="m/s")
    if speed is None:
        return False
    before = speed.where((speed.time_s > impact_s - BEFORE_S) & (speed.time_s < impact_s - 0.5))
    after = speed.where(speed.time_s > impact_s + BEFORE_S)
    if len(before) < 3 or len(after) < 3:
        return False
    return bool(np.median(before.values) > FALLING_M_S and after.values.max() < STANDS_M_S)


def _never_carries(motors: tuple[Motor, ...], impact_s: float, first_s: float) -> bool:
    """Whether the motors idle from soon after the impact to the end of the log."""
    if not motors:
        return False
    command = motors[0].command
    mean = np.mean([m.command.at(command.time_s) for m in motors], axis=0)
    before = (command.time_s > first_s) & (command.time_s < impact_s - BEFORE_S)
    after = command.time_s > impact_s + STOPS_S
    if not before.any():
        return False
    return bool(not after.any() or np.nanmax(mean[after]) < 0.5 * np.nanmedian(mean[before]))
