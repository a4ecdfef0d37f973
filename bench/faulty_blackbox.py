"""The blackbox log that Betaflight or INAV would have written of a simulated flight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from bench.faulty_logging import TUNING, Logging
from bench.faulty_logs import BEGIN_US, follow, geodetic, in_the_air, rate_gains
from bench.faulty_quadrotor import FILTER_HZ, GRAVITY, RATE_HZ, Flight
from flysid.dataset import FloatArray
from flysid.ingest.formats.blackbox.codes import Encoding
from flysid.ingest.formats.blackbox.writing import Fields, Writer, unsigned_vb

ITERATIONS = 8
"""Between two rows."""
LOOP_US = 1e6 / RATE_HZ / ITERATIONS
ONE_G = 2048
OUTPUT = (158, 2047)
PULSES = (1000, 2000)
POLES = 14
MOTORS = (3, 0, 1, 2)
"""The simulator's motors in Betaflight's order: rear right, front right, rear left, front left."""
BODY = np.array([1.0, -1.0, -1.0])
"""Roll right, pitch nose down, yaw left."""
GPS_EVERY, SLOW_EVERY = 80, 40
"""Rows."""
SIGNED = Encoding.SIGNED_VB
SLOW = Fields(
    ["flightModeFlags", "stateFlags", "failsafePhase", "rxSignalReceived", "rxFlightChannelsValid"],
    [0] * 5,
    [0] * 5,
    [1, 1, Encoding.TAG2_3S32, Encoding.TAG2_3S32, Encoding.TAG2_3S32],
)
RELAXED, LOST, LANDING = 0, 1, 2
CRASH_M_S2, DISARMS_S = 80.0, 1.2
"""A pilot disarms so soon after a blow of this size."""
IDLE, HOLDING = 1.0, 7.0
"""INAV's navState: a pilot flies, or it holds its position."""
LOSS_S = 1.0
"""From the loss of the radio to the failsafe's landing."""
DISARM = {"betaflight": (4, 1), "inav": (4, 6)}
"""Reasons: by switch, by the failsafe."""


def blackbox_bytes(flight: Flight, firmware: str, *, rpm: bool = True, logging: Logging = TUNING) -> bytes:
    """The whole log.

    Parameters
    ----------
    firmware : "betaflight" or "inav".
    rpm : the ESCs tell how fast they turn; INAV does not log it.
    logging : which fields are logged.
    """
    return b"".join(_pieces(flight, firmware, rpm, logging))


def _pieces(flight: Flight, firmware: str, rpm: bool, logging: Logging) -> Iterator[bytes]:
    every = _betaflight(flight, rpm) if firmware == "betaflight" else _inav(flight)
    columns = {name: values for name, values in every.items() if logging.holds(name)}
    names = ["loopIteration", "time", *columns]
    signed = [0, 0] + [1] * len(columns)
    codes = [1, 1] + [int(SIGNED)] * len(columns)
    main = Fields(names, signed, [0] * len(names), codes)
    fixes = _fixes(flight)
    gps = Fields(list(fixes), [1] * len(fixes), [0] * len(fixes), [int(SIGNED)] * len(fixes))
    kinds = (
        {"I": main, "P": main, "G": gps, "S": SLOW}
        if firmware == "inav" and logging.holds("GPS")
        else {"I": main, "P": main, "S": SLOW}
    )
    writer = Writer(kinds, _settings(flight, firmware))
    yield from writer.header()
    first, last = flight.armed_s
    hit = np.flatnonzero(np.linalg.norm(flight["force"], axis=1) > CRASH_M_S2)
    if (flight.vehicle.fails_s or flight.vehicle.hits_s) and len(hit):
        last = min(last, float(flight.time_s[hit[0]]) + DISARMS_S)
    rows = np.flatnonzero((flight.time_s >= first) & (flight.time_s < last))
    table = np.round(np.stack([values[rows] for values in columns.values()], axis=1)).astype(int).tolist()
    where = np.round(np.stack([values[rows] for values in fixes.values()], axis=1)).astype(int).tolist()
    phases = _phases(flight)[rows].tolist()
    yield b"E\x00" + unsigned_vb(BEGIN_US)
    for k, row in enumerate(table):
        time_us = BEGIN_US + round(k * ITERATIONS * LOOP_US)
        if k % SLOW_EVERY == 0 or phases[k] != phases[k - 1]:
            yield writer.frame(
                "S", [1 | (phases[k] > LOST) << 10, 0, phases[k], int(phases[k] == 0), int(phases[k] == 0)]
            )
        yield writer.frame("I", [k * ITERATIONS, time_us, *row])
        if "G" in kinds and k % GPS_EVERY == 0:
            yield writer.frame("G", [time_us, *where[k][1:]])
    if flight.vehicle.browns_s:
        return
    yield b"E\x0f" + unsigned_vb(DISARM[firmware][int(phases[-1] == LANDING)])
    yield b"E\xffEnd of log\x00"


def _phases(flight: Flight) -> FloatArray:
    """(N,) phases of the failsafe: the radio is lost, then it lands."""
    since_s = flight.time_s - flight.vehicle.incident_s
    lost = (flight.vehicle.incident == "radio") & (since_s >= 0.0)
    return np.where(lost, np.where(since_s < LOSS_S, LOST, LANDING), RELAXED).astype(int)


