"""The log that PX4 would have written of a simulated flight."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from bench.faulty_logging import TUNING, Logging
from bench.faulty_logs import (
    BEGIN_US,
    HOME,
    POSITION,
    PX4_ACRO,
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
from bench.faulty_quadrotor import EXPO, FILTER_HZ, RATE_HZ, SLOPE_HZ, Flight
from flysid.dataset import FloatArray
from flysid.ingest.synth.telemetry import as_bytes, in_sending_order
from flysid.ingest.synth.writers.ulog import Fields, preamble, record, row_type


def _of(*names: str, size: int = 0, kind: str = "<f4") -> Fields:
    return [(name, f"{size}{kind}" if size else kind) for name in names]


STAMP: Fields = [("timestamp", "<u8")]
SAMPLED: Fields = [*STAMP, ("timestamp_sample", "<u8")]
TOPICS: dict[str, tuple[float, Fields]] = {
    "vehicle_attitude": (50.0, [*SAMPLED, ("q", "4<f4")]),
    "vehicle_attitude_setpoint": (50.0, [*STAMP, ("q_d", "4<f4"), ("thrust_body", "3<f4")]),
    "vehicle_angular_velocity": (RATE_HZ / 2, [*SAMPLED, ("xyz", "3<f4")]),
    "vehicle_rates_setpoint": (RATE_HZ / 2, [*STAMP, *_of("roll", "pitch", "yaw"), ("thrust_body", "3<f4")]),
    "vehicle_torque_setpoint": (RATE_HZ / 2, [*SAMPLED, ("xyz", "3<f4")]),
    "vehicle_thrust_setpoint": (RATE_HZ / 2, [*SAMPLED, ("xyz", "3<f4")]),
    "sensor_combined": (
        RATE_HZ,
        [*STAMP, ("gyro_rad", "3<f4"), ("accelerometer_m_s2", "3<f4"), ("accelerometer_clipping", "u1")],
    ),
    "actuator_motors": (50.0, [*SAMPLED, ("control", "4<f4")]),
    "battery_status": (
        5.0,
        [
            *STAMP,
            *_of("voltage_v", "current_a", "discharged_mah", "remaining"),
            *_of("cell_count", "warning", kind="u1"),
        ],
    ),
    "sensor_gps": (
        5.0,
        [
            *STAMP,
            *_of("latitude_deg", "longitude_deg", "altitude_msl_m", kind="<f8"),
            *_of("eph", "epv", "hdop", "s_variance_m_s", "vel_m_s"),
            ("jamming_indicator", "<i4"),
            *_of("fix_type", "satellites_used", kind="u1"),
        ],
    ),
    "estimator_status": (
        5.0,
        [*SAMPLED, *_of("hdg_test_ratio", "vel_test_ratio", "pos_test_ratio", "hgt_test_ratio")],
    ),
    "vehicle_local_position": (50.0, [*SAMPLED, *_of("x", "y", "z", "vx", "vy", "vz", "heading")]),
    "vehicle_local_position_setpoint": (10.0, [*STAMP, *_of("x", "y", "z", "vx", "vy", "vz")]),
    "hover_thrust_estimate": (5.0, [*SAMPLED, *_of("hover_thrust", "hover_thrust_var"), ("valid", "?")]),
    "vehicle_magnetometer": (10.0, [*SAMPLED, ("magnetometer_ga", "3<f4")]),
    "vehicle_air_data": (10.0, [*SAMPLED, *_of("baro_alt_meter", "baro_pressure_pa")]),
    "system_power": (2.0, [*STAMP, *_of("voltage5v_v")]),
    "vehicle_imu_status": (
        2.0,
        [
            *STAMP,
            ("accel_clipping", "3<u4"),
            *_of("accel_vibration_metric", "gyro_vibration_metric"),
            ("mean_accel", "3<f4"),
            ("var_accel", "3<f4"),
        ],
    ),
    "vehicle_status": (
        2.0,
        [*STAMP, *_of("nav_state", "arming_state", "failure_detector_status", kind="u1"), ("failsafe", "?")],
    ),
    "failsafe_flags": (
        2.0,
        [
            *STAMP,
            *(
                (name, "?")
                for name in (
                    "manual_control_signal_lost",
                    "gcs_connection_lost",
                    "geofence_breached",
                    "local_velocity_invalid",
                )
            ),
            ("battery_warning", "u1"),
        ],
    ),
    "vehicle_land_detected": (10.0, [*STAMP, ("landed", "?")]),
    "actuator_armed": (10.0, [*STAMP, ("armed", "?")]),
}
SECOND = ("vehicle_imu_status",)
"""Topics of which there are two."""


def ulog_bytes(flight: Flight, *, second: bool = True, logging: Logging = TUNING) -> bytes:
    """The whole log of PX4; with its second accelerometer or without."""
    columns = _px4_columns(flight)
    lacks = {"vehicle_local_position_setpoint"} if flight.vehicle.lively_rad else set()
    logged = [name for name in TOPICS if logging.holds(name) and name not in lacks]
    seconds = [f"{name}#1" for name in SECOND if second and name in logged]
    tables = {name: _topic(flight, name, columns[name], logging) for name in [*logged, *seconds]}
    layouts = {name: TOPICS[name.partition("#")[0]][1] for name in tables}
    facts = {"sys_name": "PX4", "ver_hw": "SIMULATED", "sys_uuid": f"{flight.vehicle.seed:024d}"}
    parts = [preamble(layouts, facts, BEGIN_US, parameters=px4_parameters(flight))]
    parts.extend(_messages(flight))
    _, topic, row = in_sending_order(*(1000 * t["timestamp"].astype(np.int64) for t in tables.values()))
    raw = [as_bytes(t) for t in tables.values()]
    for k, r in zip(topic.tolist(), row.tolist(), strict=True):
        parts.append(record("D", struct.pack("<H", k) + raw[k][r]))
    return b"".join(parts)


def px4_parameters(flight: Flight) -> dict[str, float]:
    """As the vehicle was set up."""
    vehicle = flight.vehicle
    names = {"RLL": "ROLL", "PIT": "PITCH", "YAW": "YAW"}
    gains = rate_gains(flight).items()
    found = {f"MC_{names[a]}RATE_{k}": float(g) for a, v in gains for k, g in zip("PID", v, strict=True)}
    arm = vehicle.arm_m / np.sqrt(2.0)
    places = ((1, 1), (-1, -1), (1, -1), (-1, 1))
    for i, (x, y) in enumerate(places):
        found |= {
            f"CA_ROTOR{i}_PX": x * arm,
            f"CA_ROTOR{i}_PY": y * arm,
            f"CA_ROTOR{i}_KM": 0.05 if i < 2 else -0.05,
        }
    return found | {
        "MAV_TYPE": 2,
        "CA_ROTOR_COUNT": 4,
        "CA_AIRFRAME": 0,
        "SYS_AUTOSTART": 4001,
        "THR_MDL_FAC": EXPO,
        "MPC_THR_HOVER": vehicle.stated_hover,
        "BAT1_N_CELLS": vehicle.cells,
        "BAT1_V_EMPTY": 3.6,
        "BAT1_CAPACITY": 1000 * vehicle.capacity_ah,
        "IMU_GYRO_CUTOFF": FILTER_HZ,
        "IMU_DGYRO_CUTOFF": SLOPE_HZ,
        "MC_ROLL_P": vehicle.attitude,
        "MC_PITCH_P": vehicle.attitude,
        "MC_YAW_P": 0.5 * vehicle.attitude,
        "MPC_XY_P": vehicle.position,
        "SDLOG_PROFILE": 1,
        "MC_ROLLRATE_K": 1.0,
        "MC_PITCHRATE_K": 1.0,
        "MC_YAWRATE_K": 1.0,
    }


def _px4_columns(flight: Flight) -> dict[str, dict[str, Any]]:
    vehicle = flight.vehicle
    position, velocity = flight["position"], flight["velocity"]
    lat, lon, height = geodetic(flight)
    ratio, down = gps_ratio(flight), -flight["wanted_thrust"]
    lift = np.stack([0 * down, 0 * down, down], axis=1)
    flying = in_the_air(flight)
    armed = (flight.time_s >= flight.armed_s[0]) & (flight.time_s < flight.armed_s[1])
    acts = (flight.time_s >= vehicle.incident_s) & bool(vehicle.incident)
    happens = {name: acts & (name == vehicle.incident) for name in INCIDENTS}
    hover = follow(flight["wanted_thrust"] * np.cos(flight["attitude"][:, 0]), 0.04)
    status = {
        name: {
            "accel_clipping": np.repeat(clips(flight[sensor])[:, None], 3, axis=1),
            "accel_vibration_metric": 0.3 * np.linalg.norm(vibration_level(flight[sensor]), axis=1),
            "gyro_vibration_metric": 0.05,
            "mean_accel": flight[sensor],
            "var_accel": vibration_level(flight[sensor]) ** 2,
        }
        for name, sensor in (("vehicle_imu_status", "accel"), ("vehicle_imu_status#1", "accel_2"))
    }
    return status | {
        "vehicle_attitude": {"q": _quaternions(flight["attitude"])},
        "vehicle_attitude_setpoint": {"q_d": _quaternions(flight["wanted_attitude"]), "thrust_body": lift},
        "vehicle_angular_velocity": {"xyz": flight["rates"]},
        "vehicle_rates_setpoint": {
            **{a: flight["wanted_rates"][:, i] for i, a in enumerate(("roll", "pitch", "yaw"))},
            "thrust_body": lift,
        },
        "vehicle_torque_setpoint": {"xyz": flight["torques"]},
        "vehicle_thrust_setpoint": {"xyz": lift},
        "sensor_combined": {"gyro_rad": flight["gyro"], "accelerometer_m_s2": flight["accel"]},
        "actuator_motors": {"control": flight["thrusts"] * flying[:, None]},
        "battery_status": {
            "voltage_v": flight["voltage"],
            "current_a": flight["current"],
            "discharged_mah": 1000 * flight["used_ah"],
            "remaining": 1 - flight["used_ah"] / vehicle.capacity_ah,
            "cell_count": vehicle.cells,
            "warning": 2 * happens["battery"],
        },
        "sensor_gps": {
            "latitude_deg": lat,
            "longitude_deg": lon,
            "altitude_msl_m": height,
            "eph": flight["accuracy"],
            "epv": 1.1,
            "hdop": flight["hdop"],
            "s_variance_m_s": flight["speed_accuracy"],
            "jamming_indicator": flight["jamming"],
            "vel_m_s": np.hypot(velocity[:, 0], velocity[:, 1]),
            "fix_type": 3,
            "satellites_used": flight["satellites"],
        },
        "estimator_status": {
            "hdg_test_ratio": compass_ratio(flight),
            "vel_test_ratio": 0.1,
            "pos_test_ratio": ratio,
            "hgt_test_ratio": 0.07,
        },
        "vehicle_local_position": {
            **{a: position[:, i] for i, a in enumerate("xyz")},
            **{f"v{a}": velocity[:, i] for i, a in enumerate("xyz")},
            "heading": flight["attitude"][:, 2],
        },
        "vehicle_local_position_setpoint": {
            **{a: flight["wanted_position"][:, i] for i, a in enumerate("xyz")},
            **{f"v{a}": flight["wanted_velocity"][:, i] for i, a in enumerate("xyz")},
        },
        "hover_thrust_estimate": {"hover_thrust": hover, "hover_thrust_var": 1e-4, "valid": flying},
        "vehicle_magnetometer": {"magnetometer_ga": magnetic_field(flight)},
        "vehicle_air_data": {
            "baro_alt_meter": HOME[2] - position[:, 2],
            "baro_pressure_pa": 96_000 + 11.5 * position[:, 2],
        },
        "system_power": {"voltage5v_v": flight["board"]},
        "vehicle_status": {
            "nav_state": np.where(
                acts,
                INCIDENTS.get(vehicle.incident, ("", 0))[1],
                PX4_ACRO if vehicle.lively_rad else POSITION,
            ),
            "arming_state": np.where(armed, 2, 1),
            "failure_detector_status": 0,
            "failsafe": acts & (vehicle.incident not in ADVISORY),
        },
        "failsafe_flags": {
            "manual_control_signal_lost": happens["radio"],
            "gcs_connection_lost": happens["station"],
            "geofence_breached": happens["fence"],
            "local_velocity_invalid": happens["EKF"],
            "battery_warning": 2 * happens["battery"],
        },
        "vehicle_land_detected": {"landed": ~flying},
        "actuator_armed": {"armed": armed},
    }


INCIDENTS = {
    "battery": ("Critical battery", 5),
    "radio": ("Manual control signal lost", 5),
    "EKF": ("Position estimate invalid", 12),
    "fence": ("Geofence breached", 5),
    "station": ("Connection to ground control station lost", 5),
    "yaw": ("Emergency yaw reset - magnetometer use stopped", POSITION),
}
"""Incident -> PX4's message, and the state of navigation that it changes to."""
ADVISORY = ("yaw", "crash", "thrust")
"""Incidents in which PX4 does not act."""


