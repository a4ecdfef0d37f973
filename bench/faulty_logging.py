"""How much of a simulated flight its log holds: all, what the firmware logs by default, or half of that.

Default rates are those of ArduCopter's LOG_BITMASK 176126 and of PX4's SDLOG_PROFILE 1
(src/modules/logger/logged_topics.cpp). A blackbox logs the fields that its user left on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bench.faulty_quadrotor import RATE_HZ


@dataclass(frozen=True)
class Logging:
    """What is logged.

    Attributes
    ----------
    rates : stream -> rate in Hz, where it differs from that of a log made for tuning.
    lacks : streams that are missing; of a blackbox the beginnings of its fields' names.
    accel_hz : of the low-pass in front of the logged accelerometer; 0 for none.
    """

    rates: Mapping[str, float] = field(default_factory=dict)
    lacks: frozenset[str] = frozenset()
    accel_hz: float = 0.0

    def rate_of(self, stream: str, rate_hz: float) -> float:
        """At which a stream is logged that a log made for tuning holds at `rate_hz`."""
        return min(rate_hz, self.rates.get(stream, RATE_HZ))

    def holds(self, stream: str) -> bool:
        """Whether a stream is logged at all."""
        return not any(stream == name or stream.startswith(f"{name}[") for name in self.lacks)


TUNING = Logging()
COPTER = Logging(
    {"RATE": 10.0, "ATT": 10.0, "RCOU": 10.0, "IMU": 25.0, "XKF1": 10.0, "ESC": 10.0, "GPS": 5.0},
    accel_hz=20.0,
)
PX4 = Logging(
    {
        "vehicle_attitude": 20.0,
        "vehicle_attitude_setpoint": 20.0,
        "vehicle_angular_velocity": 50.0,
        "vehicle_rates_setpoint": 50.0,
        "vehicle_torque_setpoint": 50.0,
        "vehicle_thrust_setpoint": 50.0,
        "sensor_combined": 200.0,
        "actuator_motors": 10.0,
        "sensor_gps": 1.0,
        "vehicle_local_position": 10.0,
        "vehicle_magnetometer": 5.0,
        "vehicle_air_data": 5.0,
        "vehicle_imu_status": 1.0,
        "vehicle_land_detected": 1.0,
    }
)
DEFAULT = {"copter": COPTER, "px4": PX4}
"""Firmware -> its default logging; planes, rovers and blackboxes log at rates of their own."""

OF_DATAFLASH = [
    "IMU",
    "RATE",
    "RCOU",
    "BAT",
    "ESC",
    "VIBE",
    "GPS",
    "GPA",
    "XKF4",
    "MAG",
    "BARO",
    "POWR",
    "XKF1",
    "CTUN",
    "PSCN",
    "PSCE",
    "PSCD",
    "ATT",
    "STAT",
    "STER",
    "THR",
]
OF_BLACKBOX = (
    "axisP", "axisI", "axisD", "rcCommand", "accSmooth", "gyroUnfilt", "gyroRaw", "vbat", "amperage",
    "vbatLatest", "amperageLatest", "eRPM", "attitude", "navPos", "navVel", "navTgtPos", "GPS",
)  # fmt: skip
OF_ULOG = (
    "vehicle_attitude", "vehicle_attitude_setpoint", "vehicle_angular_velocity",
    "vehicle_rates_setpoint", "vehicle_torque_setpoint", "vehicle_thrust_setpoint", "sensor_combined",
    "actuator_motors", "battery_status", "sensor_gps", "estimator_status", "vehicle_local_position",
    "vehicle_local_position_setpoint", "hover_thrust_estimate", "vehicle_magnetometer",
    "vehicle_air_data", "system_power", "vehicle_imu_status", "actuator_armed",
)  # fmt: skip
MAY_LACK = {
    "copter": OF_DATAFLASH,
    "plane": OF_DATAFLASH,
    "rover": OF_DATAFLASH,
    "px4": OF_ULOG,
    "betaflight": OF_BLACKBOX,
    "inav": OF_BLACKBOX,
}
"""Firmware -> streams that a log may be without; what the firmware states of its flight is always there."""


def draw_logging(rng: np.random.Generator, firmware: str, needs: tuple[str, ...]) -> Logging:
    """As made for tuning, by default, or by default with half of the streams missing.

    Parameters
    ----------
    needs : streams that are there in any case: without them nothing in the log shows what happened.
    """
    usual = DEFAULT.get(firmware, TUNING)
    chosen = int(rng.integers(3))
    if chosen < 2:
        return (TUNING, usual)[chosen]
    free = [stream for stream in MAY_LACK[firmware] if stream not in needs]
    lacks = rng.choice(free, size=min(len(free), len(MAY_LACK[firmware]) // 2), replace=False)
    return Logging(usual.rates, frozenset(str(name) for name in lacks), usual.accel_hz)
