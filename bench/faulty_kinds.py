"""What goes wrong with simulated vehicles, whose logs show it, and which first sentences name it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.faulty_blackbox import MOTORS as BLACKBOX_ORDER
from bench.faulty_carriers import PLANE, ROVER
from bench.faulty_quadrotor import (
    DAMPING_S,
    DELAY,
    FILTER_HZ,
    GROUND_S,
    INTEGRAL,
    RATE_HZ,
    SLOPE_HZ,
    Flight,
    Quadrotor,
    draw_quadrotor,
)

Rng = np.random.Generator
Names = Callable[[str, Flight], bool]


@dataclass(frozen=True)
class Fault:
    """A kind of fault.

    Attributes
    ----------
    spoil : a sound vehicle with this fault, of a strength that is drawn.
    names : whether a first sentence names it, of the flight that was flown.
    """

    spoil: Callable[[Quadrotor, Rng], Quadrotor]
    names: Names


def _holds(pattern: str) -> Names:
    """Whether a sentence holds an expression."""
    return lambda text, _: bool(re.search(pattern, text))


def _names_motor(text: str, flight: Flight) -> bool:
    return _names(text, flight.vehicle.weak)


def _names(text: str, motor: int) -> bool:
    """Whether a sentence names a motor, as its firmware counts."""
    numbers = (motor + 1, 1 + BLACKBOX_ORDER.index(motor))
    return any(re.search(rf"[Mm]otor {number}\b", text) for number in numbers)


def _names_first(text: str, _: Flight) -> bool:
    """The simulator's first motor is number 1, in a blackbox number 2; a plane has one."""
    return bool(re.search(r"([Mm]otor|[Pp]ropeller) [12]\b|The motor stops", text))


def _names_tone(text: str, flight: Flight, *, within: float = 0.06) -> bool:
    """Whether a sentence is about vibration, or states a frequency at which the bent motor turned."""
    if "rpm" not in flight.columns:
        return bool(re.search("ibrat|[Ss]hake", text))
    flying = (flight.time_s > 2.0 * GROUND_S) & (flight.time_s < flight.time_s[-1] - 2.0 * GROUND_S)
    turned_hz = flight["rpm"][flying, flight.vehicle.bent].mean() / 60.0
    stated = [float(number) for number in re.findall(r"(\d+(?:\.\d+)?) Hz", text)]
    return (
        "ibrat" in text
        or "does not show how fast" in text
        or _names(text, flight.vehicle.bent)
        or any(abs(hz / turned_hz - 1.0) < within for hz in stated)
    )