def _messages(flight: Flight) -> Iterator[bytes]:
    """What PX4 states of an incident."""
    vehicle = flight.vehicle
    if vehicle.incident not in INCIDENTS:
        return
    stamp = struct.pack("<Q", BEGIN_US + round(1e6 * vehicle.incident_s))
    reason, _ = INCIDENTS[vehicle.incident]
    acted = () if vehicle.incident in ADVISORY else ("[failsafe] Failsafe activated\t",)
    for text in (f"[health_and_arming_checks] {reason}\t", *acted):
        yield record("L", b"4" + stamp + text.encode())


def _topic(flight: Flight, name: str, values: Mapping[str, Any], logging: Logging) -> Rows:
    topic = name.partition("#")[0]
    rate_hz, fields = TOPICS[topic]
    at = slice(None, None, round(RATE_HZ / logging.rate_of(topic, rate_hz)))
    time_us = BEGIN_US + np.round(1e6 * flight.time_s[at]).astype(np.int64)
    rows: Rows = np.zeros(len(time_us), dtype=row_type(fields))
    for stamp in {"timestamp", "timestamp_sample"} & set(rows.dtype.names or ()):
        rows[stamp] = time_us
    fill(rows, at, values)
    return rows


def _quaternions(euler: FloatArray) -> FloatArray:
    """(N, 4) of roll, pitch, yaw in rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * euler).T, np.sin(0.5 * euler).T
    parts = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    return np.stack(parts, axis=1)
