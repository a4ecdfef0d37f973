"""ArduCopter's and PX4's rate and attitude loops once more, and vehicles in them whose margins are known.

Written from the firmwares' sources, and from nothing of flysid: its laws and loops are what this judges. Time
goes in steps of the gyro, which is faster than the controller. Rates are in rad/s, outputs in shares.

Read for ArduCopter: AC_PID.cpp, AC_AttitudeControl.cpp (4.0 to 4.6). For PX4: rate_control.cpp,
VehicleAngularVelocity.cpp, AttitudeControl.cpp, StickYaw.cpp (1.13 to 1.16).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
AXES = ("roll", "pitch", "yaw")
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Loop:
    """One axis of one vehicle.

    Attributes
    ----------
    firmware : arducopter or px4.
    rate_hz, gyro_hz : of the controller, and of the gyro whose filters run before it.
    gain, lag_s, lead_s, damping : k (1 + lead s) / ((s + damping) (lag s + 1)), output to rad/s.
    late : steps of the gyro from the output to the motors.
    gyro_cut_hz : of the second-order low-pass of the gyro.
    p, i, d, ff : gains.
    target_hz, error_hz, slope_hz, output_hz : first-order low-passes; 0 for none.
    angle_p : of the attitude loop, 1/s.
    steers : the stick asks for a rate, as on yaw; else for an angle.
    follows : the heading setpoint follows the measured one while the stick is out of its middle.
    """

    firmware: str
    rate_hz: float
    gyro_hz: float
    gain: float
    lag_s: float
    lead_s: float
    damping: float
    late: int
    gyro_cut_hz: float
    p: float
    i: float
    d: float
    ff: float
    target_hz: float
    error_hz: float
    slope_hz: float
    output_hz: float
    angle_p: float
    steers: bool
    follows: bool

    @property
    def steps(self) -> int:
        """Of the gyro to one of the controller."""
        return round(self.gyro_hz / self.rate_hz)

    def responses(self, f: Floats) -> tuple[Complexes, Complexes, Complexes]:
        """(F,) of the open loop, of the setpoint's way to the output, and of the vehicle.

        The output is held for a step of the controller, which sees every `steps`-th sample of the gyro: each
        frequency has the images of its own that the gyro's rate still carries.
        """
        images = f[None] + self.rate_hz * np.arange(self.steps)[:, None]
        z = np.exp(-1j * TURN * images / self.gyro_hz)
        held = np.sum([z**k for k in range(self.steps)], axis=0)
        fast = held * self._vehicle(z) * second_order(self.gyro_cut_hz, self.gyro_hz, z)
        vehicle = fast.mean(axis=0)
        back = np.exp(-1j * TURN * f / self.rate_hz)
        step_s = 1.0 / self.rate_hz
        out = low_pass(self.output_hz, step_s, back)
        if self.firmware == "px4":  # D is computed at the gyro's rate, I one step late
            slope = self.gyro_hz * (1.0 - z) * low_pass(self.slope_hz, 1.0 / self.gyro_hz, z)
            inside = self.p + self.i * step_s * back / (1.0 - back)
            loop = out * (inside * vehicle + self.d * (slope * fast).mean(axis=0))
            return loop, out * (inside + self.ff), vehicle
        slope = self.rate_hz * (1.0 - back) * low_pass(self.slope_hz, step_s, back)
        inside = self.p + self.i * step_s / (1.0 - back) + self.d * slope
        inside = inside * low_pass(self.error_hz, step_s, back)
        forward = (inside + self.ff) * low_pass(self.target_hz, step_s, back)
        return inside * vehicle, forward, vehicle

    def _vehicle(self, z: Complexes) -> Complexes:
        """(...) from the output to the rate, both at the gyro's rate, as `fly_*` steps it."""
        h = 1.0 / self.gyro_hz
        share = 1.0 - np.exp(-h / self.lag_s)
        torque = share / (1.0 - (1.0 - share) * z)
        torque = torque * (1.0 + self.lead_s * (1.0 - z) / h)
        return np.asarray(
            self.gain * h * z ** (1 + self.late) * torque / (1.0 - (1.0 - self.damping * h) * z)
        )

    def truth(self) -> dict[str, float]:
        """Crossover, margins, peak sensitivity and bandwidth; NaN where there is none below Nyquist."""
        f = np.geomspace(0.05, 0.49 * self.rate_hz, 20_000)
        loop, forward, vehicle = self.responses(f)
        size, phase = np.abs(loop), np.unwrap(np.angle(loop))
        phase -= TURN * np.round((phase[0] + 0.5 * np.pi) / TURN)
        crossing, turning = last_fall(f, size - 1.0), last_fall(f, phase + np.pi)
        answer = np.abs(vehicle * forward / (1.0 + loop))
        margin = float(np.degrees(np.interp(crossing, f, phase))) + 180.0
        return {
            "crossover_hz": crossing,
            "phase_deg": margin,
            "gain_db": float(-20.0 * np.log10(np.interp(turning, f, size))),
            "delay_ms": 1000.0 * margin / (360.0 * crossing),
            "ms": float((1.0 / np.abs(1.0 + loop)).max()),
            "bandwidth_hz": last_fall(f, answer - np.sqrt(0.5)),
        }


