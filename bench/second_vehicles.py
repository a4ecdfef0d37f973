"""Drawn vehicles under the loops of `bench.second_laws`, a drawn pilot, and the logs of their firmwares.

ArduCopter's is a DataFlash log with ATT, RATE and PID messages at 400 Hz, PX4's a ULog at 1,000 Hz, with the
delays between a sample and its messages.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.second_laws import AXES, TURN, Floats, Flown, Loop, fly
from flysid.ingest.synth.telemetry import as_bytes, in_sending_order
from flysid.ingest.synth.writers import dataflash
from flysid.ingest.synth.writers.dataflash import MessageKind, definitions, message_bytes
from flysid.ingest.synth.writers.ulog import Fields, preamble, record, row_type

BEGIN_US = 20_000_000
RATES = {"arducopter": (400.0, 2000.0), "px4": (1000.0, 4000.0)}
"""Firmware -> rates of its controller and of its gyro, Hz."""
LARGEST_MS = 2.5
"""Vehicles that oscillate fly no minute of sticks."""


def draw_loops(firmware: str, rng: np.random.Generator) -> list[Loop]:
    """Roll, pitch and yaw of one vehicle."""
    tilt = _draw(firmware, "roll", rng)
    pitch = replace(tilt, gain=tilt.gain * rng.uniform(0.7, 1.2), p=tilt.p * rng.uniform(0.8, 1.2))
    pitch = pitch if pitch.truth()["ms"] < LARGEST_MS else tilt
    return [tilt, pitch, _draw(firmware, "yaw", rng)]


def _draw(firmware: str, axis: str, rng: np.random.Generator) -> Loop:
    """One axis whose loop is neither slack nor at its edge."""
    while True:
        loop = _propose(firmware, axis == "yaw", rng)
        true = loop.truth()
        if true["ms"] < LARGEST_MS and true["phase_deg"] > 25.0 and true["crossover_hz"] > 0.8:
            return replace(loop, angle_p=float(min(loop.angle_p, true["crossover_hz"])))


def _propose(firmware: str, yaw: bool, rng: np.random.Generator) -> Loop:
    arducopter = firmware == "arducopter"
    rate_hz, gyro_hz = RATES[firmware]
    gain = rng.uniform(30.0, 90.0) if yaw else rng.uniform(60.0, 250.0)
    p = TURN * (rng.uniform(1.0, 3.5) if yaw else rng.uniform(2.0, 6.0)) / gain
    return Loop(
        firmware,
        rate_hz,
        gyro_hz,
        gain=gain,
        lag_s=rng.uniform(0.02, 0.06),
        lead_s=rng.uniform(0.0, 0.03) if yaw else 0.0,
        damping=rng.uniform(0.1, 1.0),
        late=int(rng.integers(2, 10)),
        gyro_cut_hz=rng.uniform(20.0, 80.0),
        p=p,
        i=p * (rng.uniform(0.1, 0.5) if yaw else rng.uniform(0.5, 2.0)),
        d=0.0 if yaw else p * rng.uniform(0.015, 0.04),
        ff=0.0,
        target_hz=20.0 if arducopter else 0.0,
        error_hz=float(rng.choice([2.5, 5.0, 10.0])) if yaw and arducopter else 0.0,
        slope_hz=float(rng.choice([10.0, 20.0, 40.0]))
        if arducopter
        else float(rng.choice([20.0, 30.0, 60.0])),
        output_hz=float(rng.choice([0.0, 2.0, 5.0])) if yaw and not arducopter else 0.0,
        angle_p=rng.uniform(3.0, 7.0),
        steers=yaw,
        follows=bool(rng.integers(2)),
    )


def fly_vehicle(loops: Sequence[Loop], seconds: float, rng: np.random.Generator) -> list[Flown]:
    """Its three axes: flicked sticks, gusts, and noise of the gyro."""
    found = []
    for loop in loops:
        n = round(seconds * loop.rate_hz)
        stick = _stick(n, loop.rate_hz, rng) * (
            rng.uniform(0.6, 1.4) if loop.steers else rng.uniform(0.15, 0.35)
        )
        scale = 0.3 * rng.uniform(0.3, 1.0) / loop.gain
        gusts = _gusts(n * loop.steps, loop.gyro_hz, rng) * scale * TURN
        noise = np.radians(rng.uniform(0.3, 1.5)) * rng.standard_normal(n * loop.steps)
        found.append(fly(loop, stick, gusts, noise))
    return found


def _stick(n: int, rate_hz: float, rng: np.random.Generator) -> Floats:
    """(N,) held for 0.1 to 1 s at a time, in its middle now and then, moved by a hand."""
    held: list[Floats] = []
    while sum(map(len, held)) < n:
        level = rng.standard_normal() * (rng.random() < 0.8)
        held.append(np.full(round(rate_hz * rng.uniform(0.1, 1.0)), level))
    hand = np.ones(round(rate_hz * rng.uniform(0.03, 0.1)))
    return np.asarray(np.convolve(np.concatenate(held), hand / len(hand), "same")[:n])


def _gusts(n: int, rate_hz: float, rng: np.random.Generator) -> Floats:
    """(N,) of one in size, first order, with a corner of 0.5 to 4 Hz."""
    from scipy.signal import lfilter

    keep = np.exp(-TURN * rng.uniform(0.5, 4.0) / rate_hz)
    return np.asarray(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(n)))


def log_bytes(loops: Sequence[Loop], flown: Sequence[Flown], rng: np.random.Generator) -> bytes:
    """The log, as its firmware writes it."""
    if loops[0].firmware == "px4":
        return _ulog(loops, flown, rng)
    return _dataflash(loops, flown)


RATE = MessageKind(
    141, "RATE", "Qfffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut", "skk-kk-kk-", "F000000000"
)
PARM = MessageKind(152, "PARM", "QNf", "TimeUS,Name,Value", "s--", "F--")
PID = tuple(
    MessageKind(
        160 + k,
        f"PID{axis[0].upper()}",
        "Qffffffff",
        "TimeUS,Tar,Act,Err,P,I,D,FF,Dmod",
        "sEEE-----",
        "F--------",
    )
    for k, axis in enumerate(AXES)
)


def parameters(loops: Sequence[Loop]) -> dict[str, float]:
    """What the log states."""
    return _px4_parameters(loops) if loops[0].firmware == "px4" else _ardupilot_parameters(loops)


def _dataflash(loops: Sequence[Loop], flown: Sequence[Flown]) -> bytes:
    time_us = BEGIN_US + np.round(1e6 * np.arange(len(flown[0].rate)) / loops[0].rate_hz).astype(np.int64)
    rate: dict[str, Floats] = {}
    attitude: dict[str, Floats] = {}
    tables = []
    for axis, loop, own in zip(AXES, loops, flown, strict=True):
        letter = axis[0].upper()
        rate |= {
            f"{letter}Des": np.degrees(own.target),
            letter: np.degrees(own.rate),
            f"{letter}Out": own.output,
        }
        turn = 360.0 if axis == "yaw" else np.inf
        attitude |= {
            f"Des{axis.title()}": 100.0 * np.mod(np.degrees(own.angle_target), turn)
            if axis == "yaw"
            else 100.0 * np.degrees(own.angle_target),
            axis.title(): 100.0 * np.mod(np.degrees(own.angle), turn)
            if axis == "yaw"
            else 100.0 * np.degrees(own.angle),
        }
        target, error, p, i, d = own.terms
        terms = {"Tar": target, "Act": own.rate, "Err": error, "P": p, "I": i, "D": d, "FF": loop.ff * target}
        tables.append(_rows(PID[AXES.index(axis)], time_us, terms | {"Dmod": np.ones(len(p))}))
    tables = [_rows(dataflash.ATT, time_us, attitude), _rows(RATE, time_us, rate), *tables]
    stated = [message_bytes(PARM, BEGIN_US, n.encode(), v) for n, v in parameters(loops).items()]
    text = message_bytes(dataflash.MSG, BEGIN_US, b"ArduCopter V4.5.7 (second law)")
    mode = message_bytes(dataflash.MODE, BEGIN_US, 0, 0, 1)
    _, kind, row = in_sending_order(*(1000 * t["TimeUS"].astype(np.int64) for t in tables))
    raw = [as_bytes(t) for t in tables]
    body = (raw[k][r] for k, r in zip(kind.tolist(), row.tolist(), strict=True))
    kinds = (*dataflash.KINDS, RATE, PARM, *PID)
    return b"".join([definitions(kinds, BEGIN_US), text, *stated, mode, *body])


def _rows(kind: MessageKind, time_us: Any, values: Mapping[str, Floats]) -> Any:
    rows = kind.rows(len(time_us))
    rows["TimeUS"] = time_us
    for name, own in values.items():
        rows[name] = own
    return rows


def _ardupilot_parameters(loops: Sequence[Loop]) -> dict[str, float]:
    found: dict[str, float] = {"SCHED_LOOP_RATE": loops[0].rate_hz, "INS_GYRO_FILTER": loops[0].gyro_cut_hz}
    for name, loop in zip(("RLL", "PIT", "YAW"), loops, strict=True):
        own = {"P": loop.p, "I": loop.i, "D": loop.d, "FF": loop.ff}
        own |= {"FLTT": loop.target_hz, "FLTE": loop.error_hz, "FLTD": loop.slope_hz}
        found |= {f"ATC_RAT_{name}_{k}": v for k, v in own.items()} | {f"ATC_ANG_{name}_P": loop.angle_p}
    return found


STAMP: Fields = [("timestamp", "<u8")]
SAMPLED: Fields = [*STAMP, ("timestamp_sample", "<u8")]
TOPICS: dict[str, Fields] = {
    "vehicle_angular_velocity": [*SAMPLED, ("xyz", "3<f4")],
    "vehicle_torque_setpoint": [*SAMPLED, ("xyz", "3<f4")],
    "vehicle_rates_setpoint": [*STAMP, ("roll", "<f4"), ("pitch", "<f4"), ("yaw", "<f4")],
    "vehicle_attitude_setpoint": [*STAMP, ("yaw_sp_move_rate", "<f4"), ("q_d", "4<f4")],
    "rate_ctrl_status": [*STAMP, *((f"{axis}speed_integ", "<f4") for axis in AXES)],
}


def _ulog(loops: Sequence[Loop], flown: Sequence[Flown], rng: np.random.Generator) -> bytes:
    n = len(flown[0].rate)
    sampled = BEGIN_US + np.round(1e6 * np.arange(n) / loops[0].rate_hz).astype(np.int64)
    late = {name: sampled + rng.integers(low, low + 60, n) for name, low in (("gyro", 120), ("torque", 220))}
    asked = slice(None, None, 4)
    tables = {
        name: np.zeros(n if k < 2 else len(sampled[asked]), row_type(f))
        for k, (name, f) in enumerate(TOPICS.items())
    }
    gyro, torque, rates, attitude, integrals = tables.values()
    gyro["timestamp"], torque["timestamp"] = late.values()
    gyro["timestamp_sample"] = torque["timestamp_sample"] = sampled
    gyro["xyz"] = np.stack([own.rate for own in flown], axis=1)
    torque["xyz"] = np.stack([own.output for own in flown], axis=1)
    rates["timestamp"] = attitude["timestamp"] = late["gyro"][asked] + 50
    integrals["timestamp"] = late["torque"][asked]
    for axis, own in zip(AXES, flown, strict=True):
        rates[axis] = own.target[asked]
        integrals[f"{axis}speed_integ"] = own.terms[3][asked]
    attitude["yaw_sp_move_rate"] = flown[2].turn[asked]
    attitude["q_d"] = _quaternions(np.stack([own.angle_target[asked] for own in flown], axis=1))
    facts = {"sys_name": "PX4", "ver_hw": "SECOND_LAW"}
    head = preamble(TOPICS, facts, BEGIN_US, parameters=parameters(loops))
    _, topic, row = in_sending_order(*(1000 * t["timestamp"].astype(np.int64) for t in tables.values()))
    raw = [as_bytes(t) for t in tables.values()]
    body = (record("D", bytes([k, 0]) + raw[k][r]) for k, r in zip(topic.tolist(), row.tolist(), strict=True))
    return b"".join([head, *body])


def _px4_parameters(loops: Sequence[Loop]) -> dict[str, float]:
    found: dict[str, float] = {
        "IMU_GYRO_RATEMAX": int(loops[0].rate_hz),
        "IMU_GYRO_CUTOFF": loops[0].gyro_cut_hz,
    }
    found |= {"IMU_DGYRO_CUTOFF": loops[0].slope_hz, "MC_YAW_TQ_CUTOFF": loops[2].output_hz}
    for axis, loop in zip(AXES, loops, strict=True):
        own = {"K": 1.0, "P": loop.p, "I": loop.i, "D": loop.d, "FF": loop.ff}
        name = axis.upper()
        found |= {f"MC_{name}RATE_{k}": v for k, v in own.items()} | {f"MC_{name}_P": loop.angle_p}
    return found


def _quaternions(euler: Floats) -> Floats:
    """(N, 4) of roll, pitch, yaw in rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * euler).T, np.sin(0.5 * euler).T
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )
