"""Compass, barometer and inertial sensors of a log: do they agree with each other and with the flight?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.reviews.battery import read_battery
from flysid.reviews.fact import Action, Fact, Finding, Grade
from flysid.reviews.limits import limit
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

    Parameters
    ----------
    before_s : take so much of the time before each take-off, too.
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
    known = limit("estimator.compass_change")
    grade = Grade.WATCH if known.grade(change) is not Grade.GOOD else Grade.GOOD
    yield Fact(
        "estimator.field_change",
        "change of the magnetic field in flight",
        100.0 * change,
        "%",
        grade=grade,
        note=f"of 90 % of the flight; {known.source}",
        fields=(field.address,),
        at_s=float(field.time_s[np.argmax(np.abs(field.values - middle))]),
    )


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
    key, label = "estimator.compass_change", "change of the magnetic field with the current"
    if field is None or effort is None or field.covered_s < LEAST_S:
        yield Fact(key, label, missing="compass, or current and throttle, are not logged in the air")
        return
    drawn = effort.at(field.time_s)
    kept = np.isfinite(drawn)
    drawn, strength = drawn[kept], field.values[kept]
    if len(drawn) < 10 or np.ptp(drawn) == 0.0:
        yield Fact(key, label, missing="the current does not change")
        return
    slope, _ = np.polyfit(drawn, strength, 1)
    range_of_current = float(np.ptp(np.percentile(drawn, [1.0, 99.0])))
    change = abs(float(slope)) * range_of_current / float(np.median(strength))
    known = limit(key)
    if change >= known.watch and np.corrcoef(drawn, strength)[0, 1] ** 2 < FOLLOWS:
        yield Fact(key, label, missing="the field changes for other reasons", fields=(field.address,))
        return
    yield Fact(
        key,
        label,
        100.0 * change,
        "%",
        grade=known.grade(change),
        note=f"over the range of the current; {known.source}",
        fields=(field.address, effort.address),
    )


# ------------------------------------------------------------------------------------------- barometer


def _barometer(flight: LoggedFlight) -> Iterator[Fact]:
    thing = (flight.things("BARO") or ["BARO"])[0]
    receiver = (flight.things("GPS") or ["GPS"])[0]
    height = flight.quantity(f"{thing}.Alt", "vehicle_air_data.baro_alt_meter", unit="m", stated="m")
    above = flight.quantity(
        f"{receiver}.Alt",
        "sensor_gps.altitude_msl_m",
        "vehicle_gps_position.altitude_msl_m",
        unit="m",
        stated="m",
    )
    fix = flight.quantity(f"{receiver}.Status", "sensor_gps.fix_type", "vehicle_gps_position.fix_type")
    if height is None or above is None or fix is None:
        return
    known = above.where(flight.flying(above.time_s) & (fix.held(above.time_s) >= 3))
    apart = known.values - height.at(known.time_s)
    kept = np.isfinite(apart)
    if kept.sum() < 10:
        return
    drift = np.polyval(np.polyfit(known.time_s[kept], apart[kept], 1), known.time_s[kept])
    yield Fact(
        "estimator.baro_gps",
        "barometer against GPS",
        float(np.std(apart[kept] - drift)),
        "m",
        note="standard deviation of their difference, less a steady drift",
        fields=(height.address, known.address),
    )


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
    for field, key, label, unit in (
        ("Acc", "accel_disagreement", "difference between accelerometers", "m/s2"),
        ("Gyr", "gyro_disagreement", "difference between gyros", "deg/s"),
    ):
        sensors = _instances(flight, field)
        if len(sensors) < 2:
            continue
        means = np.array([[np.median(axis.values) for axis in sensor] for sensor in sensors])
        apart = max(float(np.linalg.norm(mean - means[0])) for mean in means[1:])
        known = limit(f"estimator.{key}")
        yield Fact(
            f"estimator.{key}",
            label,
            apart,
            unit,
            grade=known.grade(apart),
            note=f"of their medians; {known.source}",
            fields=tuple(sensor[0].address for sensor in sensors),
        )
    shakes = shake_of_each(flight)
    if len(shakes) < 2:
        return
    known = limit("estimator.shake_ratio")
    ratio = max(shakes.values()) / max(min(shakes.values()), 1e-3)
    yield Fact(
        "estimator.shake_ratio",
        "most over least shaken accelerometer",
        ratio,
        "",
        grade=known.grade(ratio),
        note=known.source,
        fields=tuple(shakes),
    )


def shake_of_each(flight: LoggedFlight) -> dict[str, float]:
    """Field -> how much each accelerometer shakes in the air, in m/s2; else the firmware's own measure."""
    found = {}
    for sensor in _instances(flight, "Acc"):
        found[sensor[2].address] = float(np.sqrt(sum(_fast(axis.values) for axis in sensor)))
    if found:
        return found
    for topic in ("vehicle_imu_status", *(f"vehicle_imu_status#{i}" for i in range(1, MOST))):
        address = f"{topic}.accel_vibration_metric"
        metric = flight.quantity(address, unit="m/s/s", stated="m/s/s")
        flown = None if metric is None else metric.where(flight.flying(metric.time_s))
        if flown is not None and len(flown) >= 5:
            found[address] = float(np.mean(flown.values))
    return found