def last_fall(f: Floats, values: Floats) -> float:
    """The last frequency at which values fall through zero; NaN without one."""
    falls = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if not len(falls):
        return float("nan")
    k = falls[-1]
    return float(f[k] + (f[k + 1] - f[k]) * values[k] / (values[k] - values[k + 1]))


def share_of(hz: float, step_s: float) -> float:
    """What a first-order low-pass of both firmwares goes of the way in a step; 1 for no filter."""
    return step_s / (step_s + 1.0 / (TURN * hz)) if hz > 0.0 else 1.0


def low_pass(hz: float, step_s: float, back: Complexes) -> Complexes:
    """Its response, from that of one step back."""
    share = share_of(hz, step_s)
    return np.asarray(share / (1.0 - (1.0 - share) * back))


def second_order_numbers(hz: float, rate_hz: float) -> Floats:
    """b0, b1, b2, a1, a2 of a Butterworth low-pass by the bilinear transform."""
    tangent = np.tan(np.pi * hz / rate_hz)
    whole = 1.0 + np.sqrt(2.0) * tangent + tangent**2
    b = tangent**2 / whole
    return np.array(
        [b, 2.0 * b, b, 2.0 * (tangent**2 - 1.0) / whole, (1.0 - np.sqrt(2.0) * tangent + tangent**2) / whole]
    )


def second_order(hz: float, rate_hz: float, z: Complexes) -> Complexes:
    """Its response."""
    b0, b1, b2, a1, a2 = second_order_numbers(hz, rate_hz)
    return np.asarray((b0 + b1 * z + b2 * z * z) / (1.0 + a1 * z + a2 * z * z))


@dataclass(frozen=True)
class Flown:
    """What the firmware logs of one axis, at its controller's steps.

    Attributes
    ----------
    target, rate, output : (N,) rad/s, rad/s, shares.
    angle_target, angle : (N,) rad.
    turn : (N,) rad/s that the stick asks for, 0 where it asks for an angle.
    terms : (5, N) filtered target, filtered error, P, I, D; of PX4 the integral stands for I.
    """

    target: Floats
    rate: Floats
    output: Floats
    angle_target: Floats
    angle: Floats
    turn: Floats
    terms: Floats


def fly(loop: Loop, stick: Floats, gusts: Floats, noise: Floats) -> Flown:
    """One axis of a flight.

    Parameters
    ----------
    stick : (N,) rad or rad/s, at the controller's steps.
    gusts, noise : (N * steps,) shares of the output, and rad/s, at the gyro's.
    """
    h = 1.0 / loop.gyro_hz
    plant = np.array(
        [loop.gain, 1.0 - np.exp(-h / loop.lag_s), loop.lead_s, loop.damping, h, float(loop.late)]
    )
    of_controller = 1.0 / loop.rate_hz
    slope_step = h if loop.firmware == "px4" else of_controller
    law = np.array(
        [
            loop.p,
            loop.i,
            loop.d,
            loop.ff,
            share_of(loop.target_hz, of_controller),
            share_of(loop.error_hz, of_controller),
            share_of(loop.slope_hz, slope_step),
            share_of(loop.output_hz, of_controller),
            loop.angle_p,
        ]
    )
    gyro = second_order_numbers(loop.gyro_cut_hz, loop.gyro_hz)
    step = fly_px4 if loop.firmware == "px4" else fly_arducopter
    rows = step(stick, gusts, noise, loop.steps, plant, law, gyro, loop.steers, loop.follows)
    return Flown(rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6:])


