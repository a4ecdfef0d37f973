"""The GPS of a log: fix, satellites, accuracy, jamming, and jumps beyond the vehicle's speed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.reviews.fact import Fact, Finding, Grade
from flysid.reviews.figures import absent, fact_of, limit
from flysid.reviews.logged import Column, LoggedFlight

FIX_3D = 3
"""INAV counts from none, 2D, 3D: one less."""
EARTH_M = 6_371_008.8
SENTINEL_M = 1e4
"""Accuracies beyond it are a receiver's word for none: 4.29e6 m of PX4, 65535 cm of MAVLink times ten."""
LEAST = 5
"""Samples."""
LASTS_S, MOST_SHARE = 3.0, 0.05
"""A receiver that sees little for so long, or for so much of a short flight, is worth a word."""
NOWHERE_M = 1e5
"""From one sample to the next: it is no place at all, such as 0 degrees, 0 degrees."""
SAME = 0.8
"""Of the largest jump: the first of that size is where it began, and the largest may be the way back."""


@dataclass(frozen=True, eq=False)
class Receiver:
    """What the first receiver logged in the air; None where it did not."""

    fix: Column | None
    satellites: Column | None
    hdop: Column | None
    accuracy: Column | None
    speed_accuracy: Column | None
    jamming: Column | None
    north: Column | None
    east: Column | None
    speed: Column | None


def read_receiver(flight: LoggedFlight) -> Receiver:
    """The receiver that the autopilot flies by, in the air."""
    found = {name: _in_the_air(flight, fields, unit) for name, (fields, unit) in _fields(flight).items()}
    fix = found["fix"]
    if fix is not None and fix.address.startswith("gps."):
        fix = found["fix"] = replace(fix, values=fix.values + 1.0)
    for name in ("satellites", "hdop", "accuracy", "speed_accuracy", "latitude", "longitude", "speed"):
        column = found[name]
        if column is not None and fix is not None and name != "satellites":
            found[name] = column.where(fix.held(column.time_s) >= FIX_3D)
    for name in ("accuracy", "hdop"):
        column = found[name]
        if column is not None:
            found[name] = column.where((column.values > 0.0) & (column.values < SENTINEL_M))
    north, east = _metres(found.pop("latitude"), found.pop("longitude"))
    return Receiver(**found, north=north, east=east)


def _fields(flight: LoggedFlight) -> dict[str, tuple[Sequence[str], str]]:
    """What is looked for -> fields of the firmwares, and the unit that is wanted."""
    gps = (flight.things("GPS") or ["GPS"])[0]
    accuracy = (flight.things("GPA") or ["GPA"])[0]
    ublox = (flight.things("UBX1") or ["UBX1"])[0]
    px4 = [thing for name in ("sensor_gps", "vehicle_gps_position") for thing in flight.things(name)[:1]]

    def named(*fields: str) -> list[str]:
        return [f"{topic}.{field}" for topic in px4 for field in fields]

    return {
        "fix": ([f"{gps}.Status", *named("fix_type"), "GPS_RAW_INT.fix_type", "gps.GPS_fixType"], ""),
        "satellites": (
            [f"{gps}.NSats", *named("satellites_used"), "GPS_RAW_INT.satellites_visible", "gps.GPS_numSat"],
            "",
        ),
        "hdop": ([f"{gps}.HDop", *named("hdop"), "gps.GPS_hdop"], ""),
        "accuracy": ([f"{accuracy}.HAcc", *named("eph")], "m"),
        "speed_accuracy": ([f"{accuracy}.SAcc", *named("s_variance_m_s")], "m/s"),
        "jamming": ([f"{ublox}.jamInd", *named("jamming_indicator")], ""),
        "latitude": (
            [f"{gps}.Lat", *named("latitude_deg", "lat"), "GPS_RAW_INT.lat", "gps.GPS_coord[0]"],
            "deg",
        ),
        "longitude": (
            [f"{gps}.Lng", *named("longitude_deg", "lon"), "GPS_RAW_INT.lon", "gps.GPS_coord[1]"],
            "deg",
        ),
        "speed": ([f"{gps}.Spd", *named("vel_m_s"), "GPS_RAW_INT.vel", "gps.GPS_speed"], "m/s"),
    }


def _in_the_air(flight: LoggedFlight, fields: Sequence[str], unit: str) -> Column | None:
    scale = {"lat": "degE7", "lon": "degE7"}
    for field in fields:
        stated = scale.get(field.rpartition(".")[2], unit)
        column = flight.quantity(field, unit=unit, stated=stated)
        if column is None and not unit:
            column = flight.quantity(field, unit="m")  # ArduPilot states metres for a dilution
        if column is not None:
            return column.where(flight.flying(column.time_s))
    return None


def _metres(latitude: Column | None, longitude: Column | None) -> tuple[Column | None, Column | None]:
    if latitude is None or longitude is None or not len(latitude) or len(latitude) != len(longitude):
        return None, None
    north = np.radians(latitude.values - latitude.values[0]) * EARTH_M
    shrunk = np.cos(np.radians(latitude.values[0]))
    east = np.radians(longitude.values - longitude.values[0]) * EARTH_M * shrunk
    return (
        Column(latitude.address, "m", latitude.time_s, north),
        Column(longitude.address, "m", longitude.time_s, east),
    )


