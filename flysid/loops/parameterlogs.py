"""Rate loops of PX4's and ArduPilot's logs: setpoint, output and rate on an even grid; their parameters.

In all modes but acro an angle loop makes the rate's setpoint; its commanded angle is read, too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.flightwriter import float_values
from flysid.ingest.lake.events import IN_FORCE
from flysid.laws.described import parameter_law
from flysid.loops.betaflight import AXES
from flysid.loops.blackbox_loops import LARGEST_SHARE, even_pieces
from flysid.loops.controller import THOUSANDTHS
from flysid.loops.parameter_laws import RELEASE
from flysid.loops.stick_response import StickRecord

STREAMS = {
    "PARM": ("Name", "Value"),
    "parameters": ("name", "value"),
    "PARAM_VALUE": ("param_id", "param_value"),
}
"""Where logs keep parameters: DataFlash, ULog, MAVLink."""


YAW_STICK = "yaw_sp_move_rate"
WHOLE_TURN = 360.0
"""deg, at which ATT's heading begins anew."""


def parameters_of(log: Any, needed: Callable[[str], bool]) -> dict[str, float]:
    """Parameters of a log by name, those that are needed.

    Raises DataError: the log states none, or one of them was changed in flight.
    """
    stream = next((s for s in STREAMS if s in log.facts.streams), None)
    if stream is None:
        raise DataError(
            f"{log.name} states no parameters",
            hint="log them: they are there by default on PX4 and ArduPilot",
        )
    name, value = STREAMS[stream]
    more = ["origin"] if "origin" in log.columns(stream) else []
    table = log.table(stream, [name, value, *more]).to_pydict()
    origins = table.get("origin", [""] * len(table[name]))
    found: dict[str, float] = {}
    for key, number, origin in zip(table[name], table[value], origins, strict=True):
        if origin not in IN_FORCE or not needed(key):
            continue
        if found.setdefault(key, float(number)) != float(number):
            raise DataError(
                f"{log.name}: {key} was changed from {found[key]:g} to {float(number):g} in flight",
                hint="fly without changing gains",
            )
    return found


def px4_parameters(log: Any) -> dict[str, float]:
    """Those of PX4's rate controllers, and the number of the release."""
    others = ("IMU_DGYRO_CUTOFF", "IMU_GYRO_RATEMAX", "MC_YAW_TQ_CUTOFF", "MC_BAT_SCALE_EN")
    wanted = parameters_of(log, lambda name: name in others or ("RATE_" in name and "MC_" in name))
    release = str(log.facts.info.get(RELEASE, ""))
    return wanted | ({RELEASE: float(release)} if release.isdecimal() else {})


def ardupilot_parameters(log: Any) -> dict[str, float]:
    """Those of ArduCopter's rate controllers and their notches, and the rate of its loop."""
    loop = parameter_law("arducopter").name_of("loop_hz")
    return parameters_of(log, lambda name: name == loop or name.startswith(("ATC_RAT_", "FILT")))


def px4_record(log: Any, axis: str) -> StickRecord:
    """One axis of a PX4 flight in deg/s and thousandths of the output.

    Raises DataError: a topic is missing, too slow, or the output at its limit.
    """
    k = list(AXES).index(axis)
    if "vehicle_torque_setpoint" in log.facts.streams:
        output = ("vehicle_torque_setpoint", "xyz")
    else:
        output = ("actuator_controls_0", "control")
    time, rate = column_of(log, "vehicle_angular_velocity", "xyz", k)
    at, setpoint = column_of(log, "vehicle_rates_setpoint", axis)
    when, share = column_of(log, *output, k)
    late = [_lateness(log, stream) for stream in ("vehicle_angular_velocity", output[0])]
    if all(len(own) for own in late):  # an output belongs to the sample that it was computed from
        time, when = time - late[0], when - late[1]
    out = np.interp(time, when, share)
    outside = _asked_of_px4(log, axis)
    rates = min(_rate(t) for t in (time, when)), _rate(at)
    loop = (np.degrees(setpoint), THOUSANDTHS * out, np.degrees(rate))
    faster = "SDLOG_PROFILE bits 0 and 2 (default and high rate)"
    return _record(log, axis, rates, time, at, loop, outside, faster=faster)


