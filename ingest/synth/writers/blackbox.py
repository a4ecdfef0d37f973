"""A recording -> Betaflight blackbox (.bbl): the log that Betaflight 4.4 would write in angle mode.

A header, then frames: main ones at the rate of the instruments (setpoints, gyros, height; the controllers'
outputs and the motors where the vehicle has rotors), G ten times a second, S and events at the start, behind
pauses and at the end. Axes are Betaflight's: roll right, pitch nose down, yaw left. Setpoints are what angle
mode makes of tilt commands: its strength times the angle that is missing. A drop-out is a pause of the
logger: it goes on at the next I frame.

Source: Betaflight 4.4, `blackbox.c` (fields, predictors, encodings), `mixer_init.c` (quadrotor X).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime, timedelta

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.formats.blackbox.codes import Encoding, Predictor
from flysid.ingest.formats.blackbox.writing import Fields, Writer, unsigned_vb
from flysid.ingest.formats.common.clock import SECOND_NS
from flysid.ingest.synth.telemetry import MS_NS, IntArray, Recording, heard, throttle

LOOP_US = 1000
FRAMES_A_GROUP = 8
FINE = 10  # high resolution: tenths of deg/s and of sticks
LEVEL_STRENGTH = 5.0  # deg/s for each degree that is missing
ANGLE_LIMIT_DEG = 60.0
MOTORS = (48, 2047)
HOME = (473977420, 85455940)  # degrees * 1e7
METRES_A_DEGREE = 111_319.49
GPS_NS = 100 * MS_NS
MODES = 0b11  # armed, angle
DISARMED_BY_SWITCH = 4
AXES = range(3)

# name, signed, predictor and encoding of I, the same of P
Column = tuple[str, int, int, int, int, int]
CLOCK: list[Column] = [("loopIteration", 0, 0, 1, 6, 9), ("time", 0, 0, 1, 2, Encoding.SIGNED_VB)]
CONTROLLERS: list[Column] = [
    *((f"axisP[{k}]", 1, 0, Encoding.SIGNED_VB, Predictor.PREVIOUS, Encoding.SIGNED_VB) for k in AXES),
    *((f"axisI[{k}]", 1, 0, Encoding.SIGNED_VB, Predictor.PREVIOUS, Encoding.TAG2_3S32) for k in AXES),
]
SENSED: list[Column] = [
    *((f"rcCommand[{k}]", 1, 0, Encoding.SIGNED_VB, Predictor.PREVIOUS, Encoding.TAG8_4S16) for k in AXES),
    ("rcCommand[3]", 0, 4, 1, Predictor.PREVIOUS, Encoding.TAG8_4S16),
    *((f"setpoint[{k}]", 1, 0, Encoding.SIGNED_VB, Predictor.PREVIOUS, Encoding.TAG8_4S16) for k in range(4)),
    ("baroAlt", 1, 0, Encoding.SIGNED_VB, Predictor.PREVIOUS, Encoding.TAG8_8SVB),
    *((f"gyroADC[{k}]", 1, 0, Encoding.SIGNED_VB, Predictor.AVERAGE, Encoding.SIGNED_VB) for k in AXES),
]
ROTORS: list[Column] = [
    ("motor[0]", 0, 11, 1, Predictor.AVERAGE, Encoding.SIGNED_VB),
    *((f"motor[{k}]", 0, 5, Encoding.SIGNED_VB, Predictor.AVERAGE, Encoding.SIGNED_VB) for k in (1, 2, 3)),
]
SLOW = Fields(
    ["flightModeFlags", "stateFlags", "failsafePhase", "rxSignalReceived", "rxFlightChannelsValid"],
    [0] * 5, [0] * 5, [1, 1, Encoding.TAG2_3S32, Encoding.TAG2_3S32, Encoding.TAG2_3S32],
)  # fmt: skip
POSITION = Fields(["GPS_home[0]", "GPS_home[1]"], [1, 1], [0, 0], [Encoding.SIGNED_VB, Encoding.SIGNED_VB])
GPS = Fields(
    ["time", "GPS_numSat", "GPS_coord[0]", "GPS_coord[1]", "GPS_altitude", "GPS_speed", "GPS_ground_course"],
    [0, 0, 1, 1, 0, 0, 0], [10, 0, 7, 7, 0, 0, 0], [1, 1, Encoding.SIGNED_VB, Encoding.SIGNED_VB, 1, 1, 1],
)  # fmt: skip


def blackbox_bytes(recording: Recording) -> bytes:
    """The whole log."""
    return b"".join(_pieces(recording))


def _pieces(recording: Recording) -> Iterator[bytes]:
    steps = np.diff(recording.state.time_ns)
    every = max(1, round(float(np.median(steps)) / (1000 * LOOP_US))) if len(steps) else 1
    loops = _loops(recording, every)
    first_ns = int(recording.state.time_ns[0])
    time_ns = first_ns + 1000 * LOOP_US * loops
    values = main_values(recording, time_ns)
    fixes = _fixes(recording, time_ns)
    has_rotors = "throttle" in recording.state.values
    columns = [*CLOCK, *CONTROLLERS, *SENSED, *ROTORS] if has_rotors else [*CLOCK, *SENSED]
    writer = Writer(_kinds(columns), _settings(recording, every))
    yield from writer.header()
    yield b"E\x00" + unsigned_vb(first_ns // 1000)
    yield writer.frame("S", [MODES, 0, 0, 1, 1])
    is_first = loops % (every * FRAMES_A_GROUP) == 0
    fix_due_ns = 0
    for k, loop in enumerate(loops.tolist()):
        time_us = int(time_ns[k]) // 1000
        if k and loop != loops[k - 1] + every:
            yield b"E\x0e" + unsigned_vb(loop) + unsigned_vb(time_us)
        row = [int(values[name][k]) for name, *_ in columns[len(CLOCK) :]]
        yield writer.frame("I" if is_first[k] else "P", [loop, time_us, *row])
        if k == 0:
            yield writer.frame("H", HOME)
        if time_ns[k] >= fix_due_ns:
            yield writer.frame("G", [time_us, 12, *(int(n) for n in fixes[k])])
            fix_due_ns = int(time_ns[k]) + GPS_NS
    yield b"E\x0f" + unsigned_vb(DISARMED_BY_SWITCH)
    yield b"E\xffEnd of log\x00"


def _kinds(columns: list[Column]) -> Mapping[str, Fields]:
    names, signed, *codes = (list(each) for each in zip(*columns, strict=True))
    inside = Fields(names, signed, codes[0], codes[1])
    return {"I": inside, "P": Fields(names, signed, codes[2], codes[3]), "H": POSITION, "G": GPS, "S": SLOW}


def _settings(recording: Recording, every: int) -> dict[str, str]:
    began = datetime.fromtimestamp(0, UTC) + timedelta(
        microseconds=(recording.boot_utc_ns + int(recording.state.time_ns[0])) // 1000
    )
    return {
        "Firmware type": "Cleanflight",
        "Firmware revision": "Betaflight 4.4.3 (flysid) FLYSID_SYNTH",
        "Log start datetime": began.isoformat(timespec="milliseconds"),
        "Craft name": f"flysid {recording.system}",
        "I interval": str(every * FRAMES_A_GROUP),
        "P interval": f"1/{every}",
        "minthrottle": "1070",
        "maxthrottle": "2000",
        "gyro_scale": "0x3f800000",
        "motorOutput": ",".join(map(str, MOTORS)),
        "acc_1G": "2048",
        "looptime": str(LOOP_US),
        "pid_process_denom": "1",
        "angle_limit": f"{ANGLE_LIMIT_DEG:g}",
        "levelPID": f"{10 * LEVEL_STRENGTH:g},50,75",
        "blackbox_high_resolution": "1",
    }


def _loops(recording: Recording, every: int) -> IntArray:
    """(N,) loops that are logged: what is due; behind a pause the first is one that an I frame is due at."""
    span_ns = int(recording.state.time_ns[-1] - recording.state.time_ns[0])
    due = every * np.arange(span_ns // (every * 1000 * LOOP_US) + 1, dtype=np.int64)
    reached = heard(recording, recording.state.time_ns[0] + 1000 * LOOP_US * due)
    group = np.arange(len(due)) // FRAMES_A_GROUP
    broken = np.flatnonzero(reached[1:] & ~reached[:-1]) + 1
    for at in broken.tolist():
        if at % FRAMES_A_GROUP:
            reached[at:] &= group[at:] != group[at]
    return due[reached]


def main_values(recording: Recording, time_ns: IntArray) -> Mapping[str, IntArray]:
    """(N,) what main frames hold at these times, field by field: the newest samples, as the loop has them."""
    state = recording.state
    row = np.searchsorted(state.time_ns, time_ns, side="right") - 1
    sent = np.maximum(np.searchsorted(recording.command.time_ns, time_ns, side="right") - 1, 0)
    rates = _rates(recording)
    tilt = {"phi": recording.command["phi_in"][sent], "theta": recording.command["theta_in"][sent]}
    lift = throttle(recording, time_ns)
    sticks = [500 / ANGLE_LIMIT_DEG * tilt[name] for name in ("phi", "theta")]
    asked = [LEVEL_STRENGTH * (tilt[name] - state[name][row]) for name in ("phi", "theta")]
    still = np.zeros(len(time_ns))
    found = {f"rcCommand[{k}]": FINE * each for k, each in enumerate((*sticks, still, 1000 + 1000 * lift))}
    found |= {f"setpoint[{k}]": FINE * each for k, each in enumerate((*asked, still))}
    found |= {"setpoint[3]": 1000 * lift, "baroAlt": 100 * (recording.start_height_m + state["z"][row])}
    found |= {f"gyroADC[{k}]": FINE * each[row] for k, each in enumerate(rates)}
    if "throttle" in state.values:
        found |= _efforts(recording, row)
    return {name: np.round(values).astype(np.int64) for name, values in found.items()}


def _rates(recording: Recording) -> list[FloatArray]:
    """Roll right, pitch nose down, yaw left, deg/s; of the angles where the vehicle has no gyros."""
    state = recording.state
    if "p" in state.values:
        return [state["p"], state["q"], state["r"]]
    if len(state) < 2:
        return [np.zeros(len(state))] * 3
    time_s = (state.time_ns - state.time_ns[0]) / SECOND_NS
    signs = {"phi": 1.0, "theta": 1.0, "psi": -1.0}
    return [sign * np.gradient(state[name], time_s) for name, sign in signs.items()]


def _efforts(recording: Recording, row: IntArray) -> dict[str, FloatArray]:
    """What the controllers ask of the mixer, and the motors: half of what they can is hover."""
    state = recording.state
    signs = {"roll": 0.5, "pitch": -0.5, "yaw": -0.5}
    roll, pitch, yaw = (sign * state[f"{axis}_effort"][row] for axis, sign in signs.items())
    lift = 0.5 * state["throttle"][row]
    mixed = (
        lift - roll + pitch - yaw,  # rear right
        lift - roll - pitch + yaw,
        lift + roll + pitch + yaw,
        lift + roll - pitch - yaw,
    )
    idle, full = MOTORS
    found = {f"axisP[{k}]": 1000 * each for k, each in enumerate((roll, pitch, yaw))}
    found |= {f"axisI[{k}]": np.zeros(len(row)) for k in AXES}
    return found | {f"motor[{k}]": idle + (full - idle) * np.clip(m, 0, 1) for k, m in enumerate(mixed)}


def _fixes(recording: Recording, time_ns: IntArray) -> IntArray:
    """(N, 5) latitude, longitude (degrees * 1e7), height (dm), speed (cm/s) and course (0.1 deg)."""
    state = recording.state
    row = np.searchsorted(state.time_ns, time_ns, side="right") - 1
    heading = np.radians(state["psi"][row])
    c = np.cos(heading)
    s = np.sin(heading)
    north = c * state["vx"][row] - s * state["vy"][row]
    east = c * state["vy"][row] + s * state["vx"][row]
    shrink = np.cos(np.radians(HOME[0] * 1e-7))
    return np.column_stack(
        [
            HOME[0] + np.round(state["x"][row] / METRES_A_DEGREE * 1e7),
            HOME[1] + np.round(state["y"][row] / (METRES_A_DEGREE * shrink) * 1e7),
            np.maximum(np.round(10 * (recording.start_height_m + state["z"][row])), 0),
            np.round(100 * np.hypot(north, east)),
            np.round(10 * np.degrees(np.arctan2(east, north))) % 3600,
        ]
    ).astype(np.int64)
