"""Quadrotors with and without faults, flown in simulation: the truth behind `python -m bench.review_faults`.

A rigid body with four rotors in X, a battery with resistance, wind, and a controller in four loops
(position, velocity, attitude, rate) with filtered gyros. It shares no code with flysid's models and
simulators, and flies all vehicles at once: every array is (flights,) or (flights, 3 or 4).
Axes: forward, right, down; north, east, down. SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from scipy import signal

from flysid.dataset import FloatArray

RATE_HZ = 400.0
SECONDS = 60.0
GRAVITY = 9.81
FORWARD = np.array([1.0, -1.0, 1.0, -1.0]) / np.sqrt(2.0)
RIGHT = np.array([1.0, -1.0, -1.0, 1.0]) / np.sqrt(2.0)
SPIN = np.array([1.0, 1.0, -1.0, -1.0])
"""Places and yaw torques of motors 1 to 4, in the order of ArduPilot's and PX4's quadrotor X."""
EXPO = 0.65
"""Thrust against throttle: (1 - EXPO) t + EXPO t^2, which the controller linearises as both firmwares do."""
GROUND_S, CLIMB_S = 3.0, 5.0
POWER_W_N = 17.0
"""Electrical power of a rotor over its thrust, both at full throttle."""
FULL_CELL_V = 4.15
SLIPS, SLIP_EVERY_S = 3, 6.0
"""How often a motor loses its beat, and after what time again."""
DELAY = 1
"""Periods from a gyro's sample to the motors' command."""
FILTER_HZ, SLOPE_HZ = 60.0, 30.0
INTEGRAL, DAMPING_S = 1.5, 0.012
"""Of the rate loop: the integral's part per second, and the slope's, as parts of the proportional one."""


@dataclass(frozen=True)
class Quadrotor:
    """A vehicle, its controller and its faults.

    Attributes
    ----------
    mass_kg, arm_m : as they are; `heavier` multiplies the mass that `stated_hover` was set for.
    hover : share of full thrust that carries the vehicle without extra mass, at full voltage.
    torque_m : yaw torque over thrust.
    lag_s : of thrust behind its command.
    rpm : of a motor at full throttle and full voltage.
    shake_m_s2 : amplitude of the accelerometer's vibration that a sound motor causes in hover.
    cells, resistance_ohm, capacity_ah : of the battery.
    position, velocity, attitude, bandwidth_rad_s : gains of the outer loops, and crossover of the rate loop.
    yaw_rad_s : crossover of yaw's rate loop.
    wind_m_s, gust_m_s : mean towards north and east, and standard deviation.
    weak, weakness : which motor (0 to 3, -1 for none), and the share of its thrust that it lost.
    propeller : its propeller is at fault, so that it still turns as fast as its command says.
    bent, bent_m_s2 : motor with a bent shaft, and the amplitude of its vibration in hover.
    heavier : mass as it is, over that which the parameters are set for.
    glitch_s, glitch_m : when the GPS jumps, and how far; 0 for never.
    loose_m_s2 : standard deviation of the rattling of the first accelerometer.
    gain : factor on the rate loop's gains in roll and pitch.
    fails_s : when the first motor stops for good; 0 for never.
    browns_s : when the board's supply goes, and the log with it; 0 for never.
    slips_s, slip_s : when the second motor first loses its beat, and for how long each of three times.
    jam_s : when the GPS is jammed, for fifteen seconds; 0 for never.
    drift_s, drift_m_s : when the GPS begins to walk away, and how fast.
    wires : change of the magnetic field per ampere, as a share of the earth's.
    hard_m_s : speed at touch-down; 0 for a soft one.
    incident, incident_s : what the firmware acts on ("battery", "radio", "EKF", "fence"), and when.
    strays_s, strays_rad : when the compass turns, for good, and how far; 0 for never.
    hits_s : when it flies into something; 0 for never.
    lively_rad : how far a pilot leans it to and fro all the time; 0 where it holds its position.
    warns : the board's supply sags before it goes.
    """

    seed: int
    mass_kg: float = 1.6
    arm_m: float = 0.23
    hover: float = 0.42
    torque_m: float = 0.018
    lag_s: float = 0.03
    rpm: float = 9000.0
    shake_m_s2: float = 1.5
    cells: int = 4
    resistance_ohm: float = 0.02
    capacity_ah: float = 5.0
    position: float = 1.0
    velocity: float = 2.2
    attitude: float = 6.0
    bandwidth_rad_s: float = 22.0
    yaw_rad_s: float = 6.0
    wind_m_s: tuple[float, float] = (0.0, 0.0)
    gust_m_s: float = 0.4
    weak: int = -1
    weakness: float = 0.0
    propeller: bool = False
    bent: int = -1
    bent_m_s2: float = 0.0
    heavier: float = 1.0
    glitch_s: float = 0.0
    glitch_m: float = 0.0
    loose_m_s2: float = 0.0
    gain: float = 1.0
    fails_s: float = 0.0
    browns_s: float = 0.0
    slips_s: float = 0.0
    slip_s: float = 0.0
    jam_s: float = 0.0
    drift_s: float = 0.0
    drift_m_s: float = 0.0
    wires: float = 0.0
    hard_m_s: float = 0.0
    incident: str = ""
    incident_s: float = 0.0
    strays_s: float = 0.0
    strays_rad: float = 0.0
    hits_s: float = 0.0
    lively_rad: float = 0.0
    warns: bool = True

    @property
    def hover_a(self) -> float:
        """Current that hovering draws."""
        return float(self.mass_kg * GRAVITY * POWER_W_N * np.sqrt(self.hover) / (3.9 * self.cells))

    @property
    def stated_hover(self) -> float:
        """What the parameter says that hovering takes: as learnt in earlier flights, under load."""
        hover_w = self.mass_kg * GRAVITY * POWER_W_N * np.sqrt(self.hover)
        resting_v = FULL_CELL_V * self.cells
        sag_v = self.resistance_ohm * hover_w / resting_v
        return float(self.hover * (resting_v / (resting_v - sag_v)) ** 2)


@dataclass(frozen=True, eq=False)
class Flight:
    """What one vehicle did: arrays at `RATE_HZ`, by name.

    position, velocity, wanted_position, wanted_velocity : (N, 3)
    attitude, wanted_attitude : (N, 3) roll, pitch, yaw in rad.
    rates, wanted_rates : (N, 3) in rad/s.
    gyro, accel, accel_2 : (N, 3) as the sensors give them.
    gps : (N, 3) position as received, with satellites, hdop, accuracy and jamming, (N,) each.
    thrusts, throttles : (N, 4) commanded shares of full thrust, and linearised.
    rpm : (N, 4)
    wanted_thrust, torques : (N,) and (N, 3) what the controller commands.
    voltage, current, used_ah : (N,)
    """

    vehicle: Quadrotor
    time_s: FloatArray
    columns: dict[str, FloatArray]
    armed_s: tuple[float, float] = field(default=(1.0, SECONDS - 1.0))

    def __getitem__(self, name: str) -> FloatArray:
        return self.columns[name]


def draw_quadrotor(rng: np.random.Generator) -> Quadrotor:
    """A sound vehicle, unlike the others."""
    return Quadrotor(
        seed=int(rng.integers(1 << 40)),
        mass_kg=rng.uniform(1.0, 2.6),
        arm_m=rng.uniform(0.16, 0.30),
        hover=rng.uniform(0.30, 0.50),
        torque_m=rng.uniform(0.014, 0.022),
        lag_s=rng.uniform(0.02, 0.035),
        rpm=rng.uniform(7500.0, 10500.0),
        shake_m_s2=rng.uniform(0.5, 2.5),
        cells=int(rng.integers(3, 7)),
        resistance_ohm=rng.uniform(0.010, 0.022),
        capacity_ah=rng.uniform(4.0, 8.0),
        position=rng.uniform(0.8, 1.1),
        velocity=rng.uniform(1.8, 2.4),
        attitude=rng.uniform(4.5, 6.5),
        bandwidth_rad_s=rng.uniform(26.0, 36.0),
        yaw_rad_s=rng.uniform(9.0, 12.0),
        wind_m_s=(rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0)),
        gust_m_s=rng.uniform(0.2, 0.6),
    )


def move(vehicles: Sequence[Quadrotor]) -> list[Flight]:
    """All vehicles, each on a route of its own."""
    body = _Bodies(vehicles)
    kept: dict[str, list[FloatArray]] = {}
    steps = int(SECONDS * RATE_HZ)
    for i in range(steps):
        for name, value in body.step(i / RATE_HZ).items():
            kept.setdefault(name, []).append(value)
    time_s = np.arange(steps) / RATE_HZ
    tables = {name: np.stack(values, axis=1) for name, values in kept.items()}
    return [Flight(v, time_s, {name: t[i] for name, t in tables.items()}) for i, v in enumerate(vehicles)]


class _Bodies:
    """The state of all vehicles and of their controllers."""

    def __init__(self, vehicles: Sequence[Quadrotor]) -> None:
        n = len(vehicles)
        self.dt = 1.0 / RATE_HZ
        self.rng = [np.random.default_rng(v.seed) for v in vehicles]
        names = [part.name for part in fields(Quadrotor) if part.name != "seed"]
        self.of = {name: np.array([getattr(v, name) for v in vehicles]) for name in names}
        self.mass = self.of["mass_kg"] * self.of["heavier"]
        self.full = self.of["mass_kg"] * GRAVITY / (4.0 * self.of["hover"])
        inertia = 0.12 * self.of["mass_kg"] * (2.0 * self.of["arm_m"]) ** 2
        self.inertia = inertia[:, None] * np.array([1.0, 1.05, 1.8]) * np.sqrt(self.of["heavier"])[:, None]
        torque = 4.0 * self.full * self.of["arm_m"] / np.sqrt(2.0) * 0.5
        self.power = np.stack([torque, torque, 2.0 * self.full * self.of["torque_m"]], axis=1)
        self.effect = np.stack([1.0 + 0.012 * rng.normal(size=4) for rng in self.rng])
        hit = self.of["weak"] >= 0
        self.effect[np.flatnonzero(hit), self.of["weak"][hit]] -= self.of["weakness"][hit]
        self.p, self.v, self.w, self.euler = (np.zeros((n, 3)) for _ in range(4))
        self.spin = np.zeros((n, 4))
        crossover: FloatArray = np.stack([self.of["bandwidth_rad_s"]] * 2 + [self.of["yaw_rad_s"]], axis=1)
        factor = np.stack([self.of["gain"]] * 2 + [np.ones_like(self.of["gain"])], axis=1)
        plant = self.power / (self.inertia / np.sqrt(self.of["heavier"])[:, None])
        self.proportional = factor * crossover / plant
        self.integrating = self.dt * INTEGRAL * crossover * factor / plant
        self.integral, self.lift, self.gust, self.before = (np.zeros((n, 3)) for _ in range(4))
        self.filtered, self.filtered_2, self.slope = (np.zeros((n, 3)) for _ in range(3))
        self.gyros = [np.zeros((n, 3))] * DELAY
        self.used = np.zeros(n)
        self.blow = np.zeros(n)
        self.lying = np.zeros(n, dtype=bool)
        self.voltage = FULL_CELL_V * self.of["cells"]
        self.route = np.stack([_route(rng) for rng in self.rng])
        self.headings = np.stack([_headings(rng) for rng in self.rng])
        self.turning = RATE_HZ * np.diff(self.headings, axis=1, prepend=0.0)
        self.noise = np.stack([rng.normal(size=(int(SECONDS * RATE_HZ), 6)) for rng in self.rng])
        self.tossed = np.stack([_toss(rng) for rng in self.rng])
        self.wanted = np.zeros((n, 3))

    def step(self, time_s: float) -> dict[str, FloatArray]:
        """One period of the fastest loop: control, then motion."""
        i = round(time_s * RATE_HZ)
        flying = time_s >= GROUND_S and time_s < SECONDS - GROUND_S
        noise = self.noise[:, i]
        gain = self.dt * 3.0
        self.wanted += np.clip(self.route[:, i] - self.wanted, -gain, gain)
        velocity = self.of["position"][:, None] * (self.wanted - self.p)
        velocity = np.clip(velocity, -4.0, 4.0)
        error = velocity - self.v
        self.lift += 0.5 * error * self.dt if flying else 0.0
        push = self.of["velocity"][:, None] * error + self.lift
        push[:, :2] = np.clip(push[:, :2], -5.0, 5.0)
        strayed = (self.of["strays_s"] > 0.0) & (time_s >= self.of["strays_s"])
        off = np.where(strayed, self.of["strays_rad"], 0.0)
        believed = self.euler + off[:, None] * np.array([0.0, 0.0, 1.0])
        yaw = believed[:, 2]
        c, s = np.cos(yaw), np.sin(yaw)
        ahead, aside = c * push[:, 0] + s * push[:, 1], -s * push[:, 0] + c * push[:, 1]
        up = np.maximum(GRAVITY - push[:, 2], 2.0)
        turned = (self.headings[:, i] - yaw + np.pi) % (2.0 * np.pi) - np.pi
        leaning = _columns(np.arctan2(aside, up), -np.arctan2(ahead, up), yaw + np.clip(turned, -0.8, 0.8))
        tosses = self.of["lively_rad"] > 0.0
        leaning[tosses, :2] = (self.of["lively_rad"][:, None] * self.tossed[:, i])[tosses]
        rates = self.of["attitude"][:, None] * (leaning - believed)
        rates[:, 2] = self.turning[:, i] + 0.5 * self.of["attitude"] * (leaning[:, 2] - yaw)
        rates[:, 2] = np.clip(rates[:, 2], -1.2, 1.2)
        rates = np.clip(rates, -3.5, 3.5)
        tilt = np.cos(self.euler[:, 0]) * np.cos(self.euler[:, 1])
        lift = self.of["mass_kg"] * up / tilt / (4.0 * self.full)
        self.gyros.append(self.w + 0.004 * noise[:, :3])
        torque = self._rate_loop(rates, self.gyros.pop(0), flying)
        thrusts = self._mix(lift, torque) if flying else np.full((len(self.p), 4), 0.05)
        throttles = (EXPO - 1.0 + np.sqrt((1.0 - EXPO) ** 2 + 4.0 * EXPO * thrusts)) / (2.0 * EXPO)
        failed = (self.of["fails_s"] > 0.0) & (time_s >= self.of["fails_s"])
        self.effect[failed, 0] = 0.0
        late_s = time_s - self.of["slips_s"]
        slips = (self.of["slips_s"] > 0.0) & (late_s >= 0.0) & (late_s < SLIPS * SLIP_EVERY_S)
        slips &= late_s % SLIP_EVERY_S < self.of["slip_s"]
        whole, self.effect[slips, 1] = self.effect[:, 1].copy(), 0.0
        self.blow[:] = 0.0
        self._collide(time_s)
        self._move(throttles, noise, flying)
        self.effect[:, 1] = whole
        self._hit_ground(flying)
        return {
            "position": self.p.copy(),
            "velocity": self.v.copy(),
            "attitude": believed,
            "rates": self.w.copy(),
            "wanted_position": self.wanted.copy(),
            "wanted_velocity": velocity,
            "wanted_attitude": leaning,
            "wanted_rates": rates,
            "thrusts": thrusts,
            "throttles": throttles,
            "turning": self.spin.copy(),
            "voltage": self.voltage,
            "current": self.current,
            "used_ah": self.used.copy(),
            "force": self.force - _columns(0.0 * self.blow, 0.0 * self.blow, self.blow),
            "torques": torque,
            "wanted_thrust": thrusts.mean(axis=1),
        }

    def _collide(self, time_s: float) -> None:
        """Who hits something tumbles, with two propellers broken."""
        now = (self.of["hits_s"] > 0.0) & (np.abs(time_s - self.of["hits_s"]) < 0.5 * self.dt)
        if not now.any():
            return
        self.blow[now] = np.linalg.norm(self.v[now], axis=1) / 0.02 + 80.0
        self.v[now] *= -0.3
        self.w[now] += np.array([9.0, 5.0, 4.0])
        self.effect[now, :2] = 0.15

    def _hit_ground(self, flying: bool) -> None:
        """Who falls on the ground stays there; the blow takes its speed away in 20 ms."""
        hits = ~self.lying & (self.p[:, 2] > 0.3) & (self.v[:, 2] > 2.0) & flying
        self.blow[hits] += self.v[hits, 2] / 0.02
        self.lying |= hits
        self.v[self.lying] = 0.0
        self.w[self.lying] = 0.0

    def _rate_loop(self, rates: FloatArray, gyro: FloatArray, flying: bool) -> FloatArray:
        """Torques as shares of the largest: a PID on a filtered gyro, its slope filtered once more."""
        blend = _blend(FILTER_HZ)
        before = self.filtered_2.copy()
        self.filtered += blend * (gyro - self.filtered)
        self.filtered_2 += blend * (self.filtered - self.filtered_2)
        self.slope += _blend(SLOPE_HZ) * ((self.filtered_2 - before) / self.dt - self.slope)
        error = rates - self.filtered_2
        if flying:
            self.integral += self.integrating * error
        self.integral = np.clip(self.integral, -0.4, 0.4)
        rates_damped = DAMPING_S * np.array([1.0, 1.0, 0.0]) * self.slope
        torque: FloatArray = self.proportional * (error - rates_damped) + self.integral
        return torque

    def _mix(self, lift: FloatArray, torque: FloatArray) -> FloatArray:
        """(n, 4) shares of thrust of the motors."""
        roll = -np.sqrt(2.0) * RIGHT * torque[:, :1]
        pitch = np.sqrt(2.0) * FORWARD * torque[:, 1:2]
        parts = 0.5 * (roll + pitch + SPIN * np.clip(torque[:, 2:], -0.4, 0.4))
        mixed: FloatArray = np.clip(np.clip(lift, 0.08, 0.9)[:, None] + parts, 0.05, 1.0)
        return mixed

    def _move(self, throttles: FloatArray, noise: FloatArray, flying: bool) -> None:
        worn = np.where(self.of["propeller"][:, None], 1.0, np.sqrt(self.effect))
        held = np.where(self.of["propeller"][:, None], self.effect, 1.0)
        strength = (self.voltage / (FULL_CELL_V * self.of["cells"]))[:, None]
        share = np.sqrt((1.0 - EXPO) * throttles + EXPO * throttles**2) * strength * worn
        self.spin += self.dt / self.of["lag_s"][:, None] * (share - self.spin)
        force = self.full[:, None] * self.spin**2 * held
        power = 4.0 * self.full * POWER_W_N
        drawn = (self.spin**3).sum(axis=1) / 4.0 * power + 4.0
        self.current = drawn / self.voltage
        self.used += self.current * self.dt / 3600.0
        left = 1.0 - self.used / self.of["capacity_ah"]
        self.voltage = self.of["cells"] * (3.5 + 0.65 * left) - self.of["resistance_ohm"] * self.current
        arm = self.of["arm_m"][:, None]
        torque = _columns(
            -(force * RIGHT * arm).sum(axis=1),
            (force * FORWARD * arm).sum(axis=1),
            (force * SPIN).sum(axis=1) * self.of["torque_m"],
        )
        wx, wy, wz = self.w.T
        ix, iy, iz = self.inertia.T
        gyroscopic = _columns((iy - iz) * wy * wz, (iz - ix) * wz * wx, (ix - iy) * wx * wy)
        self.gust += (
            self.dt * (-0.5 * self.gust) + np.sqrt(self.dt) * self.of["gust_m_s"][:, None] * noise[:, 3:]
        )
        wind = self.gust.copy()
        wind[:, :2] += self.of["wind_m_s"]
        turn = _turns(self.euler)
        drag = -0.25 * self.mass[:, None] * (self.v - wind) if flying else np.zeros_like(self.v)
        lifted = np.einsum("nij,nj->ni", turn, _columns(0.0 * ix, 0.0 * ix, -force.sum(axis=1)))
        self.force = np.einsum("nji,nj->ni", turn, lifted + drag) / self.mass[:, None]
        if not flying:
            self.force = np.einsum("nji,nj->ni", turn, np.tile([0.0, 0.0, -GRAVITY], (len(self.p), 1)))
            self.v[:] = 0.0
            self.w[:] = 0.0
            return
        self.w += self.dt * (torque + gyroscopic) / self.inertia
        self.v += self.dt * ((lifted + drag) / self.mass[:, None] + np.array([0.0, 0.0, GRAVITY]))
        self.p += self.dt * self.v
        roll, pitch, _ = self.euler.T
        wx, wy, wz = self.w.T
        climb = wy * np.sin(roll) + wz * np.cos(roll)
        change = [wx + climb * np.tan(pitch), wy * np.cos(roll) - wz * np.sin(roll), climb / np.cos(pitch)]
        self.euler = self.euler + self.dt * _columns(*change)
        self.euler[:, :2] = np.clip(self.euler[:, :2], -1.3, 1.3)


def _turns(euler: FloatArray) -> FloatArray:
    """(n, 3, 3) from body to north, east, down."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler).T, np.sin(euler).T
    turn = np.empty((len(euler), 3, 3))
    turn[:, 0] = _columns(cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy)
    turn[:, 1] = _columns(cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy)
    turn[:, 2] = _columns(-sp, sr * cp, cr * cp)
    return turn