@njit(cache=True)
def move(state, waiting, given, gust, plant, at):  # type: ignore[no-untyped-def]
    """One step of the vehicle: torque, rate, angle; `waiting` is a ring of outputs under way."""
    gain, share, lead, damping, h, late = plant
    n = waiting.size
    waiting[at % n] = given
    acting = waiting[(at - int(late)) % n] + gust
    before = state[0]
    state[0] += share * (acting - state[0])
    state[2] += h * state[1]
    state[1] += h * (gain * (state[0] + lead * (state[0] - before) / h) - damping * state[1])


@njit(cache=True)
def seen(x, gyro, old):  # type: ignore[no-untyped-def]
    """The gyro behind its low-pass."""
    y = gyro[0] * x + old[0]
    old[0] = gyro[1] * x - gyro[3] * y + old[1]
    old[1] = gyro[2] * x - gyro[4] * y
    return y


@njit(cache=True)
def fly_arducopter(stick, gusts, noise, steps, plant, law, gyro, steers, _):  # type: ignore[no-untyped-def]
    """Rows of `Flown`: gyro, rate controller, motors, then the attitude controller for the next step."""
    p, i, d, ff, t_share, e_share, d_share, _, angle_p = law
    n = stick.size
    rows = np.zeros((11, n))
    state, old, waiting = np.zeros(3), np.zeros(2), np.zeros(int(plant[5]) + 1)
    h = plant[4]
    step_s = h * steps
    target = angle_target = shaped = filtered = error = slope = total = rate = 0.0
    for k in range(n):
        for j in range(steps):
            given = rows[2, k - 1] if k > 0 else 0.0
            at = k * steps + j
            move(state, waiting, given, gusts[at], plant, at)
            rate = seen(state[1] + noise[at], gyro, old)
        before = error
        filtered += t_share * (target - filtered)
        error += e_share * (filtered - rate - error)
        slope += d_share * ((error - before) / step_s - slope)
        total += i * error * step_s
        rows[2, k] = p * error + total + d * slope + ff * filtered
        rows[6:, k] = np.array([filtered, error, p * error, total, d * slope])
        wanted = stick[k] if steers else (stick[k] - angle_target) / 0.15  # s, ATC_INPUT_TC
        quickest = 4.7 if steers else 19.2  # rad/s^2, ATC_ACCEL_Y_MAX and ATC_ACCEL_R_MAX
        shaped += min(max(wanted - shaped, -quickest * step_s), quickest * step_s)
        angle_target += shaped * step_s
        target = shaped + angle_p * (angle_target - state[2])
        rows[0, k], rows[1, k] = target, rate
        rows[3, k], rows[4, k], rows[5, k] = angle_target, state[2], stick[k] if steers else 0.0
    return rows


@njit(cache=True)
def fly_px4(stick, gusts, noise, steps, plant, law, gyro, steers, follows):  # type: ignore[no-untyped-def]
    """Rows of `Flown`: the attitude controller runs at every fourth step."""
    p, i, d, ff, _, _, d_share, o_share, angle_p = law
    n = stick.size
    rows = np.zeros((11, n))
    state, old, waiting = np.zeros(3), np.zeros(2), np.zeros(int(plant[5]) + 1)
    h = plant[4]
    step_s = h * steps
    target = heading = slope = total = rate = output = 0.0
    for k in range(n):
        for j in range(steps):
            given = rows[2, k - 1] if k > 0 else 0.0
            at = k * steps + j
            move(state, waiting, given, gusts[at], plant, at)
            before = rate
            rate = seen(state[1] + noise[at], gyro, old)
            slope += d_share * ((rate - before) / h - slope)
        if k % 4 == 0:
            if not steers:
                heading = stick[k]
                target = angle_p * (heading - state[2])
            else:
                heading = state[2] if follows and stick[k] != 0.0 else heading + 4.0 * step_s * stick[k]
                target = stick[k] + angle_p * (heading - state[2])
        error = target - rate
        wanted = p * error + total - d * slope + ff * target
        shrunk = max(0.0, 1.0 - (error / 6.981317) ** 2)  # 400 deg/s
        total += shrunk * i * error * step_s
        output += o_share * (wanted - output)
        rows[0, k], rows[1, k], rows[2, k] = target, rate, output
        rows[3, k], rows[4, k], rows[5, k] = heading, state[2], stick[k] if steers else 0.0
        rows[9, k] = total
    return rows