def ardupilot_record(log: Any, axis: str) -> StickRecord:
    """One axis of an ArduCopter flight in deg/s and thousandths of the output.

    Raises DataError: RATE is missing or too slow, or the output at its limit.
    """
    letter = axis[0].upper()
    time, rate = column_of(log, "RATE", letter)
    _, setpoint = column_of(log, "RATE", f"{letter}Des")
    _, out = column_of(log, "RATE", f"{letter}Out")
    name = {"R": "DesRoll", "P": "DesPitch", "Y": "DesYaw"}[letter]
    asked_at, angle = column_of(log, "ATT", name)
    outside = asked_at, np.unwrap(angle, period=WHOLE_TURN) if axis == "yaw" else angle
    loop = (setpoint, THOUSANDTHS * out, rate)
    asked = outside if np.ptp(outside[1]) else None
    faster = "LOG_BITMASK bit 0 (fast attitude), LOG_FILE_RATEMAX 0"
    return _record(log, axis, (_rate(time), _rate(time)), time, time, loop, asked, faster=faster)


def _lateness(log: Any, stream: str) -> FloatArray:
    """(N,) s by which a topic's rows were published after the gyro's sample was taken; (0,) where unknown."""
    stamps = ("timestamp", "timestamp_sample")
    if not set(stamps) <= set(log.columns(stream)):
        return np.zeros(0)
    table = log.table(stream, list(stamps))
    published, taken = (float_values(table[name]) for name in stamps)
    return np.asarray(1e-6 * (published - taken) if taken.all() else np.zeros(0))


def _asked_of_px4(log: Any, axis: str) -> tuple[FloatArray, FloatArray] | None:
    """Times and the angle (rad) commanded to PX4's attitude loop; None in a flight by rates alone.

    Of yaw the rate (rad/s) that the stick asks for, where it does: meanwhile the heading's setpoint follows
    the measured heading, and gusts come back through it.
    """
    stream = "vehicle_attitude_setpoint"
    if stream not in log.facts.streams:
        raise DataError(
            f"{log.name} lacks {stream}: whether an angle loop moves the rate's setpoint is not known",
            hint=f"log {stream}",
        )
    from scipy.spatial.transform import Rotation

    if axis == "yaw" and YAW_STICK in log.columns(stream):
        time, turn = column_of(log, stream, YAW_STICK)
        known = np.isfinite(turn)
        if known.any() and np.ptp(turn[known]):
            return time[known], turn[known]
    table = log.table(stream, ["time_ns", "q_d"])
    time = float_values(table["time_ns"]) * 1e-9
    turns = np.asarray(table["q_d"].to_pylist(), dtype=np.float64)
    known = np.isfinite(turns).all(axis=1) & (np.abs(turns).sum(axis=1) > 0.0)
    if not known.any():
        return None
    angles = Rotation.from_quat(turns[known][:, [1, 2, 3, 0]]).as_euler("ZYX")[:, ::-1]
    values = np.unwrap(angles[:, list(AXES).index(axis)])
    return (time[known], values) if np.ptp(values) else None


def _rate(time: FloatArray) -> float:
    return float(np.round(1.0 / np.median(np.diff(time)))) if len(time) > 2 else 0.0  # flights alike


def column_of(log: Any, stream: str, name: str, place: int | None = None) -> tuple[FloatArray, FloatArray]:
    """(N,) times in s and values, of an array its `place`-th."""
    try:
        table = log.table(stream, ["time_ns", name])
    except (KeyError, UsageError) as error:
        raise DataError(
            f"{log.name} lacks {stream}.{name}", hint="log setpoint, output and rate of the rate loop, fast"
        ) from error
    if place is None:
        values = float_values(table[name])
    else:
        values = np.asarray([v[place] for v in table[name].to_pylist()], dtype=np.float64)
    return float_values(table["time_ns"]) * 1e-9, values


def _record(
    log: Any,
    axis: str,
    rates: tuple[float, float],
    time: FloatArray,
    at: FloatArray,
    loop: tuple[FloatArray, FloatArray, FloatArray],
    outside: tuple[FloatArray, FloatArray] | None,
    *,
    faster: str,
    least_hz: float = 40.0,
) -> StickRecord:
    """The loop at the rate of its output and gyro; the setpoint may come more rarely.

    At the setpoint's own rate every row would lie where the setpoint has just moved, and what the output does
    until the next one would be lost: 2 % of the plant's gain on PX4.

    `rates`: Hz, of output and gyro, and of the setpoint.
    """
    rate_hz, slowest_hz = rates[0], min(rates)
    if slowest_hz < least_hz:
        raise DataError(
            f"{log.name} has the {axis} loop at {slowest_hz:.0f} Hz: too slow to see where its gain is one",
            hint=f"log it at 100 Hz or more: {faster}",
        )
    limited = float((np.abs(loop[1]) >= THOUSANDTHS - 1.0).mean())
    if limited > LARGEST_SHARE:
        raise DataError(
            f"{log.name}: the {axis} controller was at its limit for {100.0 * limited:.0f} % of the flight",
            hint="fly more gently: in saturation the gains have no effect",
        )
    return StickRecord(log.name, rate_hz, even_pieces(rate_hz, time, at, *loop, outside))