def find_jump(receiver: Receiver) -> tuple[float, float]:
    """How far the largest jump goes beyond what the speed allows, in m, and when it began; NaN if unknown."""
    north, east = receiver.north, receiver.east
    if north is None or east is None or len(north) < LEAST:
        return float("nan"), float("nan")
    step_s = np.diff(north.time_s)
    moved = np.hypot(np.diff(north.values), np.diff(east.values))
    speed = receiver.speed
    flown = (
        np.zeros(len(north)) if speed is None or not len(speed) else np.nan_to_num(speed.held(north.time_s))
    )
    allowed = np.maximum(flown[1:], flown[:-1]) * step_s
    beyond = np.where((step_s < 10.0 * north.period_s) & (moved < NOWHERE_M), moved - allowed, 0.0)
    largest = float(beyond.max())
    first = int(np.argmax(beyond >= SAME * largest))
    return max(0.0, largest), float(north.time_s[first + 1])


def facts(receiver: Receiver) -> Iterator[Fact]:
    """Fix, satellites, dilution, accuracy, jamming, jumps."""
    fix = receiver.fix
    if fix is None or not len(fix):
        satellites = receiver.satellites
        if satellites is None or not len(satellites):
            yield absent("estimator.gps_fix", "no GPS is logged in the air", which="GPS fix")
            return
    else:
        share = float(np.mean(fix.values >= FIX_3D))
        grade = Grade.GOOD if share == 1.0 else Grade.PLAIN if share == 0.0 else Grade.WATCH
        at_s = None if share in (0.0, 1.0) else float(fix.time_s[np.argmax(fix.values < FIX_3D)])
        fields, which = (fix.address,), "time with a fix"
        yield fact_of("estimator.gps_fix", 100.0 * share, fields, grade=grade, at_s=at_s, which=which)
        if share == 0.0:
            return
    yield from _worst("estimator.satellites", receiver.satellites)
    yield from _worst("estimator.hdop", receiver.hdop)
    yield from _worst("estimator.eph", receiver.accuracy)
    yield from _worst("estimator.speed_accuracy", receiver.speed_accuracy)
    yield from _worst("estimator.jamming", receiver.jamming)
    jump_m, at_s = find_jump(receiver)
    if np.isfinite(jump_m) and receiver.north is not None:
        seen = at_s if jump_m >= limit("estimator.gps_jump").watch else None
        yield fact_of("estimator.gps_jump", jump_m, (receiver.north.address,), at_s=seen)


def _worst(key: str, column: Column | None) -> Iterator[Fact]:
    """The worst value that lasts: of a twentieth of the flight, or of three seconds of a long one."""
    if column is None or len(column) < LEAST:
        return
    known = limit(key)
    share = min(MOST_SHARE, LASTS_S / max(column.covered_s, LASTS_S))
    sign = 1.0 if known.bad >= known.watch else -1.0
    value = sign * float(np.quantile(sign * column.values, 1.0 - share))
    at_s = float(column.time_s[np.argmax(sign * column.values >= sign * value)])
    note = f"for {share * column.covered_s:.0f} s in all"
    yield fact_of(key, value, (column.address,), note=note, at_s=at_s)


def is_disturbed(stated: Sequence[Fact]) -> bool:
    """Whether the receiver itself shows that it jumped, was jammed, or saw too few satellites."""
    by_key = {fact.key.partition(".")[2]: fact for fact in stated}
    worst = {name: by_key[name].grade for name in ("gps_jump", "jamming", "satellites") if name in by_key}
    return worst.get("gps_jump", Grade.GOOD) is not Grade.GOOD or Grade.BAD in worst.values()


def findings(stated: Sequence[Fact], receiver: Receiver) -> Iterator[Finding]:
    """A jump, a fix that was lost, few satellites."""
    by_key = {fact.key.partition(".")[2]: fact for fact in stated if isinstance(fact.value, float)}
    jump = by_key.get("gps_jump")
    if jump is not None and jump.grade.rank >= Grade.WATCH.rank and jump.at_s is not None:
        seen = receiver.satellites
        count = float(seen.held(np.array([jump.at_s]))[0]) if seen is not None and len(seen) else float("nan")
        more = f"with {count:.0f} satellites" if np.isfinite(count) else ""
        text = f"The GPS jumps {jump.value:.0f} m at {jump.at_s:.0f} s"
        yield Finding(text, jump.grade, 0.9, jump.key, more)
    fix = by_key.get("gps_fix")
    if fix is not None and fix.grade is not Grade.GOOD:
        lost = fix.grade is Grade.WATCH
        text = f"The GPS loses its fix at {fix.at_s:.0f} s" if lost and fix.at_s is not None else "No GPS fix"
        more = f"a fix in {fix.value:.0f} % of the flight" if lost else "position was not judged"
        yield Finding(text, fix.grade, 0.7 if lost else 0.2, fix.key, more)
    few = by_key.get("satellites")
    if few is not None and few.grade is not Grade.GOOD and _is_inaccurate(by_key):
        text = f"The GPS has only {few.value:.0f} satellites at {few.at_s:.0f} s"
        weight = 0.82 if few.grade is Grade.BAD else 0.35
        yield Finding(text, few.grade, weight, few.key, few.note.partition("; ")[2])


def _is_inaccurate(by_key: Mapping[str, Fact]) -> bool:
    """Whether few satellites cost accuracy: a receiver may do well with ten."""
    return any(by_key[key].grade is not Grade.GOOD for key in ("hdop", "eph") if key in by_key)