def _weak_motor(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    weakness = rng.uniform(0.15, 0.25)
    return replace(vehicle, weak=int(rng.integers(4)), weakness=weakness, propeller=bool(rng.integers(2)))


def _bent_shaft(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, bent=int(rng.integers(4)), bent_m_s2=rng.uniform(60.0, 110.0))


def critical_gain(vehicle: Quadrotor) -> float:
    """The factor on the gains of roll and pitch at which the rate loop begins to oscillate by itself."""
    w = np.geomspace(5.0, 600.0, 4000)
    s = 1j * w
    filters = 1.0 / (1.0 + s / (2.0 * np.pi * FILTER_HZ)) ** 2
    control = 1.0 + INTEGRAL / s + DAMPING_S * s / (1.0 + s / (2.0 * np.pi * SLOPE_HZ))
    late = np.exp(-s * (DELAY + 0.5) / RATE_HZ) / (1.0 + s * vehicle.lag_s)
    loop = vehicle.bandwidth_rad_s / s * control * filters * late
    turned = np.unwrap(np.angle(loop))
    return float(1.0 / np.interp(np.pi, -turned, np.abs(loop)))


def _heavy(vehicle: Quadrotor, _: Rng) -> Quadrotor:
    return replace(vehicle, heavier=1.2)


def _sagging(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    """A battery that loses 0.4 to 0.7 V a cell in hover."""
    return replace(vehicle, resistance_ohm=rng.uniform(0.4, 0.7) * vehicle.cells / vehicle.hover_a)


def _glitching(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, glitch_s=rng.uniform(20.0, 45.0), glitch_m=rng.uniform(15.0, 60.0))


def _loose(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, loose_m_s2=rng.uniform(45.0, 80.0))


def _late_yaw(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, yaw_rad_s=rng.uniform(1.2, 1.8))


def _hot(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, gain=rng.uniform(1.15, 1.5) * critical_gain(vehicle))


def _draw_moment(rng: Rng) -> float:
    return float(rng.uniform(20.0, 42.0))


def _dead_motor(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, fails_s=_draw_moment(rng))


def _lost_propeller(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, fails_s=_draw_moment(rng), propeller=True)


def _slipping(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, slips_s=_draw_moment(rng), slip_s=rng.uniform(0.15, 0.22))


def _brown(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, browns_s=_draw_moment(rng))


def _jammed(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, jam_s=_draw_moment(rng))


def _disturbed(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    """A compass beside the battery's wires: 0.7 to 1.5 of the earth's field over the range of the current."""
    return replace(vehicle, wires=rng.uniform(0.7, 1.5) / vehicle.hover_a)


def _lost_estimate(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    at_s = _draw_moment(rng)
    drift = rng.uniform(1.0, 3.0)
    return replace(vehicle, drift_s=at_s - 4.0, drift_m_s=drift, incident="EKF", incident_s=at_s)


def _incident(name: str) -> Callable[[Quadrotor, Rng], Quadrotor]:
    return lambda vehicle, rng: replace(vehicle, incident=name, incident_s=_draw_moment(rng))


def _hitting(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, incident="crash", incident_s=_draw_moment(rng))


def _empty(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    at_s = _draw_moment(rng)
    used_ah = vehicle.hover_a * at_s / 3600.0
    return replace(vehicle, capacity_ah=used_ah / 0.8, incident="battery", incident_s=at_s)


def _starved(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(_brown(vehicle, rng), warns=False)


def _straying(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    """A compass that turns by 120 to 240 deg: it flies away, the faster the further it is."""
    at_s = rng.uniform(18.0, 30.0)
    stated_s = at_s + rng.uniform(2.0, 5.0) if rng.random() < 0.5 else 0.0
    strayed = replace(vehicle, strays_s=at_s, strays_rad=rng.uniform(2.1, 4.2))
    return replace(strayed, incident="yaw", incident_s=stated_s) if stated_s else strayed


def _colliding(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    at_s = round(_draw_moment(rng) * RATE_HZ) / RATE_HZ
    collided = replace(vehicle, hits_s=at_s)
    return replace(collided, incident="crash", incident_s=at_s + 2.5) if rng.random() < 0.5 else collided


def _crashing(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    """A motor that fails, and a firmware that notices the loss of thrust, or not."""
    failed = _dead_motor(vehicle, rng)
    stated_s = failed.fails_s + 0.4
    return replace(failed, incident="thrust", incident_s=stated_s) if rng.random() < 0.3 else failed


def _shaking(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    """All sensors shake beyond the firmwares' limits: propellers out of balance, a frame that is loose."""
    return replace(vehicle, shake_m_s2=rng.uniform(80.0, 130.0))


def _dropped(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, hard_m_s=rng.uniform(2.2, 4.5))


FAULTS = {
    "motor failure": Fault(_crashing, _names_first),
    "propeller loss": Fault(_lost_propeller, _names_first),
    "desync": Fault(_slipping, _holds(r"[Mm]otor [23]\b")),
    "brown-out": Fault(_brown, _holds(r"brown-out|supply|battery")),
    "power lost": Fault(_starved, _holds(r"log ends (in the air|on the way).*|[Pp]ower")),
    "flyaway": Fault(_straying, _holds(r"[Ff]l(ew|ies|y) away|from its target|[Cc]ompass|[Hh]eading")),
    "collision": Fault(_colliding, _holds(r"[Cc]rash|[Tt]ipped|[Hh]it")),
    "vibration": Fault(_shaking, _holds(r"[Vv]ibrat|[Cc]lip|[Ss]hake")),
    "ground station failsafe": Fault(_incident("station"), _holds(r"[Gg]round|GCS|station")),
    "GPS interference": Fault(_jammed, _holds(r"GPS|satellites|[Jj]am")),
    "compass interference": Fault(_disturbed, _holds(r"[Cc]ompass|magnetic")),
    "EKF failure": Fault(_lost_estimate, _holds(r"EKF|[Ee]stimat")),
    "battery failsafe": Fault(_empty, _holds(r"[Bb]attery|\b[Cc]ell")),
    "radio failsafe": Fault(_incident("radio"), _holds(r"[Rr]adio")),
    "fence breach": Fault(_incident("fence"), _holds(r"[Ff]ence")),
    "crash": Fault(_hitting, _holds(r"[Cc]rash")),
    "hard landing": Fault(_dropped, _holds(r"[Ll]anded hard")),
    "weak motor": Fault(_weak_motor, _names_motor),
    "bent shaft": Fault(_bent_shaft, _names_tone),
    "mass +20 %": Fault(_heavy, _holds(r"[Hh]over")),
    "sagging battery": Fault(_sagging, _holds(r"[Bb]attery|\b[Cc]ell")),
    "GPS glitch": Fault(_glitching, _holds("GPS")),
    "loose accelerometer": Fault(_loose, _holds(r"[Aa]ccelerometer|[Vv]ibrat|[Cc]lip")),
    "late yaw": Fault(_late_yaw, _holds(r"[Yy]aw")),
    "gains too high": Fault(_hot, _holds(r"[Oo]scillat|gains? .*too high")),
}
SOUND = "sound"
FIRMWARES = ("copter", "px4", "betaflight", "inav", "plane", "rover")
COPTERS = ("copter", "px4")
CARRIERS = {"plane": PLANE, "rover": ROVER}
STATING = ("copter", "px4", "plane", "rover")
SHOWN: Mapping[str, Sequence[str]] = {
    "motor failure": FIRMWARES,
    "propeller loss": ("copter", "px4", "betaflight", "inav"),
    "desync": ("copter", "px4", "betaflight"),
    "GPS interference": ("copter", "px4", "inav", "plane", "rover"),
    "compass interference": STATING,
    "EKF failure": STATING,
    "battery failsafe": STATING,
    "fence breach": STATING,
    "crash": ("plane", "rover"),
    "power lost": ("copter", "px4", "betaflight", "inav"),
    "flyaway": ("copter", "px4", "inav"),
    "collision": ("copter", "px4", "betaflight", "inav"),
    "vibration": ("copter", "px4", "plane", "rover"),
    "ground station failsafe": COPTERS,
    "hard landing": ("copter", "px4", "inav"),
    "weak motor": ("copter", "px4", "betaflight", "inav"),
    "bent shaft": ("copter", "px4", "betaflight", "plane", "rover"),
    "mass +20 %": COPTERS,
    "sagging battery": ("copter", "px4", "betaflight", "inav"),
    "GPS glitch": ("copter", "px4", "inav", "plane", "rover"),
    "loose accelerometer": COPTERS,
    "late yaw": ("copter", "px4", "betaflight", "inav"),
    "gains too high": ("copter", "px4", "betaflight", "inav"),
}
"""Fault -> firmwares whose logs hold what shows it, and whose vehicles can have it; others: all."""

ESTIMATE = ("ATT", "vehicle_attitude", "attitude", "vehicle_attitude_setpoint")
COMMANDS = ("RCOU", "actuator_motors")
FELT = ("IMU", "sensor_combined", "accSmooth")
RATES = ("RATE", "vehicle_angular_velocity", "vehicle_rates_setpoint")
CHARGE = ("BAT", "battery_status", "vbat", "vbatLatest", "amperage", "amperageLatest")
FIX = ("GPS", "sensor_gps")
GOING = (
    "PSCN",
    "PSCE",
    "PSCD",
    "vehicle_local_position",
    "vehicle_local_position_setpoint",
    "navPos",
    "navTgtPos",
)
LEVEL = ("VIBE", "vehicle_imu_status")
NEEDS: Mapping[str, tuple[str, ...]] = {
    "motor failure": (*ESTIMATE, *COMMANDS, *FELT, "BAT", "CTUN", "THR"),
    "propeller loss": (*ESTIMATE, *COMMANDS, *FELT),
    "desync": (*ESTIMATE, *COMMANDS, "ESC", "eRPM"),
    "brown-out": ("POWR", "system_power", *CHARGE, "rcCommand"),
    "power lost": (),
    "flyaway": GOING,
    "collision": (*ESTIMATE, "accSmooth"),
    "vibration": LEVEL,
    "GPS interference": FIX,
    "compass interference": ("MAG", "vehicle_magnetometer", *CHARGE, "GPS", "STAT", "THR"),
    "crash": FELT,
    "hard landing": (*FELT, "CTUN", "XKF1", "vehicle_local_position", "navVel"),
    "weak motor": COMMANDS,
    "bent shaft": (*LEVEL, *FELT, "RATE", "gyroUnfilt", "ESC", "eRPM"),
    "mass +20 %": ("CTUN", "vehicle_thrust_setpoint", *COMMANDS, *ESTIMATE),
    "sagging battery": CHARGE,
    "GPS glitch": FIX,
    "loose accelerometer": LEVEL,
    "late yaw": RATES,
    "gains too high": (*RATES, *FELT, "vehicle_torque_setpoint"),
}
"""Fault -> the streams without which nothing in the log shows it; () where the firmware states it."""


def draw_sound(rng: Rng) -> Quadrotor:
    """A sound vehicle: in calm air, in wind, flown lively, a heavy lifter, or one that lands firmly."""
    vehicle = draw_quadrotor(rng)
    way = int(rng.integers(5))
    if way == 1:
        north, east = rng.uniform(5.0, 8.0) * np.array([np.cos(rng.uniform(0.0, 6.28)), 0.6])
        return replace(vehicle, wind_m_s=(float(north), float(east)), gust_m_s=rng.uniform(0.8, 1.3))
    if way == 2:
        return replace(vehicle, lively_rad=rng.uniform(0.35, 0.7))
    if way == 3:
        return replace(
            vehicle,
            bandwidth_rad_s=rng.uniform(18.0, 24.0),
            yaw_rad_s=rng.uniform(6.0, 8.0),
            mass_kg=rng.uniform(8.0, 20.0),
            arm_m=rng.uniform(0.45, 0.7),
            rpm=rng.uniform(3200.0, 4500.0),
            torque_m=rng.uniform(0.04, 0.055),
            cells=int(rng.integers(6, 13)),
            capacity_ah=rng.uniform(16.0, 30.0),
            resistance_ohm=0.012,
            hover=rng.uniform(0.42, 0.55),
        )
    return replace(vehicle, hard_m_s=rng.uniform(0.4, 0.7)) if way == 4 else vehicle