def _axes(name: str, values: FloatArray) -> dict[str, FloatArray]:
    return {f"{name}[{i}]": values[:, i] for i in range(values.shape[1])}


def _common(flight: Flight, output: tuple[int, int]) -> dict[str, FloatArray]:
    low, high = output
    flying = in_the_air(flight)[:, None]
    stirred = flight["torques"] * BODY
    motors = low + (high - low) * np.where(flying, flight["throttles"], 0.05)[:, list(MOTORS)]
    return {
        **_axes("axisP", 500.0 * stirred),
        **_axes("axisI", 100.0 * stirred),
        **_axes("axisD", 0.0 * stirred),
        **_axes("rcCommand", np.degrees(flight["wanted_rates"]) * BODY),
        "rcCommand[3]": 1000.0 + 1000.0 * flight["wanted_thrust"],
        **_axes("gyroADC", np.degrees(follow(flight["gyro"], FILTER_HZ)) * BODY),
        **_axes("accSmooth", flight["accel"] / GRAVITY * ONE_G * -1.0),
        **_axes("motor", motors),
    }


def _battery(flight: Flight) -> FloatArray:
    """Volts; where the board's supply goes, its battery went before."""
    falls: FloatArray = flight["voltage"] * (flight["board"] / flight["board"][0]) ** 2
    return falls


def _betaflight(flight: Flight, rpm: bool) -> dict[str, FloatArray]:
    found = _common(flight, OUTPUT) | {
        **_axes("setpoint", np.degrees(flight["wanted_rates"]) * BODY),
        "setpoint[3]": 1000.0 * flight["wanted_thrust"],
        **_axes("gyroUnfilt", np.degrees(flight["gyro"]) * BODY),
        "vbatLatest": 100.0 * _battery(flight),
        "amperageLatest": 100.0 * flight["current"],
    }
    return found | _axes("eRPM", flight["rpm"][:, list(MOTORS)] * POLES / 200.0) if rpm else found


def _inav(flight: Flight) -> dict[str, FloatArray]:
    centi = 100.0 * np.array([1.0, 1.0, -1.0])
    return _common(flight, PULSES) | {
        **_axes("axisRate", np.degrees(flight["wanted_rates"]) * BODY),
        **_axes("gyroRaw", np.degrees(flight["gyro"]) * BODY),
        **_axes("attitude", 10.0 * np.degrees(flight["attitude"]) * np.array([1.0, -1.0, 1.0])),
        **_axes("navPos", flight["position"] * centi),
        **_axes("navVel", flight["velocity"] * centi),
        **_axes("navTgtPos", flight["wanted_position"] * centi),
        "navState": np.full(len(flight.time_s), IDLE if flight.vehicle.lively_rad else HOLDING),
        "vbat": 100.0 * _battery(flight),
        "amperage": 100.0 * flight["current"],
    }


def _fixes(flight: Flight) -> Mapping[str, FloatArray]:
    latitude, longitude, height = geodetic(flight)
    speed = np.hypot(flight["velocity"][:, 0], flight["velocity"][:, 1])
    return {
        "time": flight.time_s,
        "GPS_fixType": np.full(len(flight.time_s), 2.0),
        "GPS_numSat": flight["satellites"],
        "GPS_coord[0]": 1e7 * latitude,
        "GPS_coord[1]": 1e7 * longitude,
        "GPS_altitude": height,
        "GPS_speed": 100.0 * speed,
        "GPS_ground_course": 0.0 * speed,
        "GPS_hdop": 100.0 * flight["hdop"],
    }


def _settings(flight: Flight, firmware: str) -> dict[str, str]:
    gains = rate_gains(flight)
    scale = {"RLL": "rollPID", "PIT": "pitchPID", "YAW": "yawPID"}
    pids = {
        scale[axis]: ",".join(str(round(k)) for k in (100.0 * p, 60.0 * i, 800.0 * d))
        for axis, (p, i, d) in gains.items()
    }
    revision = {
        "betaflight": ("Cleanflight", "Betaflight 4.5.1 (77d01ba3b) STM32F7X2"),
        "inav": ("INAV", "INAV 7.1.2 (4e1e59eb) MATEKF722"),
    }
    kind, words = revision[firmware]
    return {
        "Firmware type": kind,
        "Firmware revision": words,
        "Craft name": f"simulated {flight.vehicle.seed}",
        "I interval": str(ITERATIONS),
        "P interval": f"1/{ITERATIONS}",
        "minthrottle": "1000",
        "maxthrottle": "2000",
        "gyro_scale": "0x3f800000",
        "acc_1G": str(ONE_G),
        "looptime": f"{LOOP_US:.0f}",
        "pid_process_denom": "1",
        "motor_pwm_protocol": "6",
        "motor_poles": str(POLES),
        **({"motorOutput": "158,2047"} if firmware == "betaflight" else {"motorOutput": "1000,2000"}),
        "gyro_lpf1_type": "0",
        "gyro_lpf1_static_hz": f"{FILTER_HZ:.0f}",
        "gyro_lpf2_static_hz": "0",
        "features": "0",
        **pids,
    }
