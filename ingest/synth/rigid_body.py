"""An AR.Drone 2.0: parameters with their sources, effects that can be switched, and flights of it.

The paper's rigid body, equations (8) and (9), rests on its assumptions: body and blades rigid; no fuselage
drag; no gyroscopic torque; no ground effect; symmetric. `PAPER` keeps them all; `ALL` drops all but the first
and the last. The compiled equations are in `quadrotor`; the inner loop's gains come from `inner_loop`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.ingest.synth.inner_loop import InnerLoop
from flysid.ingest.synth.plants import LOOPS
from flysid.ingest.synth.quadrotor import INPUTS, ROTORS, STATES, Physics, integrate, rates

STEP_S = 0.001
NAMES = ("x", "y", "z", "vx", "vy", "vz", "phi", "theta", "psi", "p", "q", "r")


@dataclass(frozen=True)
class Airframe:
    """Parameters of an AR.Drone 2.0, SI units.

    Mass, arm, inertias, thrust and torque factors and rotor inertia: Q. Li, Grey-Box System Identification of
    a Quadrotor Unmanned Aerial Vehicle, MSc thesis, TU Delft (2014), as quoted throughout the AR.Drone
    literature. Rotor speeds: Parrot's data sheet (motors 10,350 to 41,400 rpm) over the gear of 8.625. Rotor
    radius and 1,000 mAh at 11.1 V: the same sheet; endurance 12 min. Assumed, of the usual size for a vehicle
    of this class: motor lag, drag (Faessler et al., 2018, find 0.2 to 0.5 1/s of blade drag), voltage
    droop, transport delay of the Wi-Fi link.

    `load`, `lift` and `rotor_1` are faults: true mass over the mass that the inner loop knows, and the thrust
    of all rotors, and of the front one beside, over what their speed should give.
    """

    mass_kg: float = 0.429
    arm_m: float = 0.1785
    inertia_kg_m2: tuple[float, float, float] = (2.237568e-3, 2.985236e-3, 4.80374e-3)
    thrust_factor: float = 8.048e-6
    torque_factor: float = 2.423e-7
    rotor_inertia_kg_m2: float = 2.029585e-5
    rotor_radius_m: float = 0.1
    rotor_limits_rad_s: tuple[float, float] = (125.7, 502.6)
    motor_lag_s: float = 0.03
    linear_drag_1_s: tuple[float, float, float] = (0.30, 0.30, 0.15)
    quadratic_drag_1_m: tuple[float, float] = (0.12, 0.10)
    endurance_s: float = 720.0
    sag: float = 0.10
    droop: float = 0.03
    gravity_m_s2: float = 9.81
    load: float = 1.0
    lift: float = 1.0
    rotor_1: float = 1.0

    @property
    def hover_rad_s(self) -> float:
        """Rotor speed at which four rotors carry the weight."""
        return float(np.sqrt(self.mass_kg * self.gravity_m_s2 / (4.0 * self.thrust_factor)))


@dataclass(frozen=True)
class Effects:
    """What the paper leaves out; each can be switched off."""

    motor_lag: bool = True
    motor_limits: bool = True
    linear_drag: bool = True
    quadratic_drag: bool = True
    ground_effect: bool = True
    battery_sag: bool = True
    gyroscopic: bool = True
    altitude_drop: bool = True
    delay: bool = True
    command_limits: bool = True


ALL = Effects()
PAPER = Effects(**{f.name: False for f in fields(Effects)})


@dataclass(frozen=True)
class SimulatedVehicle:
    """An airframe, its inner loop and the effects that act on it.

    `delay_s` is the age of a command when it acts (`Effects.delay`).
    """

    airframe: Airframe = field(default_factory=Airframe)
    loop: InnerLoop = field(default_factory=InnerLoop)
    effects: Effects = ALL
    delay_s: float = 0.04

    def physics(self) -> Physics:
        """The numbers of the compiled equations."""
        return Physics(**_body(self.airframe, self.effects), **_power(self.airframe, self.effects),
                       **_control(self.loop, self.effects))  # fmt: skip

    def hover(self, altitude_m: float = 20.0) -> FloatArray:
        """(26,) the state of rest at an altitude."""
        x = np.zeros(STATES)
        x[2] = altitude_m
        x[12:16] = self.airframe.hover_rad_s
        return x


def _body(a: Airframe, on: Effects) -> dict[str, float]:
    ixx, iyy, izz = a.inertia_kg_m2
    drag = a.linear_drag_1_s if on.linear_drag else (0.0, 0.0, 0.0)
    quad = a.quadratic_drag_1_m if on.quadratic_drag else (0.0, 0.0)
    return {
        "m": a.mass_kg, "load": a.load, "lift": a.lift, "rotor_1": a.rotor_1, "g": a.gravity_m_s2,
        "l": a.arm_m,
        "ixx": ixx, "iyy": iyy, "izz": izz,
        "k_f": a.thrust_factor, "k_m": a.torque_factor,
        "drag_x": drag[0], "drag_y": drag[1], "drag_z": drag[2], "quad_xy": quad[0], "quad_z": quad[1],
        "gyro": float(on.gyroscopic), "j_rotor": a.rotor_inertia_kg_m2,
        "ground_radius": a.rotor_radius_m if on.ground_effect else 0.0,
    }  # fmt: skip


def _power(a: Airframe, on: Effects) -> dict[str, float]:
    low, high = a.rotor_limits_rad_s if on.motor_limits else (0.0, np.inf)
    return {
        "motor_tau": a.motor_lag_s if on.motor_lag else 0.0, "rotor_min": low, "rotor_max": float(high),
        "drain": 1.0 / a.endurance_s, "sag": a.sag if on.battery_sag else 0.0,
        "droop": a.droop if on.battery_sag else 0.0, "rotor_hover": a.hover_rad_s,
    }  # fmt: skip


def _control(c: InnerLoop, on: Effects) -> dict[str, float]:
    limits = (c.tilt_max_rad, c.climb_max_m_s) if on.command_limits else (np.inf, np.inf)
    climb = LOOPS["vertical"]
    c2, c1, c0 = climb.numerator
    _, a3, a2, a1, a0 = climb.denominator
    axes = {
        f"{name}_{key}": value
        for name, axis in (("pitch", c.pitch), ("roll", c.roll))
        for key, value in (("gain", axis.gain), ("tau", axis.lag_s), ("kp", axis.kp), ("ki", axis.ki),
                           ("leak", axis.leak_1_s))
    }  # fmt: skip
    return {
        **axes, "tilt_max": float(limits[0]), "climb_max": float(limits[1]),
        "tilt_hold": 0.0 if on.altitude_drop else 1.0, "assist_max": c.assist_max_rad,
        "att_w": c.attitude_rad_s, "att_z": c.attitude_damping, "yaw_k": c.yaw_1_s, "climb_kp": c.climb_kp,
        "climb_ki": c.climb_ki, "climb_i_max": c.climb_i_max, "climb_lead": c.climb_lead_s,
        "c0": c0, "c1": c1, "c2": c2, "a0": a0, "a1": a1, "a2": a2, "a3": a3,
    }  # fmt: skip


def closed_loop_rates(x: FloatArray, u: FloatArray, physics: Physics | np.void) -> FloatArray:
    """(26,) time derivative of vehicle and inner loop; states and inputs in `quadrotor`'s order."""
    out = np.empty(STATES + ROTORS)
    rates(x, u, physics.packed() if isinstance(physics, Physics) else physics, out)
    return out[:STATES]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States (N, 26) at a fixed period from t = 0; `series` gives them in the paper's signs and units.

    `told` (N, 4) are the commanded motor speeds, rad/s. thrust is the rotors' lift over that of
    hover; throttle, and the torques roll_effort (right side down), pitch_effort (nose up) and yaw_effort (to
    the right), are what the inner loop asks of the rotors, in the thrust of hover.
    """

    dt_s: float
    states: FloatArray
    hover_rad_s: float
    told: FloatArray

    def series(self) -> Mapping[str, FloatArray]:
        """vx, vy (right), vz (m/s) along the heading, x, y, z (m), angles (deg), rates (deg/s), efforts."""
        s = self.states
        front, left, rear, starboard = (self.told**2 / self.hover_rad_s**2).T
        heading = s[:, 8]
        ahead = np.cos(heading) * s[:, 3] + np.sin(heading) * s[:, 4]
        right = np.sin(heading) * s[:, 3] - np.cos(heading) * s[:, 4]
        angles = {name: np.degrees(s[:, NAMES.index(name)]) for name in ("phi", "theta", "p", "q", "r")}
        return {
            "vx": ahead, "vy": right, "vz": s[:, 5], "x": s[:, 0], "y": -s[:, 1], "z": s[:, 2],
            "psi": -np.degrees(heading), **angles,
            "thrust": np.mean(s[:, 12:16] ** 2, axis=1) / self.hover_rad_s**2,
            "throttle": (front + left + rear + starboard) / 4.0, "roll_effort": (left - starboard) / 2.0,
            "pitch_effort": (front - rear) / 2.0, "yaw_effort": (left + starboard - front - rear) / 4.0,
        }  # fmt: skip


def fly_vehicle(
    vehicle: SimulatedVehicle,
    commands: npt.ArrayLike,
    *,
    period_s: float = 0.02,
    record_s: float = 0.02,
    wind_m_s: npt.ArrayLike | None = None,
    start: FloatArray | None = None,
    fault: tuple[float, SimulatedVehicle] | None = None,
    step_s: float = STEP_S,
) -> Trajectory:
    """Fly commands that are held for `period_s` each.

    `commands`: (N, 3) or (N, 4) theta_in, phi_in (deg), vz_in (m/s), and yaw rate (deg/s, to the right).
    `period_s`, `record_s`: whole steps; the record must divide the flight.
    `wind_m_s`: (N, 3) of the air, world axes x forward, y left, z up; held alike. Still air when None.
    `start`: (26,) first state; hover at 20 m when None.
    `fault`: a time in seconds, a whole number of records, and the vehicle that this one is from then on.
    `step_s`: of the integration; four times as long is four times as fast, for fleets.
    Raises UsageError: shapes or periods do not fit. Raises DataError: the flight hit the ground or was lost.
    """
    inputs = _inputs(vehicle, np.asarray(commands, dtype=np.float64), wind_m_s, period_s)
    hold = round(period_s / step_s)
    every = round(record_s / step_s)
    if hold < 1 or every < 1 or len(inputs) * hold % every:
        raise UsageError(
            f"a record every {record_s:g} s does not divide a flight of {len(inputs) * period_s:g} s"
        )
    record = np.empty((len(inputs) * hold // every, STATES + ROTORS))
    x = vehicle.hover() if start is None else np.array(start, dtype=np.float64)
    row = len(record) if fault is None else round(fault[0] / record_s)
    at = row * every // hold
    integrate(x, inputs[:at], vehicle.physics().packed(), step_s, hold, record[:row])
    if fault is not None:
        integrate(x, inputs[at:], fault[1].physics().packed(), step_s, hold, record[row:])
    _check(record, record_s)
    return Trajectory(record_s, record[:, :STATES], vehicle.airframe.hover_rad_s, record[:, STATES:])


def _inputs(
    vehicle: SimulatedVehicle, commands: FloatArray, wind_m_s: npt.ArrayLike | None, period_s: float
) -> FloatArray:
    """(N, 7) inputs in SI units and world signs, the commands as late as the link makes them."""
    if commands.ndim != 2 or commands.shape[1] not in (3, 4) or not np.isfinite(commands).all():
        raise UsageError(f"commands must be finite and (N, 3) or (N, 4), not {commands.shape}")
    inputs = np.zeros((len(commands), INPUTS))
    late = round(vehicle.delay_s / period_s) if vehicle.effects.delay else 0
    acting = np.zeros_like(commands)
    acting[late:] = commands[: len(commands) - late]
    inputs[:, :2] = np.radians(acting[:, :2])
    inputs[:, 2] = acting[:, 2]
    if commands.shape[1] == 4:
        inputs[:, 3] = -np.radians(acting[:, 3])
    if wind_m_s is not None:
        inputs[:, 4:] = np.asarray(wind_m_s, dtype=np.float64)
    return inputs


def _check(record: FloatArray, record_s: float) -> None:
    """Raise DataError where a flight met the ground or left the model's range."""
    bad = ~np.isfinite(record).all(axis=1) | (record[:, 2] <= 0.0) | (np.abs(record[:, 6]) > 1.5)
    if bad.any():
        at = float(np.argmax(bad)) * record_s
        raise DataError("the simulated vehicle hit the ground or was lost", flight_time_s=at,
                        hint="gentler commands, or more altitude")  # fmt: skip
