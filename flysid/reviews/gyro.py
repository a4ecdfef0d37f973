"""Where each firmware logs its gyro, before its filters and behind them; and how its motors turn."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.flight import thing_of
from flysid.reviews.logged import Column, LoggedFlight
from flysid.reviews.remedies import remedy
from flysid.spectra.causes import Source

AXES = ("roll", "pitch", "yaw")
UNIT = "deg/s"
GYRO_SCALED = 6
"""Betaflight's `debug_mode` from 4.0 to 4.5, with which debug[0] to [2] are the gyro before its filters."""
SCALED_IN = re.compile(r"Betaflight 4\.[0-5]\b")


@dataclass(frozen=True, eq=False)
class LoggedGyro:
    """Body rates of a log in deg/s.

    `raw`: axis -> before the filters; {} where the log has them nowhere.
    `filtered`: axis -> behind the filters.
    `every_sample`: raw holds samples that the filters ran on, so that they can be run again on it.
    `note`: what raw is, where it is not plainly the sensor's.
    `missing`, `remedy`: why there is no raw signal, and what logs it.
    """

    raw: Mapping[str, Column] = field(default_factory=dict)
    filtered: Mapping[str, Column] = field(default_factory=dict)
    every_sample: bool = False
    note: str = ""
    missing: str = ""
    remedy: str = ""

    @property
    def best(self) -> Mapping[str, Column]:
        """The one that shows higher frequencies."""
        if not self.raw or not self.filtered:
            return self.raw or self.filtered
        rates = [max(column.rate_hz for column in found.values()) for found in (self.raw, self.filtered)]
        return self.raw if rates[0] >= rates[1] else self.filtered


def logged_gyro(flight: LoggedFlight) -> LoggedGyro:
    """The gyro of a log, wherever its firmware writes it."""
    readers = {"ardupilot": _ardupilot, "px4": _px4, "betaflight": _blackbox, "inav": _blackbox}
    found = readers.get(flight.family, _others)(flight)
    if found.raw:
        return found
    why = "the log holds the gyro only behind the filters" if found.filtered else "the log holds no gyro"
    return LoggedGyro({}, found.filtered, missing=why, remedy=remedy(flight, "gyro"))


def _of_axes(flight: LoggedFlight, form: str, names: Sequence[str], stated: str = "") -> dict[str, Column]:
    """One column an axis, or none at all where one is missing."""
    found = [flight.quantity(form.format(name), unit=UNIT, stated=stated) for name in names]
    return {axis: c for axis, c in zip(AXES, found, strict=True) if c} if all(found) else {}


def _blackbox(flight: LoggedFlight) -> LoggedGyro:
    filtered = _of_axes(flight, "main.gyroADC[{}]", "012")
    raw = _of_axes(flight, "main.gyroUnfilt[{}]", "012") or _of_axes(flight, "main.gyroRaw[{}]", "012")
    if not raw and flight.headers.get("debug_mode") == str(GYRO_SCALED) and _logs_scaled(flight):
        raw = _of_axes(flight, "main.debug[{}]", "012", stated=UNIT)
    return LoggedGyro(raw, filtered, every_sample=True)


def _logs_scaled(flight: LoggedFlight) -> bool:
    """4.6 dropped that mode: its number is another one's there."""
    return bool(SCALED_IN.match(flight.headers.get("Firmware revision", "")))


def _px4(flight: LoggedFlight) -> LoggedGyro:
    filtered = _of_axes(flight, "vehicle_angular_velocity.xyz[{}]", "012")
    late = _lateness(flight, "vehicle_angular_velocity")
    if late is not None and filtered and len(late) == len(filtered["roll"]):
        filtered = {a: Column(c.address, c.unit, c.time_s - late, c.values) for a, c in filtered.items()}
    batches = _fifo(flight)
    if batches:
        return LoggedGyro(batches, filtered, every_sample=True)
    raw = _of_axes(flight, "sensor_gyro.{}", "xyz")
    rate = flight.quantity("vehicle_imu_status.gyro_rate_hz", unit="Hz")
    if raw and rate is not None and raw["roll"].rate_hz > 0.9 * float(np.median(rate.values)):
        return LoggedGyro(raw, filtered, every_sample=True)
    mean = _of_axes(flight, "sensor_combined.gyro_rad[{}]", "012")
    return LoggedGyro(mean, filtered, note="sensor_combined: the mean of the gyro over each period")


def _lateness(flight: LoggedFlight, message: str) -> FloatArray | None:
    """(N,) s by which rows were published after their samples were taken."""
    stamps = [flight.quantity(f"{message}.{name}", unit="us") for name in ("timestamp", "timestamp_sample")]
    published, taken = stamps
    if published is None or taken is None or not np.any(taken.values):
        return None
    return np.asarray((published.values - taken.values) * 1e-6)


