"""Compass, barometer and inertial sensors of a log: do they agree with each other and with the flight?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.reviews.battery import read_battery
from flysid.reviews.fact import Fact, Finding
from flysid.reviews.figures import absent, exceeded, fact_of, limit
from flysid.reviews.logged import Column, LoggedFlight

LEAST_S = 5.0
NORMAL_80 = 1.2816
"""Deviations within which four fifths of normal values lie."""
BEFORE_S = 10.0
"""Before take-off the motors draw nothing: the field that they add shows most from there to hovering."""
FOLLOWS = 0.3
"""Share of the field's variance from which on the current is its cause."""
AXES = "XYZ"
MOST = 4
"""Inertial sensors of PX4."""
LEAST = 5
"""Samples."""


def facts(flight: LoggedFlight) -> Iterator[Fact]:
    """Compass against itself and the current, barometer against GPS, inertial sensors against each other."""
    yield from _field_change(flight)
    yield from _compass(flight)
    yield from _barometer(flight)
    yield from _inertial(flight)
    yield from _load(flight)


# ------------------------------------------------------------------------------------------- compass


def _field(flight: LoggedFlight, before_s: float = 0.0) -> Column | None:
    """Strength of the magnetic field in the air, in the log's unit: only its change counts.

    `before_s`: take so much of the time before each take-off, too.
    """
    thing = (flight.things("MAG") or ["MAG"])[0]
    addresses = [f"{thing}.Mag{axis}" for axis in AXES]
    if flight.has("vehicle_magnetometer"):
        topic = flight.things("vehicle_magnetometer")[0]
        addresses = [f"{topic}.magnetometer_ga[{i}]" for i in range(3)]
    parts = [flight.quantity(address) or flight.quantity(address, unit="Gauss") for address in addresses]
    known = [part for part in parts if part is not None]
    if len(known) < 3 or len({len(part) for part in known}) > 1:
        return None
    strength = np.sqrt(sum(part.values**2 for part in known))
    column = Column(addresses[0], "", known[0].time_s, strength)
    in_the_air = flight.flying(column.time_s) | flight.flying(column.time_s + before_s)
    return column.where(in_the_air & (strength > 0.0))


def _field_change(flight: LoggedFlight) -> Iterator[Fact]:
    field = _field(flight)
    if field is None or field.covered_s < LEAST_S:
        return
    low, middle, high = np.percentile(field.values, [5.0, 50.0, 95.0])
    change = float((high - low) / middle)
    at_s = float(field.time_s[np.argmax(np.abs(field.values - middle))])
    note = "of 90 % of the flight"
    yield fact_of("estimator.field_change", 100.0 * change, (field.address,), note=note, at_s=at_s)


def _effort(flight: LoggedFlight) -> Column | None:
    """What disturbs a compass: the current, else the throttle."""
    current = read_battery(flight).current
    if current is not None:
        return current
    throttle = flight.quantity("CTUN.ThO")
    if throttle is not None:
        return throttle
    thrust = flight.quantity("vehicle_thrust_setpoint.xyz[2]")
    return None if thrust is None else Column(thrust.address, "", thrust.time_s, -thrust.values)


def _compass(flight: LoggedFlight) -> Iterator[Fact]:
    field, effort = _field(flight, BEFORE_S), _effort(flight)
    key = "estimator.compass_change"
    if field is None or effort is None or field.covered_s < LEAST_S:
        yield absent(key, "compass, or current and throttle, are not logged in the air")
        return
    drawn = effort.at(field.time_s)
    kept = np.isfinite(drawn)
    drawn, strength = drawn[kept], field.values[kept]
    if len(drawn) < 10 or np.ptp(drawn) == 0.0:
        yield absent(key, "the current does not change")
        return
    slope, _ = np.polyfit(drawn, strength, 1)
    range_of_current = float(np.ptp(np.percentile(drawn, [1.0, 99.0])))
    change = 100.0 * (abs(float(slope)) * range_of_current / float(np.median(strength)))
    if change >= limit(key).watch and np.corrcoef(drawn, strength)[0, 1] ** 2 < FOLLOWS:
        yield absent(key, "the field changes for other reasons", fields=(field.address,))
    else:
        note = "over the range of the current"
        yield fact_of(key, change, (field.address, effort.address), note=note)


# ------------------------------------------------------------------------------------------- barometer


def _barometer(flight: LoggedFlight) -> Iterator[Fact]:
    thing = (flight.things("BARO") or ["BARO"])[0]
    receiver = (flight.things("GPS") or ["GPS"])[0]
    height = flight.quantity(f"{thing}.Alt", "vehicle_air_data.baro_alt_meter", unit="m", stated="m")
    px4 = ("sensor_gps", "vehicle_gps_position")
    above = flight.quantity(
        f"{receiver}.Alt", *(f"{topic}.altitude_msl_m" for topic in px4), unit="m", stated="m"
    )
    fix = flight.quantity(f"{receiver}.Status", *(f"{topic}.fix_type" for topic in px4))
    if height is None or above is None or fix is None:
        return
    known = above.where(flight.flying(above.time_s) & (fix.held(above.time_s) >= 3))
    apart = known.values - height.at(known.time_s)
    kept = np.isfinite(apart)
    if kept.sum() < 10:
        return
    drift = np.polyval(np.polyfit(known.time_s[kept], apart[kept], 1), known.time_s[kept])
    note = "standard deviation of their difference, less a steady drift"
    spread = float(np.std(apart[kept] - drift))
    yield fact_of("estimator.baro_gps", spread, (height.address, known.address), note=note)


# ------------------------------------------------------------------------------------------- inertial sensors


def _instances(flight: LoggedFlight, field: str) -> list[list[Column]]:
    """Three axes each of every inertial sensor, in the air."""
    things = flight.things("IMU")
    if len(things) < 2:
        things = [name for name in ("IMU", "IMU2", "IMU3") if flight.has(name)]
    found = []
    for thing in things:
        unit = "m/s/s" if field == "Acc" else "deg/s"
        stated = "m/s/s" if field == "Acc" else "rad/s"
        axes = [flight.quantity(f"{thing}.{field}{axis}", unit=unit, stated=stated) for axis in AXES]
        known = [axis.where(flight.flying(axis.time_s)) for axis in axes if axis is not None]
        if len(known) == 3 and known[0].covered_s >= LEAST_S:
            found.append(known)
    return found


def _inertial(flight: LoggedFlight) -> Iterator[Fact]:
    for field, key in (("Acc", "estimator.accel_disagreement"), ("Gyr", "estimator.gyro_disagreement")):
        sensors = _instances(flight, field)
        if len(sensors) > 1:
            means = np.array([[np.median(axis.values) for axis in sensor] for sensor in sensors])
            apart = max(float(np.linalg.norm(mean - means[0])) for mean in means[1:])
            yield fact_of(key, apart, tuple(sensor[0].address for sensor in sensors), note="of their medians")
    shakes = shake_of_each(flight)
    if len(shakes) > 1:
        ratio = max(shakes.values()) / max(min(shakes.values()), 1e-3)
        yield fact_of("estimator.shake_ratio", ratio, tuple(shakes))


def shake_of_each(flight: LoggedFlight) -> dict[str, float]:
    """Field -> how much each accelerometer shakes in the air, in m/s2; else the firmware's own measure."""
    found = {}
    for sensor in _instances(flight, "Acc"):
        found[sensor[2].address] = float(np.sqrt(sum(_fast(axis.values) for axis in sensor)))
    if found:
        return found
    for thing in flight.things("VIBE"):
        axes = [flight.quantity(f"{thing}.Vibe{axis}", unit="m/s/s", stated="m/s/s") for axis in AXES]
        known = [axis.where(flight.flying(axis.time_s)) for axis in axes if axis is not None]
        if len(known) == len(AXES) and min(map(len, known)) >= LEAST:
            found[known[2].address] = float(np.sqrt(sum(np.median(axis.values) ** 2 for axis in known)))
    for topic in ("vehicle_imu_status", *(f"vehicle_imu_status#{i}" for i in range(1, MOST))):
        address = f"{topic}.accel_vibration_metric"
        metric = flight.quantity(address, unit="m/s/s", stated="m/s/s")
        flown = None if metric is None else metric.where(flight.flying(metric.time_s))
        if flown is not None and len(flown) >= LEAST:
            found[address] = float(np.mean(flown.values))
    return found


def _fast(values: FloatArray) -> float:
    """Power of what is too fast to be flight, from differences between samples; a tenth may be wrong."""
    return 0.5 * float(np.percentile(np.abs(np.diff(values)), 80.0) / NORMAL_80) ** 2


# ------------------------------------------------------------------------------------------- processor


def _load(flight: LoggedFlight) -> Iterator[Fact]:
    load = flight.quantity("cpuload.load")
    if load is not None:
        yield fact_of("estimator.cpu_load", 100.0 * float(np.percentile(load.values, 95.0)), (load.address,))
    late = flight.quantity("PM.NLon")
    loops = flight.quantity("PM.NLoop", "PM.NL")
    if late is not None and loops is not None and loops.values.sum() > 0.0:
        share = float(late.values.sum() / loops.values.sum())
        yield fact_of("estimator.late_loops", 100.0 * share, (late.address,))


# ------------------------------------------------------------------------------------------- findings


def findings(stated: Sequence[Fact], flight: LoggedFlight) -> Iterator[Finding]:
    """A sensor that is loose."""
    shake = exceeded(stated).get("estimator.shake_ratio")
    if shake is not None:
        loudest = int(np.argmax(list(shake_of_each(flight).values()))) + 1
        text = f"Accelerometer {loudest} shakes {shake.value:.0f} times as much as another"
        more = "a loose sensor or board: others beside it do not feel that"
        yield Finding(text, shake.grade, 0.95, shake.key, more)
