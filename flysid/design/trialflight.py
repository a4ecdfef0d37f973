"""Trial flights of a position loop on the nonlinear simulated vehicle, which is not the one modelled.

Mass, drag, delay, motors and inner loop are drawn apart from what the inner loop believes and from the
flights that the models were fitted to; the wind turns anew every time. Forward and sideways are flown at
once, the altitude is held alike for every law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.design.law import ComplexArray, Gains, keeping
from flysid.design.rule_plants import RuleLaw, blend, packed_rules
from flysid.design.self_tuning import Tuner, packed_tuners, tuned_gains
from flysid.errors import UsageError
from flysid.ingest.synth.dryden import Wind, wind_field
from flysid.ingest.synth.inner_loop import Axis
from flysid.ingest.synth.quadrotor import INPUTS, ROTORS, STATES, integrate
from flysid.ingest.synth.rigid_body import STEP_S, SimulatedVehicle, fly_vehicle
from flysid.ingest.synth.tuning import linearise

PERIOD_S = 0.02
ALTITUDE_M = 20.0
HELD = 3
"""Numbers that a law keeps from sample to sample, see `steer`."""
AXES = {"x": "theta_in", "y": "phi_in"}
"""Directions of the simulated vehicle, and the inputs that drive it along them."""


@dataclass(frozen=True)
class Doubtful:
    """Ranges from which trial vehicles are drawn, as factors of the nominal one unless units are named."""

    mass: tuple[float, float] = (0.8, 1.2)
    drag: tuple[float, float] = (0.6, 1.4)
    delay_s: tuple[float, float] = (0.02, 0.08)
    inner: tuple[float, float] = (0.85, 1.15)
    damping: tuple[float, float] = (0.8, 1.2)
    motor: tuple[float, float] = (0.7, 1.3)
    wind_m_s: tuple[float, float] = (0.0, 4.0)
    position_noise_m: float = 0.001
    velocity_noise_m_s: float = 0.02

    def __post_init__(self) -> None:
        for name in ("mass", "drag", "delay_s", "inner", "damping", "motor", "wind_m_s"):
            low, high = getattr(self, name)
            if not 0.0 <= low <= high < 100.0:
                raise UsageError(f"trial vehicles with {name} from {low:g} to {high:g}", hint="as 0.8..1.2")


@dataclass(frozen=True)
class Trial:
    """One vehicle in one wind; `seed` fixes turbulence and noise."""

    vehicle: SimulatedVehicle
    wind: Wind
    seed: int

    @classmethod
    def drawn(cls, doubtful: Doubtful, seed: int, number: int) -> Trial:
        """The `number`-th of a seed, whatever else is drawn."""
        rng = np.random.default_rng([seed, number])
        nominal = SimulatedVehicle()
        a = nominal.airframe
        drag = rng.uniform(*doubtful.drag)
        linear = a.linear_drag_1_s
        quadratic = a.quadratic_drag_1_m
        airframe = replace(
            a,
            load=rng.uniform(*doubtful.mass),
            linear_drag_1_s=(drag * linear[0], drag * linear[1], drag * linear[2]),
            quadratic_drag_1_m=(drag * quadratic[0], drag * quadratic[1]),
            motor_lag_s=a.motor_lag_s * rng.uniform(*doubtful.motor),
        )
        loop = replace(
            nominal.loop,
            pitch=_perturb(nominal.loop.pitch, rng, doubtful.inner),
            roll=_perturb(nominal.loop.roll, rng, doubtful.inner),
            attitude_rad_s=nominal.loop.attitude_rad_s * rng.uniform(*doubtful.inner),
            attitude_damping=nominal.loop.attitude_damping * rng.uniform(*doubtful.damping),
        )
        vehicle = SimulatedVehicle(airframe, loop, nominal.effects, rng.uniform(*doubtful.delay_s))
        wind = Wind(rng.uniform(*doubtful.wind_m_s), rng.uniform(0.0, 360.0))
        return cls(vehicle, wind, int(rng.integers(2**31)))


def _perturb(axis: Axis, rng: np.random.Generator, spread: tuple[float, float]) -> Axis:
    """Gain and velocity assist of one axis apart from each other."""
    return replace(axis, gain=axis.gain * rng.uniform(*spread), kp=axis.kp * rng.uniform(*spread))


@dataclass(frozen=True)
class Flown:
    """What one law did on one axis of one trial.

    `ise`: integral of the squared error of position, m^2 s.
    `overshoot`: beyond the first step, as a share of it.
    `settled_s`: until the first step's error stays within 5 %; NaN where it does not before the next step.
    `input_rms`, `moved`: of the input, deg, and its total variation over time, deg/s.
    `saturated`: share of samples with the input at its limit.
    `lost`: the vehicle hit the ground or turned over.
    `blown`: it was more than 25 m away: more wind than the tilt's limit holds.
    """

    ise: float
    overshoot: float
    settled_s: float
    input_rms: float
    moved: float
    saturated: float
    lost: bool
    blown: bool


FIRST_STEPS_S = ((1.0, 11.0), (2.0, 12.0))
"""When the first step of the course begins and ends, by axis."""


def course(*, duration_s: float = 40.0, dt_s: float = PERIOD_S) -> tuple[FloatArray, FloatArray]:
    """(N, 2) commanded place (m) and its speed: 2 m there and back on both axes, then a sine of 1 m, 8 s."""
    time = np.arange(round(duration_s / dt_s)) * dt_s
    place = np.zeros((len(time), 2))
    speed = np.zeros((len(time), 2))
    sine = time >= 24.0
    angle = 2.0 * np.pi * (time[sine] - 24.0) / 8.0
    for axis, first in enumerate((1.0, 2.0)):
        place[(time >= first) & (time < first + 10.0), axis] = 2.0
        place[sine, axis] = np.sin(angle)
        speed[sine, axis] = 2.0 * np.pi / 8.0 * np.cos(angle)
    return place, speed


def fly_trial(
    trial: Trial,
    laws: tuple[Gains, Gains],
    doubtful: Doubtful,
    rules: tuple[RuleLaw | None, RuleLaw | None] = (None, None),
    tuners: tuple[Tuner | None, Tuner | None] = (None, None),
) -> dict[str, Flown]:
    """Fly the course under the laws of x and y; the same noise and wind whatever the laws.

    `rules`: of an axis that gains of rules fly instead of its law.
    `tuners`: of an axis, what sets its law's gains of position and velocity in flight.
    """
    rng = np.random.default_rng(trial.seed)
    place, speed = course()
    noise = rng.standard_normal((len(place), 4))
    noise *= np.array([doubtful.position_noise_m] * 2 + [doubtful.velocity_noise_m_s] * 2)
    air = wind_field(trial.wind, len(place), PERIOD_S, ALTITUDE_M, rng)
    limit = np.degrees(trial.vehicle.loop.tilt_max_rad)
    states, inputs = _fly(
        trial.vehicle.hover(ALTITUDE_M),
        place,
        speed,
        noise,
        air,
        np.array([law.packed() for law in laws]),
        np.array([keeping((law.cut_hz, law.error_hz), PERIOD_S) for law in laws]),
        limit,
        round(trial.vehicle.delay_s / STEP_S),
        trial.vehicle.physics().packed(),
        packed_tuners(tuners),
        *packed_rules(rules),
    )
    away = place - states[:, :2] * np.array([1.0, -1.0])
    lost = bool(
        not np.isfinite(states).all()
        or (states[:, 2] <= 0.0).any()
        or (np.abs(states[:, 6:8]) > 0.5 * np.pi).any()
    )
    return {
        name: judge_flight(away[:, k], inputs[:, k], limit, FIRST_STEPS_S[k], lost)
        for k, name in enumerate(AXES)
    }


def judge_flight(
    away: FloatArray,
    u: FloatArray,
    limit: float,
    step_s: tuple[float, float],
    lost: bool,
    *,
    dt_s: float = PERIOD_S,
    blown_m: float = 25.0,
) -> Flown:
    """What a flight over the course comes to.

    `away`, `u`: (N,) the commanded place less the vehicle's, m, and the input.
    `step_s`: when the first step of 2 m begins and ends.
    """
    first, last = (round(t / dt_s) for t in step_s)
    step = away[first:last] / 2.0
    outside = np.flatnonzero(np.abs(step) > 0.05)
    settled = (outside[-1] + 1) * dt_s if len(outside) and outside[-1] + 1 < len(step) else math.nan
    return Flown(
        float((away**2).sum() * dt_s),
        float(max(0.0, -step.min())),
        settled,
        float(np.sqrt((u**2).mean())),
        float(np.abs(np.diff(u)).sum() / (len(u) * dt_s)),
        float((np.abs(u) >= limit - 1e-9).mean()),
        lost,
        bool((np.abs(away) > blown_m).any()),
    )


@njit(cache=True)
def steer(law, keep, limit, dt_s, away, asked_speed, v, held, first):  # type: ignore[no-untyped-def]
    """The input of one sample by `flysid.design.law`, inside its limit.

    `held` (HELD,) is moved on: the integral, the filtered slope's signal, the filtered error.
    """
    position, velocity, integral, derivative, _, _, on_error, feedforward = law
    asked = asked_speed if feedforward != 0.0 else 0.0
    error = position * away + asked - v
    if not first:
        error = keep[1] * held[2] + (1.0 - keep[1]) * error
    held[2] = error
    seen = error if on_error != 0.0 else -v
    before = seen if first else held[1]
    held[1] = keep[0] * before + (1.0 - keep[0]) * seen
    summed = held[0] + dt_s * error
    u = velocity * error + integral * summed + derivative * (held[1] - before) / dt_s
    u += feedforward * asked
    if abs(u) <= limit or u * error < 0.0:
        held[0] = summed
    return min(max(u, -limit), limit)


@njit(cache=True)
def _fly(x, place, speed, noise, air, laws, keep, limit, late, f, tuners, counts, numbers, sets):  # type: ignore[no-untyped-def]
    """(N, 26) states and (N, 2) inputs in deg; the link holds every command and is `late` ms late."""
    hold = round(PERIOD_S / STEP_S)
    whole = late // hold
    rest = late - whole * hold
    n = len(place)
    states = np.empty((n, STATES))
    inputs = np.zeros((n, 2))
    climb = np.zeros(n)
    row = np.zeros((1, INPUTS))
    scrap = np.empty((1, STATES + ROTORS))
    held = np.zeros((2, HELD))
    seen_by = np.zeros((2, numbers.shape[3]))
    for k in range(n):
        states[k] = x
        sine = math.sin(x[8])
        cosine = math.cos(x[8])
        for axis in range(2):
            sign = 1.0 if axis == 0 else -1.0
            p = sign * x[axis] + noise[k, axis]
            ahead = cosine * x[3] + sine * x[4] if axis == 0 else sine * x[3] - cosine * x[4]
            v = ahead + noise[k, 2 + axis]
            if counts[axis, 0] > 0:
                speeds, sent = counts[axis]
                xi = seen_by[axis]
                for i in range(speeds - 1, 0, -1):
                    xi[i] = xi[i - 1]
                for i in range(speeds + sent - 1, speeds, -1):
                    xi[i] = xi[i - 1]
                xi[0] = v
                xi[speeds] = inputs[k - 1, axis] if k else 0.0
                away = p - place[k, axis]
                xi[speeds + sent] = away
                u = blend(xi, numbers[axis], sets[axis])
                inputs[k, axis] = min(max(u, -limit), limit)
                if abs(u) <= limit or u * away > 0.0:
                    xi[speeds + sent + 1] += PERIOD_S * away
                continue
            own = laws[axis]
            if tuners[axis, 0] > 0.0:
                spring, velocity = tuned_gains(place[k, axis] - p, -v, tuners[axis])
                own = own.copy()
                own[0] = spring / velocity
                own[1] = velocity
            inputs[k, axis] = steer(
                own, keep[axis], limit, PERIOD_S, place[k, axis] - p, speed[k, axis], v, held[axis], k == 0
            )
        climb[k] = ALTITUDE_M - x[2]
        row[0, 4:] = air[k]
        for part in range(2):  # first the older command, then the newer, each as long as it acts
            acts = rest if part == 0 else hold - rest
            at = k - whole - 1 + part
            row[0, 0] = math.radians(inputs[at, 0]) if at >= 0 else 0.0
            row[0, 1] = math.radians(inputs[at, 1]) if at >= 0 else 0.0
            row[0, 2] = climb[at] if at >= 0 else 0.0
            if acts > 0:
                integrate(x, row, f, STEP_S, acts, scrap)
    return states, inputs


def true_plants(
    vehicle: SimulatedVehicle, omega: FloatArray, *, settling_s: float = 10.0
) -> dict[str, ComplexArray]:
    """(F,) what x and y of this very vehicle answer about hover, in still air, with delay and hold."""
    still = np.zeros((round(settling_s / PERIOD_S), 3))
    rest = fly_vehicle(vehicle, still, start=vehicle.hover(ALTITUDE_M)).states[-1]
    held = np.exp(-0.5j * omega * PERIOD_S) * np.sinc(omega * PERIOD_S / (2.0 * np.pi))
    late = np.exp(-1j * omega * vehicle.delay_s) * held
    response = linearise(vehicle, around=rest).response(omega)
    return {name: np.asarray(response[:, k, k] * late) for k, name in enumerate(AXES)}


def held_wind_m_s(vehicle: SimulatedVehicle) -> dict[str, float]:
    """Steady wind along x and y that full tilt just holds, m/s: drag against gravity's share."""
    a = vehicle.airframe
    quadratic = a.quadratic_drag_1_m[0]
    found = {}
    for name, axis, linear in zip(
        AXES, (vehicle.loop.pitch, vehicle.loop.roll), a.linear_drag_1_s, strict=False
    ):
        lean = axis.gain * vehicle.loop.tilt_max_rad
        push = a.gravity_m_s2 * math.tan(lean)
        found[name] = (math.sqrt(linear**2 + 4.0 * quadratic * push) - linear) / (2.0 * quadratic)
    return found
