"""Vibration of the accelerometer by each firmware's own scale, and its clips since take-off."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.reviews.fact import Fact, Grade
from flysid.reviews.figures import absent, fact_of, limit
from flysid.reviews.logged import Column, LoggedFlight
from flysid.reviews.remedies import remedy

LIMITS = {"ardupilot": "vibration.ardupilot_vibe", "px4": "vibration.px4_accel"}
OF_PEAKS = ("ardupilot",)
"""Firmwares whose limit holds for peaks, too: VIBE is a mean over seconds already."""
CLIPS = {"ardupilot": "vibration.ardupilot_clips", "px4": "vibration.px4_clips"}


def accelerometer_level(flight: LoggedFlight) -> Iterator[Fact]:
    """The firmware's own measure of vibration in the air: its median in the worst axis, and its peak."""
    found = [c.where(flight.flying(c.time_s)) for c in _levels(flight)]
    found = [column for column in found if len(column)]
    if not found:
        yield absent("vibration.accel_level", _why(flight), remedy(flight, "vibration"))
        return
    bound = limit(LIMITS[flight.family])
    worst = max(found, key=lambda column: float(np.median(column.values)))
    value = float(np.median(worst.values))
    note = f"median of {worst.address}; {bound.source}"
    yield fact_of("vibration.accel_level", value, (worst.address,), note=note, grade=bound.grade(value))
    highest = max(found, key=lambda column: float(column.values.max()))
    top = int(highest.values.argmax())
    value, at_s = float(highest.values[top]), float(highest.time_s[top])
    grade = bound.grade(value) if flight.family in OF_PEAKS else Grade.PLAIN
    yield fact_of("vibration.accel_peak", value, (highest.address,), at_s=at_s, grade=grade)


def accelerometer_clips(flight: LoggedFlight) -> Iterator[Fact]:
    """How often the accelerometer was at its limit since take-off, in the worst axis."""
    counters = _counters(flight)
    grown = [(_growth(column.where(flight.flying(column.time_s))), column.address) for column in counters]
    if not grown:
        yield absent("vibration.accel_clips", _why(flight), remedy(flight, "vibration"))
        return
    count, address = max(grown)
    bound = limit(CLIPS[flight.family])
    note = f"since take-off; {bound.source}"
    yield fact_of("vibration.accel_clips", count, (address,), note=note, grade=bound.grade(count))


def _growth(column: Column) -> float:
    """By how much a counter rose; one that was set back begins anew."""
    return float(np.maximum(np.diff(column.values), 0.0).sum())


def _found(flight: LoggedFlight, addresses: Sequence[str], unit: str = "") -> list[Column]:
    columns = (flight.quantity(address, unit=unit, stated=unit) for address in addresses)
    return [column for column in columns if column is not None]


def _levels(flight: LoggedFlight) -> list[Column]:
    if flight.family == "ardupilot":
        names = [f"{stream}.Vibe{axis}" for stream in flight.things("VIBE") for axis in "XYZ"]
        return _found(flight, names or [f"VIBRATION.vibration_{axis}" for axis in "xyz"], "m/s/s")
    if flight.family == "px4":
        names = [f"vehicle_imu_status{_used(flight)}.accel_vibration_metric", "estimator_status.vibe[2]"]
        return _found(flight, names)[:1]
    return []


def _used(flight: LoggedFlight) -> str:
    """The end of the name of the accelerometer that PX4 flew on; the first where it does not say."""
    chosen = flight.quantity("sensor_selection.accel_device_id")
    for end in ("", "#1", "#2", "#3") if chosen is not None else ():
        own = flight.quantity(f"vehicle_imu_status{end}.accel_device_id")
        if chosen is not None and own is not None and own.values[-1] == chosen.values[-1]:
            return end
    return ""


def _counters(flight: LoggedFlight) -> list[Column]:
    if flight.family == "ardupilot":
        names = [f"{s}.{name}" for s in flight.things("VIBE") for name in ("Clip", "Clip0", "Clip1", "Clip2")]
        return _found(flight, names or [f"VIBRATION.clipping_{k}" for k in range(3)])
    if flight.family == "px4":
        names = [f"vehicle_imu_status{_used(flight)}.accel_clipping[{axis}]" for axis in range(3)]
        return _found(flight, names)
    return []


def _why(flight: LoggedFlight) -> str:
    if flight.has("main") and flight.headers:
        edge = flight.parameters.get("acc_lpf_hz", 0.0) / 100.0
        return f"the logged accelerometer is low-passed at {edge:g} Hz" if edge else "it is not logged"
    return "the log does not hold it"
