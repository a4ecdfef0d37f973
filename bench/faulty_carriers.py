"""Planes and rovers with one fault each, as ArduPlane and Rover would have logged them.

Their motion is drawn, not simulated: a plane circles and climbs, a rover drives between points. What counts
is what the logs hold: the messages of these firmwares, their rates, and the faults of sensors and supply.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench.faulty_dataflash import (
    ARM,
    BARO,
    BAT,
    ERR,
    EV,
    GPA,
    GPS,
    IMU,
    MAG,
    PARM,
    POWR,
    VIBE,
    XKF4,
    moments,
    rows_of,
    thin,
)
from bench.faulty_logging import TUNING, Logging
from bench.faulty_logs import (
    BEGIN_US,
    DEGREE,
    Rows,
    clips,
    geodetic,
    gps_ratio,
    magnetic_field,
    vibration_level,
)
from bench.faulty_quadrotor import GRAVITY, RATE_HZ, SECONDS, Flight, Quadrotor
from bench.faulty_sensors import BROWNING_S, cut_off, receive
from flysid.ingest.synth.telemetry import as_bytes, in_sending_order
from flysid.ingest.synth.writers import dataflash
from flysid.ingest.synth.writers.dataflash import MessageKind, definitions, message_bytes

PLANE, ROVER = "ArduPlane V4.5.7 (simulated)", "ArduRover V4.5.0 (simulated)"
START_S, END_S = 4.0, 56.0
CRASH_M_S2 = 120.0
PLANE_CTUN = MessageKind(
    170, "CTUN", "Qccccffff", "TimeUS,NavRoll,Roll,NavPitch,Pitch,ThO,RdrOut,ThD,As", "sdddd---n", "FBBBB000-"
)
STAT = MessageKind(
    171, "STAT", "QBfBBBB", "TimeUS,isFlying,isFlyProb,Armed,Safety,Crash,Still", "s------", "F------"
)
STER = MessageKind(172, "STER", "Qhhffff", "TimeUS,SteerIn,SteerOut,DesLatAcc,LatAcc,DesTurnRate,TurnRate",
                   "s--ookk", "F--0000")  # fmt: skip
THR = MessageKind(173, "THR", "Qhffff", "TimeUS,ThrIn,ThrOut,DesSpeed,Speed,AccX", "s--nno", "F--000")
OUT = MessageKind(174, "RCOU", "QHHHH", "TimeUS,C1,C2,C3,C4", "sYYYY", "F0000")
KINDS = (*dataflash.KINDS, IMU, OUT, BAT, VIBE, GPS, GPA, XKF4, MAG, BARO, POWR, PARM, EV, ARM, ERR)
OF = {PLANE: (PLANE_CTUN, STAT), ROVER: (STER, THR)}
INCIDENTS: dict[str, dict[str, tuple[list[tuple[int, int]], list[str], int]]] = {
    PLANE: {
        "battery": ([], ["Battery 1 is low 13.92V used 3104 mAh"], 11),
        "radio": ([], ["Throttle failsafe on", "RC Short Failsafe On"], 1),
        "EKF": ([(16, 2)], ["EKF variance"], 11),
        "fence": ([(9, 2)], ["Fence Breached"], 11),
        "crash": ([], ["Crash detected: no GPS speed"], 0),
    },
    ROVER: {
        "battery": ([(6, 1)], ["Battery 1 is low 13.92V used 3104 mAh"], 4),
        "radio": ([(5, 1)], ["Throttle failsafe on", "Failsafe - Radio Failsafe"], 4),
        "EKF": ([(16, 2)], ["EKF variance", "EKF failsafe"], 4),
        "fence": ([(9, 2)], ["Fence Breached"], 4),
        "crash": ([(12, 1)], ["Crash: Going to HOLD"], 4),
    },
}
"""Firmware -> incident -> errors, messages, and the mode that it changes to."""


def travel(vehicle: Quadrotor, firmware: str) -> Flight:
    """What it did, and what its sensors gave."""
    rng = np.random.default_rng(vehicle.seed)
    full_a = 25.0 if firmware == PLANE else 12.0
    vehicle = replace(vehicle, wires=vehicle.wires * vehicle.hover_a / (0.45 * full_a))
    time_s = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    moving = np.clip((time_s - START_S) / 3.0, 0.0, 1.0) * np.clip((END_S - time_s) / 3.0, 0.0, 1.0)
    stopped_s = vehicle.incident_s if vehicle.incident == "crash" else np.inf
    moving = np.where(time_s < stopped_s, moving, 0.0)
    cruise = 18.0 if firmware == PLANE else 3.0
    speed = cruise * moving * (1.0 + 0.08 * np.sin(time_s / rng.uniform(3.0, 5.0)))
    turn = 0.35 * np.sign(np.sin(time_s / rng.uniform(4.0, 7.0))) * moving
    turn = np.convolve(turn, np.ones(400) / 400.0, "same")
    yaw = np.cumsum(turn) / RATE_HZ
    roll = np.arctan2(speed * turn, GRAVITY) if firmware == PLANE else 0.02 * rng.normal(size=len(time_s))
    climb = 2.0 * np.sin(time_s / 6.0) * moving if firmware == PLANE else 0.0 * time_s
    velocity = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), -climb], axis=1)
    attitude = np.stack([roll, climb / 18.0, yaw], axis=1)
    rates = np.gradient(attitude, 1.0 / RATE_HZ, axis=0)
    throttle = np.clip(0.45 * moving + 0.05 * climb * moving, 0.0, 1.0)
    turns = (time_s < vehicle.fails_s) | (vehicle.fails_s == 0.0)
    current = full_a * throttle * turns + 0.5
    used = np.cumsum(current) / RATE_HZ / 3600.0
    voltage = vehicle.cells * (4.15 - 0.65 * used / vehicle.capacity_ah) - vehicle.resistance_ohm * current
    tone = np.sin(2.0 * np.pi * np.cumsum(40.0 + 60.0 * throttle) / RATE_HZ)
    shake = (vehicle.shake_m_s2 + vehicle.bent_m_s2) * moving * tone
    gained = np.clip(np.gradient(speed, 1.0 / RATE_HZ), -10.0, 10.0)
    felt = np.stack([gained, speed * turn, np.full(len(time_s), -GRAVITY)], axis=1)
    blow = (time_s >= stopped_s) & (time_s < stopped_s + 0.05)
    felt[:, 0] -= CRASH_M_S2 * blow
    accel = [
        felt + shake[:, None] * np.array([0.7, 0.7, 1.0]) + 0.3 * rng.normal(size=felt.shape)
        for _ in range(2)
    ]
    left_s = vehicle.browns_s - time_s if vehicle.browns_s else np.full(len(time_s), np.inf)
    columns = {
        "position": np.cumsum(velocity, axis=0) / RATE_HZ,
        "velocity": velocity,
        "attitude": attitude,
        "rates": rates,
        "wanted_attitude": attitude + 0.01 * rng.normal(size=attitude.shape),
        "accel": accel[0],
        "accel_2": accel[1],
        "gyro": rates + 0.005 * shake[:, None] + 0.01 * rng.normal(size=rates.shape),
        "throttle": throttle,
        "speed": speed,
        "turn": turn,
        "current": current,
        "used_ah": used,
        "voltage": voltage,
        "board": 5.12 - 0.6 * np.clip(BROWNING_S - left_s, 0.0, BROWNING_S),
    }
    flight = Flight(vehicle, time_s, columns)
    return cut_off(replace(flight, columns=columns | receive(flight, rng)))


def carrier_bytes(flight: Flight, firmware: str, *, imu_hz: float = 50.0, logging: Logging = TUNING) -> bytes:
    """The whole log."""
    tables = thin([*_common(flight, imu_hz), *_own(flight, firmware), *_incident(flight, firmware)], logging)
    _, kind, row = in_sending_order(*(t["TimeUS"].astype(np.int64) * 1000 for t in tables))
    raw = [as_bytes(t) for t in tables]
    kinds = (*(k for k in KINDS if k.name != "CTUN" or firmware != PLANE), *OF[firmware])
    mode = 10
    head = [
        message_bytes(dataflash.MSG, BEGIN_US, firmware.encode()),
        *(message_bytes(PARM, BEGIN_US, n.encode(), v) for n, v in _parameters(flight, firmware).items()),
        message_bytes(dataflash.MODE, BEGIN_US, mode, mode, 1),
    ]
    rows = (raw[k][r] for k, r in zip(kind.tolist(), row.tolist(), strict=True))
    return b"".join([definitions(kinds, BEGIN_US), *head, *rows])


def _parameters(flight: Flight, firmware: str) -> dict[str, float]:
    own = (
        {"ROLL_LIMIT_DEG": 45, "STICK_MIXING": 1}
        if firmware == PLANE
        else {"CRUISE_SPEED": 3, "FRAME_CLASS": 1}
    )
    return own | {
        "BATT_CAPACITY": 1000 * flight.vehicle.capacity_ah,
        "INS_GYRO_FILTER": 20,
        "SERVO3_FUNCTION": 70,
    }


def _common(flight: Flight, imu_hz: float) -> list[Rows]:
    lat, lon, height = geodetic(flight)
    field, used = 1000.0 * magnetic_field(flight), 1000.0 * flight["used_ah"]
    position, velocity = flight["position"], flight["velocity"]
    angles, wanted = np.degrees(flight["attitude"]), np.degrees(flight["wanted_attitude"])
    ratio = gps_ratio(flight)
    output = {f"C{i}": np.full(len(flight.time_s), 1500.0) for i in (1, 2, 4)}
    tables = [
        rows_of(flight, dataflash.ATT, 10.0, {
            "DesRoll": 100 * wanted[:, 0], "Roll": 100 * angles[:, 0], "DesPitch": 100 * wanted[:, 1],
            "Pitch": 100 * angles[:, 1], "DesYaw": 100 * (wanted[:, 2] % 360),
            "Yaw": 100 * (angles[:, 2] % 360),
        }),
        rows_of(flight, OUT, 10.0, {**output, "C3": 1000 + 1000 * flight["throttle"]}),
        rows_of(flight, BAT, 10.0, {
            "Volt": flight["voltage"], "VoltR": flight["voltage"], "Curr": flight["current"], "CurrTot": used,
            "RemPct": np.maximum(100 - used / 10 / flight.vehicle.capacity_ah, 0),
        }),
        rows_of(flight, GPS, 5.0, {
            "Status": 4, "NSats": flight["satellites"], "HDop": 100 * flight["hdop"], "Lat": lat / DEGREE,
            "Lng": lon / DEGREE, "Alt": 100 * height, "Spd": flight["speed"], "VZ": velocity[:, 2],
            "GWk": 2300, "U": 1, "GMS": 1000 * flight.time_s,
        }),
        rows_of(flight, GPA, 5.0, {
            "VDop": 110, "HAcc": 100 * flight["accuracy"], "VAcc": 120,
            "SAcc": 100 * flight["speed_accuracy"], "VV": 1,
        }),
        rows_of(flight, XKF4, 10.0, {
            "SV": 10 + 10 * np.minimum(ratio, 1), "SP": 100 * np.minimum(ratio, 300), "SH": 8, "SM": 6,
        }),
        rows_of(flight, MAG, 10.0, {f"Mag{a}": field[:, i] for i, a in enumerate("XYZ")}),
        rows_of(flight, BARO, 10.0, {"Alt": -position[:, 2], "Press": 96_000 + 11.5 * position[:, 2]}),
        rows_of(flight, POWR, 10.0, {"Vcc": flight["board"], "VServo": 5.0}),
        rows_of(flight, dataflash.XKF1, 10.0, {
            "Roll": 100 * angles[:, 0], "Pitch": 100 * angles[:, 1], "Yaw": 100 * (angles[:, 2] % 360),
            **{f"V{a}": velocity[:, i] for i, a in enumerate("NED")},
            **{f"P{a}": position[:, i] for i, a in enumerate("NED")},
        }),
        moments(flight, EV, [(1.0, {"Id": 10}), (SECONDS - 1.0, {"Id": 11})]),
        moments(flight, ARM, [(1.0, {"ArmState": 1}), (SECONDS - 1.0, {"ArmState": 0})]),
    ]  # fmt: skip
    for i, name in enumerate(("accel", "accel_2")):
        accel, gyro, level = flight[name], flight["gyro"], vibration_level(flight[name])
        axes = {f"Gyr{a}": gyro[:, j] for j, a in enumerate("XYZ")} | {
            f"Acc{a}": accel[:, j] for j, a in enumerate("XYZ")
        }
        tables.append(rows_of(flight, IMU, imu_hz, {"I": i, **axes}))
        shakes = {f"Vibe{a}": level[:, j] for j, a in enumerate("XYZ")}
        tables.append(rows_of(flight, VIBE, 10.0, {"IMU": i, **shakes, "Clip": clips(accel)}))
    return tables


def _own(flight: Flight, firmware: str) -> list[Rows]:
    """The messages that only this firmware writes."""
    angles = np.degrees(flight["attitude"])
    if firmware == ROVER:
        turn, speed = np.degrees(flight["turn"]), flight["speed"]
        return [
            rows_of(flight, STER, 10.0, {"DesTurnRate": turn, "TurnRate": np.degrees(flight["rates"][:, 2])}),
            rows_of(flight, THR, 10.0, {"ThrOut": 100 * flight["throttle"], "Speed": speed}),
        ]  # fmt: skip
    flying = (flight["speed"] > 6.0).astype(float)
    steered: dict[str, Any] = {
        "NavRoll": 100 * angles[:, 0], "Roll": 100 * angles[:, 0], "NavPitch": 100 * angles[:, 1],
        "Pitch": 100 * angles[:, 1], "ThO": 100 * flight["throttle"], "As": flight["speed"],
    }  # fmt: skip
    return [
        rows_of(flight, PLANE_CTUN, 10.0, steered),
        rows_of(flight, STAT, 5.0, {"isFlying": flying, "isFlyProb": flying, "Armed": 1}),
    ]


def _incident(flight: Flight, firmware: str) -> list[Rows]:
    vehicle = flight.vehicle
    if vehicle.incident not in INCIDENTS[firmware]:
        return []
    errors, texts, mode = INCIDENTS[firmware][vehicle.incident]
    at_s = vehicle.incident_s + (1.0 if vehicle.incident == "crash" else 0.0)
    return [
        moments(flight, ERR, [(at_s, {"Subsys": s, "ECode": code}) for s, code in errors]),
        moments(flight, dataflash.MSG, [(at_s, {"Message": text.encode()}) for text in texts]),
        moments(flight, dataflash.MODE, [(at_s + 0.05, {"Mode": mode, "ModeNum": mode, "Rsn": 3})]),
    ]