def _fast(values: FloatArray) -> float:
    """Power of what is too fast to be flight, from differences between samples; a tenth may be wrong."""
    return 0.5 * float(np.percentile(np.abs(np.diff(values)), 80.0) / NORMAL_80) ** 2


# ------------------------------------------------------------------------------------------- processor


def _load(flight: LoggedFlight) -> Iterator[Fact]:
    load = flight.quantity("cpuload.load")
    if load is not None:
        known = limit("estimator.cpu_load")
        high = float(np.percentile(load.values, 95.0))
        fields = (load.address,)
        yield Fact(
            "estimator.cpu_load",
            "processor load",
            100.0 * high,
            "%",
            None,
            known.grade(high),
            known.source,
            fields,
        )
    late = flight.quantity("PM.NLon")
    loops = flight.quantity("PM.NLoop", "PM.NL")
    if late is not None and loops is not None and loops.values.sum() > 0.0:
        share = float(late.values.sum() / loops.values.sum())
        yield Fact("estimator.late_loops", "loops that ran late", 100.0 * share, "%", fields=(late.address,))


# ------------------------------------------------------------------------------------------- findings


def findings(stated: Sequence[Fact], flight: LoggedFlight) -> Iterator[Finding]:
    """What is wrong with a sensor."""
    by_key = {fact.key.partition(".")[2]: fact for fact in stated if isinstance(fact.value, float)}
    shake = by_key.get("shake_ratio")
    if shake is not None and shake.grade.rank >= Grade.WATCH.rank:
        shakes = list(shake_of_each(flight).values())
        loudest = int(np.argmax(shakes)) + 1
        text = f"Accelerometer {loudest} shakes {shake.value:.0f} times as much as another"
        yield Finding(
            text, shake.grade, 0.95, shake.key, "a loose sensor or board: others beside it do not feel that"
        )
    apart = by_key.get("accel_disagreement")
    if apart is not None and apart.grade.rank >= Grade.WATCH.rank:
        text = f"Accelerometers differ by {apart.value:.1f} m/s2"
        yield Finding(text, apart.grade, 0.5, apart.key, apart.note.partition("; ")[2])
    gyros = by_key.get("gyro_disagreement")
    if gyros is not None and gyros.grade.rank >= Grade.WATCH.rank:
        text = f"Gyros differ by {gyros.value:.0f} deg/s"
        yield Finding(text, gyros.grade, 0.5, gyros.key, gyros.note.partition("; ")[2])
    compass = by_key.get("compass_change")
    if compass is not None and compass.grade.rank >= Grade.WATCH.rank:
        text = f"The current turns the compass's field by {compass.value:.0f} %"
        weight = 0.8 if compass.grade is Grade.BAD else 0.5
        yield Finding(text, compass.grade, weight, compass.key, compass.note.partition("; ")[2])
    field = by_key.get("field_change")
    if (
        field is not None
        and field.grade is not Grade.GOOD
        and (compass is None or compass.grade is Grade.GOOD)
    ):
        text = f"The magnetic field changes by {field.value:.0f} % along the way"
        yield Finding(text, field.grade, 0.35, field.key, "iron nearby, or a compass that is not calibrated")
    load = by_key.get("cpu_load")
    if load is not None and load.grade.rank >= Grade.WATCH.rank:
        yield Finding(f"The processor is loaded to {load.value:.0f} %", load.grade, 0.3, load.key, load.note)


def actions(stated: Sequence[Fact]) -> Iterator[Action]:
    """What to do about a sensor."""
    by_key = {fact.key: fact for fact in stated}
    shake = by_key.get("estimator.shake_ratio")
    if shake is not None and shake.grade.rank >= Grade.WATCH.rank:
        yield Action(
            "Fasten the flight controller and its sensor",
            f"one accelerometer shakes {shake.words} times as much as another on the same vehicle",
            predicted="accelerometers that feel the same within a factor of two",
            weight=0.8,
            fact=shake.key,
        )
    compass = by_key.get("estimator.compass_change")
    if compass is not None and compass.grade.rank >= Grade.WATCH.rank:
        yield Action(
            "Move the compass away from the battery leads",
            f"the magnetic field changes by {compass.words} with the current",
            predicted="less than 30 % of change",
            weight=0.5,
            fact=compass.key,
        )
