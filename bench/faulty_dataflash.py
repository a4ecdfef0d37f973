"""The log that ArduCopter would have written of a simulated flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.faulty_logging import TUNING, Logging
from bench.faulty_logs import (
    ACRO,
    AIR_S,
    BEGIN_US,
    DEGREE,
    LOITER,
    Rows,
    clips,
    compass_ratio,
    fill,
    follow,
    geodetic,
    gps_ratio,
    in_the_air,
    magnetic_field,
    rate_gains,
    vibration_level,
)
from bench.faulty_quadrotor import EXPO, FILTER_HZ, GROUND_S, RATE_HZ, SLOPE_HZ, Flight
from flysid.ingest.synth.telemetry import as_bytes, in_sending_order
from flysid.ingest.synth.writers import dataflash
from flysid.ingest.synth.writers.dataflash import MessageKind, definitions, message_bytes

IMU = MessageKind(140, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "s#EEEooo", "F-000000")
RATE = MessageKind(
    141,
    "RATE",
    "Qffffffffffff",
    "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut",
    "skk-kk-kk-oo-",
    "F00000000000-",
)
RCOU = MessageKind(142, "RCOU", "QHHHH", "TimeUS,C1,C2,C3,C4", "sYYYY", "F0000")
BAT = MessageKind(
    143,
    "BAT",
    "QBfffffcfB",
    "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct",
    "s#vvAa-O-%",
    "F-000C0B00",
)
ESC = MessageKind(
    144,
    "ESC",
    "QBffffcfcf",
    "TimeUS,Instance,RPM,RawRPM,Volt,Curr,Temp,CTot,MotTemp,Err",
    "s#qqvAOaO%",
    "F-0000BCB0",
)
VIBE = MessageKind(145, "VIBE", "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip", "s#ooo-", "F-000-")
GPS = MessageKind(
    146,
    "GPS",
    "QBBIHBcLLeffffB",
    "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U",
    "s#-s---DUmnhnh-",
    "F--C--BGGB0000-",
)
GPA = MessageKind(
    147, "GPA", "QBCCCCfBI", "TimeUS,I,VDop,HAcc,VAcc,SAcc,YAcc,VV,SMS", "s#-mmnd-s", "F-BBBB0-C"
)
XKF4 = MessageKind(
    148, "XKF4", "QBcccccfff", "TimeUS,C,SV,SP,SH,SM,SVT,errRP,OFN,OFE", "s#------mm", "F---------"
)
MAG = MessageKind(149, "MAG", "QBhhh", "TimeUS,I,MagX,MagY,MagZ", "s#GGG", "F-CCC")
BARO = MessageKind(150, "BARO", "QBff", "TimeUS,I,Alt,Press", "s#m-", "F-00")
POWR = MessageKind(151, "POWR", "Qff", "TimeUS,Vcc,VServo", "svv", "F00")
PARM = MessageKind(152, "PARM", "QNf", "TimeUS,Name,Value", "s--", "F--")
EV = MessageKind(153, "EV", "QB", "TimeUS,Id", "s-", "F-")
ERR = MessageKind(158, "ERR", "QBB", "TimeUS,Subsys,ECode", "s--", "F--")
ARM = MessageKind(154, "ARM", "QBI", "TimeUS,ArmState,ArmChecks", "s--", "F--")
PSC = tuple(
    MessageKind(
        155 + i, f"PSC{a}", "Qffffff", f"TimeUS,TP{a},P{a},DV{a},TV{a},V{a},TA{a}", "smmnnno", "F000000"
    )
    for i, a in enumerate("NED")
)
KINDS = (
    *dataflash.KINDS,
    IMU,
    RATE,
    RCOU,
    BAT,
    ESC,
    VIBE,
    GPS,
    GPA,
    XKF4,
    MAG,
    BARO,
    POWR,
    PARM,
    EV,
    ARM,
    ERR,
    *PSC,
)
NAMES = {kind.number: kind.name for kind in KINDS}


def dataflash_bytes(
    flight: Flight, *, rpm: bool = True, imu_hz: float = RATE_HZ, logging: Logging = TUNING
) -> bytes:
    """The whole log of ArduCopter.

    Parameters
    ----------
    rpm : the ESCs tell how fast they turn.
    imu_hz : rate of IMU.
    logging : what is logged, and how often.
    """
    if flight.vehicle.lively_rad:  # nothing holds its position
        logging = replace(logging, lacks=logging.lacks | {"PSCN", "PSCE"})
    tables = thin(_ardupilot_tables(flight, rpm, logging.rate_of("IMU", imu_hz), logging.accel_hz), logging)
    _, kind, row = in_sending_order(*(t["TimeUS"].astype(np.int64) * 1000 for t in tables))
    raw = [as_bytes(t) for t in tables]
    text = message_bytes(dataflash.MSG, BEGIN_US, b"ArduCopter V4.5.7 (simulated)")
    frame = message_bytes(dataflash.MSG, BEGIN_US, b"Frame: QUAD/X")
    number = ACRO if flight.vehicle.lively_rad else LOITER
    mode = message_bytes(dataflash.MODE, BEGIN_US, number, number, 1)
    stated = [message_bytes(PARM, BEGIN_US, n.encode(), v) for n, v in ardupilot_parameters(flight).items()]
    rows = (raw[k][r] for k, r in zip(kind.tolist(), row.tolist(), strict=True))
    return b"".join([definitions(KINDS, BEGIN_US), text, frame, *stated, mode, *rows])


def ardupilot_parameters(flight: Flight) -> dict[str, float]:
    """As the vehicle was set up."""
    vehicle = flight.vehicle
    gains = rate_gains(flight).items()
    found = {f"ATC_RAT_{axis}_{k}": g for axis, values in gains for k, g in zip("PID", values, strict=True)}
    return found | {
        "FRAME_CLASS": 1,
        "FRAME_TYPE": 1,
        "SERVO1_FUNCTION": 33,
        "SERVO2_FUNCTION": 34,
        "SERVO3_FUNCTION": 35,
        "SERVO4_FUNCTION": 36,
        "MOT_THST_HOVER": vehicle.stated_hover,
        "MOT_THST_EXPO": EXPO,
        "MOT_SPIN_MIN": 0.0,
        "MOT_SPIN_MAX": 1.0,
        "MOT_PWM_MIN": 1000,
        "MOT_PWM_MAX": 2000,
        "MOT_BAT_VOLT_MAX": 0,
        "BATT_CAPACITY": 1000 * vehicle.capacity_ah,
        "INS_GYRO_FILTER": FILTER_HZ,
        "INS_HNTCH_ENABLE": 0,
        "ATC_ANG_RLL_P": vehicle.attitude,
        "ATC_ANG_PIT_P": vehicle.attitude,
        "ATC_ANG_YAW_P": 0.5 * vehicle.attitude,
        "ATC_RAT_RLL_FLTD": SLOPE_HZ,
        "ATC_RAT_PIT_FLTD": SLOPE_HZ,
        "SCHED_LOOP_RATE": RATE_HZ,
        "PSC_POSXY_P": vehicle.position,
        "PSC_VELXY_P": vehicle.velocity,
    }


def thin(tables: Sequence[Rows], logging: Logging) -> list[Rows]:
    """The messages that are logged, at their rates."""
    kept = []
    for rows in tables:
        name = NAMES.get(int(rows["_type"][0]), "") if len(rows) else ""
        if not len(rows) or not logging.holds(name):
            continue
        rate_hz = (len(rows) - 1) / max(1e-6 * float(rows["TimeUS"][-1] - rows["TimeUS"][0]), 1e-6)
        every = round(rate_hz / logging.rate_of(name, rate_hz)) if name in logging.rates else 1
        kept.append(np.ascontiguousarray(rows[:: max(1, every)]))
    return kept


def _ardupilot_tables(flight: Flight, rpm: bool, imu_hz: float, accel_hz: float) -> list[Rows]:
    degrees = {n: np.degrees(flight[n]) for n in ("attitude", "wanted_attitude", "rates", "wanted_rates")}
    angles, wanted = degrees["attitude"], degrees["wanted_attitude"]
    lat, lon, height = geodetic(flight)
    position, velocity, ratio = flight["position"], flight["velocity"], gps_ratio(flight)
    field, used = 1000.0 * magnetic_field(flight), 1000.0 * flight["used_ah"]
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    thrust, flying = flight["wanted_thrust"], in_the_air(flight)
    tables = [
        rows_of(
            flight,
            dataflash.ATT,
            100.0,
            {
                "DesRoll": 100 * wanted[:, 0],
                "Roll": 100 * angles[:, 0],
                "DesPitch": 100 * wanted[:, 1],
                "Pitch": 100 * angles[:, 1],
                "DesYaw": 100 * (wanted[:, 2] % 360),
                "Yaw": 100 * (angles[:, 2] % 360),
            },
        ),
        rows_of(
            flight,
            RATE,
            RATE_HZ,
            {
                **{f"{a}Des": degrees["wanted_rates"][:, i] for i, a in enumerate("RPY")},
                **{a: degrees["rates"][:, i] for i, a in enumerate("RPY")},
                **{f"{a}Out": flight["torques"][:, i] for i, a in enumerate("RPY")},
                "AOut": thrust,
            },
        ),
        rows_of(
            flight,
            RCOU,
            50.0,
            {f"C{i + 1}": 1000 + 1000 * flight["throttles"][:, i] * flying for i in range(4)},
        ),
        rows_of(
            flight,
            BAT,
            10.0,
            {
                "Volt": flight["voltage"],
                "VoltR": flight["voltage"] + flight.vehicle.resistance_ohm * flight["current"],
                "Curr": flight["current"],
                "CurrTot": used,
                "RemPct": 100 - used / 10 / flight.vehicle.capacity_ah,
            },
        ),
        rows_of(
            flight,
            GPS,
            5.0,
            {
                "Status": 4,
                "NSats": flight["satellites"],
                "HDop": 100 * flight["hdop"],
                "Lat": lat / DEGREE,
                "Lng": lon / DEGREE,
                "Alt": 100 * height,
                "Spd": speed,
                "VZ": velocity[:, 2],
                "GWk": 2300,
                "U": 1,
                "GMS": 1000 * flight.time_s,
            },
        ),
        rows_of(
            flight,
            GPA,
            5.0,
            {
                "VDop": 110,
                "HAcc": 100 * flight["accuracy"],
                "VAcc": 120,
                "SAcc": 100 * flight["speed_accuracy"],
                "VV": 1,
            },
        ),
        rows_of(
            flight,
            XKF4,
            10.0,
            {
                "SV": 10 + 10 * np.minimum(ratio, 1),
                "SP": 100 * np.minimum(ratio, 300),
                "SH": 8,
                "SM": 100 * compass_ratio(flight),
                "SVT": 0,
            },
        ),
        rows_of(flight, MAG, 10.0, {f"Mag{a}": field[:, i] for i, a in enumerate("XYZ")}),
        rows_of(flight, BARO, 10.0, {"Alt": -position[:, 2], "Press": 96_000 + 11.5 * position[:, 2]}),
        rows_of(flight, POWR, 10.0, {"Vcc": flight["board"], "VServo": 5.0}),
        rows_of(
            flight,
            dataflash.XKF1,
            25.0,
            {
                "Roll": 100 * angles[:, 0],
                "Pitch": 100 * angles[:, 1],
                "Yaw": 100 * (angles[:, 2] % 360),
                **{f"V{a}": velocity[:, i] for i, a in enumerate("NED")},
                **{f"P{a}": position[:, i] for i, a in enumerate("NED")},
            },
        ),
        rows_of(
            flight,
            dataflash.CTUN,
            10.0,
            {
                "ThO": thrust,
                "ThH": flight.vehicle.stated_hover,
                "Alt": -position[:, 2],
                "BAlt": -100 * position[:, 2],
                "DAlt": -flight["wanted_position"][:, 2],
                "DCRt": -100 * flight["wanted_velocity"][:, 2],
                "CRt": -100 * velocity[:, 2],
            },
        ),
        *(
            rows_of(
                flight,
                kind,
                10.0,
                {
                    f"TP{a}": flight["wanted_position"][:, i],
                    f"P{a}": position[:, i],
                    f"DV{a}": flight["wanted_velocity"][:, i],
                    f"TV{a}": flight["wanted_velocity"][:, i],
                    f"V{a}": velocity[:, i],
                },
            )
            for i, (a, kind) in enumerate(zip("NED", PSC, strict=True))
        ),
        moments(
            flight,
            EV,
            [
                (at, {"Id": i})
                for at, i in ((1.0, 10), (GROUND_S, 28), (AIR_S[1], 18), (flight.armed_s[1], 11))
            ],
        ),
        moments(flight, ARM, [(1.0, {"ArmState": 1}), (flight.armed_s[1], {"ArmState": 0})]),
        *incident_rows(flight),
    ]
    for i, name in enumerate(("accel", "accel_2")):
        accel, gyro = flight[name], flight["gyro"]
        felt = follow(accel, accel_hz) if accel_hz else accel
        tables.append(
            rows_of(
                flight,
                IMU,
                imu_hz,
                {
                    "I": i,
                    **{f"Gyr{a}": gyro[:, j] for j, a in enumerate("XYZ")},
                    **{f"Acc{a}": felt[:, j] for j, a in enumerate("XYZ")},
                },
            )
        )
        level = vibration_level(accel)
        tables.append(
            rows_of(
                flight,
                VIBE,
                10.0,
                {
                    "IMU": i,
                    **{f"Vibe{a}": level[:, j] for j, a in enumerate("XYZ")},
                    "Clip": clips(accel),
                },
            )
        )
    if rpm:
        tables.extend(rows_of(flight, ESC, 10.0, _speed(flight, i)) for i in range(4))
    return tables


def _speed(flight: Flight, motor: int) -> dict[str, Any]:
    rpm = flight["rpm"][:, motor]
    current = flight["current"] / 4
    return {
        "Instance": motor,
        "RPM": rpm,
        "RawRPM": rpm,
        "Volt": flight["voltage"],
        "Curr": current,
        "Temp": 4500,
    }


def rows_of(flight: Flight, kind: MessageKind, rate_hz: float, values: Mapping[str, Any]) -> Rows:
    """Messages of one kind at a rate, from arrays over the flight or numbers."""
    at = slice(None, None, round(RATE_HZ / rate_hz))
    time_us = BEGIN_US + np.round(1e6 * flight.time_s[at]).astype(np.int64)
    rows = kind.rows(len(time_us))
    rows["TimeUS"] = time_us
    fill(rows, at, values)
    return rows


def moments(flight: Flight, kind: MessageKind, values: Sequence[tuple[float, Mapping[str, Any]]]) -> Rows:
    """Messages of one kind at moments, as far as the flight lasts."""
    stated = [(time_s, cells) for time_s, cells in values if time_s <= flight.time_s[-1]]
    rows = kind.rows(len(stated))
    for i, (time_s, cells) in enumerate(stated):
        rows["TimeUS"][i] = BEGIN_US + round(1e6 * time_s)
        for label, cell in cells.items():
            rows[label][i] = cell
    return rows


INCIDENTS: Mapping[str, tuple[Sequence[tuple[int, int]], Sequence[str], int]] = {
    "battery": ([(6, 1)], ["Battery 1 is low 13.92V used 3104 mAh", "Battery Failsafe"], 6),
    "radio": ([(5, 1)], ["Radio Failsafe"], 6),
    "EKF": ([(16, 2), (17, 1)], ["EKF variance", "EKF Failsafe: changed to LAND Mode"], 9),
    "fence": ([(9, 2)], ["Fence Breached"], 6),
    "station": ([(8, 1)], ["GCS Failsafe"], 6),
    "thrust": ([(25, 1)], ["Potential Thrust Loss (1)"], 0),
    "yaw": ([(16, 2)], ["EKF3 IMU0 MAG0 ground mag anomaly, yaw re-aligned", "EKF variance"], 0),
    "crash": ([(12, 1)], ["Crash: Disarming: AngErr=72>30, Accel=1.9<3.0"], 0),
}
"""Incident -> errors, messages, and the mode that ArduCopter changes to; 0 for none."""


def incident_rows(flight: Flight) -> list[Rows]:
    """What ArduCopter states of an incident."""
    vehicle = flight.vehicle
    if not vehicle.incident:
        return []
    errors, texts, mode = INCIDENTS[vehicle.incident]
    at_s = vehicle.incident_s
    return [
        moments(flight, ERR, [(at_s, {"Subsys": s, "ECode": code}) for s, code in errors]),
        moments(flight, dataflash.MSG, [(at_s, {"Message": text.encode()}) for text in texts]),
        *(
            [moments(flight, dataflash.MODE, [(at_s + 0.05, {"Mode": mode, "ModeNum": mode, "Rsn": 3})])]
            if mode
            else []
        ),
    ]