def _columns(*parts: FloatArray) -> FloatArray:
    """(n, columns) as `np.stack` along axis 1, at a third of its cost."""
    joined = np.empty((len(parts[0]), len(parts)))
    for column, part in enumerate(parts):
        joined[:, column] = part
    return joined


def _route(rng: np.random.Generator) -> FloatArray:
    """(N, 3) positions to fly to: up, to and fro, and down to the ground."""
    steps = int(SECONDS * RATE_HZ)
    route = np.zeros((steps, 3))
    height = -rng.uniform(4.0, 8.0)
    at = GROUND_S
    place = np.array([0.0, 0.0, height])
    while at < SECONDS - GROUND_S:
        route[int(at * RATE_HZ) :] = place
        at += rng.uniform(3.0, 6.0) if at > GROUND_S else CLIMB_S
        place = np.array([rng.uniform(-6.0, 6.0), rng.uniform(-6.0, 6.0), height + rng.uniform(-1.5, 1.5)])
    return route


def _headings(rng: np.random.Generator) -> FloatArray:
    """(N,) headings to turn to, rad."""
    steps = int(SECONDS * RATE_HZ)
    headings = np.zeros(steps)
    at = GROUND_S + CLIMB_S
    heading = 0.0
    while at < SECONDS - GROUND_S:
        turned = rng.uniform(-1.0, 1.0)
        moving = 1 + int(RATE_HZ * np.pi * np.sqrt(abs(turned)))
        ramp = turned * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, moving)))
        begin = int(at * RATE_HZ)
        headings[begin:] = heading + turned
        headings[begin : begin + len(ramp)] = heading + ramp[: steps - begin]
        heading += turned
        at += rng.uniform(4.0, 7.0)
    return headings


def _toss(rng: np.random.Generator) -> FloatArray:
    """(N, 2) of roll and pitch, -1 to 1: what a pilot leans to, another way every second or so."""
    steps = int(SECONDS * RATE_HZ)
    targets = np.zeros((steps, 2))
    at = GROUND_S + CLIMB_S
    while at < SECONDS - GROUND_S - 2.0:
        targets[int(at * RATE_HZ) :] = rng.uniform(-1.0, 1.0, 2)
        at += rng.uniform(0.4, 1.2)
    targets[int((SECONDS - GROUND_S - 2.0) * RATE_HZ) :] = 0.0
    found: FloatArray = signal.lfilter([0.03], [1.0, -0.97], targets, axis=0)
    return found


def _blend(cutoff_hz: float) -> float:
    """How far a filter of first order moves in one period."""
    turn = 2.0 * np.pi * cutoff_hz / RATE_HZ
    return turn / (1.0 + turn)