def _fifo(flight: LoggedFlight) -> dict[str, Column]:
    """Samples of `sensor_gyro_fifo`: up to 32 a row, the last one at the row's time."""
    stream = flight.stream("sensor_gyro_fifo")
    if not stream:
        return {}
    table = flight.log.table(stream, ["time_ns", "boot", "dt", "scale", "samples", "x", "y", "z"])
    count = np.asarray(table["samples"], dtype=np.int64)
    period = np.asarray(table["dt"], dtype=np.float64) * 1e-6
    scale = np.asarray(table["scale"], dtype=np.float64) * 180.0 / np.pi
    ends = _seconds(flight, table)
    late = _lateness(flight, stream)
    ends = ends - late if late is not None and len(late) == len(ends) else ends
    taken = {name: _matrix(table[name]) for name in "xyz"}
    inside = np.arange(taken["x"].shape[1]) < count[:, None]
    back = (count[:, None] - 1 - np.arange(inside.shape[1])) * period[:, None]
    time_s = (ends[:, None] - back)[inside]
    return {
        axis: Column(f"{stream}.{name}", UNIT, time_s, (taken[name] * scale[:, None])[inside])
        for axis, name in zip(AXES, "xyz", strict=True)
    }


def _seconds(flight: LoggedFlight, table) -> FloatArray:  # type: ignore[no-untyped-def]
    boots = np.asarray(table["boot"])
    stamps = np.asarray(table["time_ns"], dtype=np.int64)
    return np.array([flight.clock.seconds(int(b), int(t)) for b, t in zip(boots, stamps, strict=True)])


def _matrix(column) -> FloatArray:  # type: ignore[no-untyped-def]
    """(N, k) of a column of lists of equal length."""
    return np.array(column.to_pylist(), dtype=np.float64)


def _ardupilot(flight: LoggedFlight) -> LoggedGyro:
    each = flight.things("GYR")
    filtered = _of_axes(flight, f"{_first(flight, 'IMU')}.Gyr{{}}", "XYZ", stated="rad/s") or _mavlink(flight)
    option = int(flight.parameters.get("INS_RAW_LOG_OPT", 0.0))
    if each and option & BOTH and len(each) > 1:
        behind = each[len(each) // 2]
        raw, filtered = (
            _of_axes(flight, f"{key}.Gyr{{}}", "XYZ", stated="rad/s") for key in (each[0], behind)
        )
        return LoggedGyro(raw, filtered, every_sample=True)
    if each and option & BEHIND:
        return LoggedGyro({}, _of_axes(flight, each[0] + ".Gyr{}", "XYZ", stated="rad/s"))
    if each:
        return LoggedGyro(
            _of_axes(flight, each[0] + ".Gyr{}", "XYZ", stated="rad/s"), filtered, every_sample=True
        )
    return LoggedGyro(_batches(flight), filtered, every_sample=True)


BEHIND = 4
BOTH = 8
"""Bits of INS_RAW_LOG_OPT: GYR is the gyro behind the filters; or both, these as instances of their own."""


def _batches(flight: LoggedFlight) -> dict[str, Column]:
    """Batches of the first gyro before its filters: a header ISBH, then ISBD with 32 samples each."""
    head, body = flight.stream("ISBH"), flight.stream("ISBD")
    if not head or not body or int(flight.parameters.get("INS_LOG_BAT_OPT", 0.0)) & BATCH_BEHIND:
        return {}
    heads = flight.log.table(
        head, ["time_ns", "boot", "N", "type", "instance", "mul", "SampleUS", "smp_rate"]
    ).to_pylist()
    rows = flight.log.table(body, ["boot", "N", "seqno", "x", "y", "z"]).to_pylist()
    found: dict[tuple[int, int], list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda row: (row["boot"], row["N"], row["seqno"])):
        found.setdefault((row["boot"], row["N"]), []).append(row)
    times: list[FloatArray] = []
    values: dict[str, list[FloatArray]] = {name: [] for name in "xyz"}
    for row in heads:
        parts = found.get((row["boot"], row["N"]), [])
        whole = all(part["seqno"] == k for k, part in enumerate(parts))
        if row["type"] != BATCH_GYRO or row["instance"] != 0 or not parts or not whole or not row["smp_rate"]:
            continue
        for name in "xyz":
            values[name].append(np.concatenate([part[name] for part in parts]) / row["mul"] * 180.0 / np.pi)
        begin = flight.clock.seconds(row["boot"], int(row["SampleUS"] * 1000) or row["time_ns"])
        times.append(begin + np.arange(len(values["x"][-1])) / row["smp_rate"])
    if not times:
        return {}
    time_s = np.concatenate(times)
    order = np.argsort(time_s, kind="stable")
    return {
        axis: Column(f"{body}.{name}", UNIT, time_s[order], np.concatenate(values[name])[order])
        for axis, name in zip(AXES, "xyz", strict=True)
    }


BATCH_GYRO = 1
BATCH_BEHIND = 2
"""`type` of an ISBH that begins samples of a gyro; bit of INS_LOG_BAT_OPT with which they are filtered."""


def _first(flight: LoggedFlight, message: str) -> str:
    """The first of the things of a message."""
    return next(iter(flight.things(message)), message)


def _mavlink(flight: LoggedFlight) -> dict[str, Column]:
    """What a ground station recorded of the first gyro."""
    forms = (
        ("HIGHRES_IMU.{}gyro", "rad/s"),
        ("RAW_IMU.{}gyro", "mrad/s"),
        ("RAW_IMU[0].{}gyro", "mrad/s"),
        ("SCALED_IMU.{}gyro", "mrad/s"),
    )
    found = (_of_axes(flight, form, "xyz", stated) for form, stated in forms)
    return next((columns for columns in found if columns), {})


def _others(flight: LoggedFlight) -> LoggedGyro:
    """What a recipe names; Crazyflie, other blackboxes, and MAVLink of other autopilots."""
    named = _named(flight)
    if named:
        return LoggedGyro({}, named)
    own = _of_axes(flight, "gyro.{}", "xyz", UNIT) or _of_axes(flight, "main.gyroADC[{}]", "012", UNIT)
    return LoggedGyro({}, own or _mavlink(flight))


def _named(flight: LoggedFlight) -> dict[str, Column]:
    """The body rates of the reader's own recipe; {} where it has not all three."""
    signals = {} if flight.recipe is None else flight.recipe.signals
    specs = [signals[name] for name in (f"{axis}_rate" for axis in AXES) if name in signals]
    found = [flight.signal(replace(spec, unit=UNIT)) for spec in specs]
    columns = [column for column in found if column is not None]
    return dict(zip(AXES, columns, strict=True)) if len(columns) == len(AXES) else {}


def throttle_of(flight: LoggedFlight) -> Column | None:
    """The throttle, 0 to 1, as the firmware's filters follow it."""
    mixed = flight.quantity("main.setpoint[3]", "CTUN.ThO")
    if mixed is not None:
        return mixed
    stick = flight.quantity("main.rcCommand[3]", unit="us")
    if stick is not None:
        return Column(stick.address, "", stick.time_s, np.clip((stick.values - 1000.0) / 1000.0, 0.0, 1.0))
    motors = [flight.quantity(f"actuator_motors.control[{k}]") for k in range(12)]
    driven = [m for m in motors if m is not None and len(m) and np.any(m.values > 0.0)]
    if not driven:
        return None
    time_s = driven[0].time_s
    return Column("actuator_motors.control", "", time_s, np.mean([m.held(time_s) for m in driven], axis=0))


def command_of(flight: LoggedFlight, axis: str) -> Column | None:
    """What the pilot asks of an axis, by sticks; by the attitude setpoint where no stick moves."""
    k = AXES.index(axis)
    sticks = [
        (f"main.rcCommand[{k}]", ""),
        (f"manual_control_setpoint.{axis}", ""),
        (f"manual_control_setpoint.{'yxr'[k]}", ""),
        (f"RCIN.C{(1, 2, 4)[k]}", "us"),
        (f"vehicle_attitude_setpoint.{axis}_body", "deg"),
        (f"ATT.Des{axis.capitalize()}", "deg"),
    ]
    found = (flight.quantity(address, unit=unit, stated=unit) for address, unit in sticks)
    return next((column for column in found if column is not None and np.ptp(column.values) > 0.0), None)


def motors_hz(flight: LoggedFlight) -> dict[int, Column]:
    """Number of a motor, from 1 -> its turns a second; {} where no ESC states any."""
    found: dict[int, Column] = {}
    for stream in flight.things("ESC"):
        _add(
            found,
            int(float(thing_of(stream) or 0)) + 1,
            flight.quantity(f"{stream}.RPM", unit="rpm", stated="rpm"),
        )
    for k in range(8):
        _add(found, k + 1, flight.quantity(f"main.eRPM[{k}]", unit="rpm"))
        function = flight.quantity(f"esc_status.esc[{k}].actuator_function")
        number = int(function.values[0]) - FIRST_MOTOR + 1 if function is not None else k + 1
        _add(found, number, flight.quantity(f"esc_status.esc[{k}].esc_rpm", unit="rpm", stated="rpm"))
    return dict(sorted(found.items()))


FIRST_MOTOR = 101
"""PX4's `actuator_function` of motor 1: an ESC's place in the message is not the motor's number."""


def _add(found: dict[int, Column], number: int, rpm: Column | None) -> None:
    """An ESC that states no turns in the whole log states none."""
    if rpm is not None and number > 0 and np.any(rpm.values != 0.0):
        found[number] = Column(rpm.address, "Hz", rpm.time_s, np.abs(rpm.values) / 60.0)


def sources_of(flight: LoggedFlight, axis: str) -> list[Source]:
    """What is known to turn or shake, for the causes of an axis's peaks."""
    found = [Source(f"motor {number}", column) for number, column in motors_hz(flight).items()]
    letter = "xyz"[AXES.index(axis)]
    peak = flight.quantity(f"sensor_gyro_fft.peak_frequencies_{letter}[0]", "FTN1.PkAvg", stated="")
    if peak is not None:
        found.append(Source("the onboard FFT's peak", peak, harmonics=(1,)))
    return found
