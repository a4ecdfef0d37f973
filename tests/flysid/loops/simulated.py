"""Rate loops whose margins are known: a PID at 2 kHz on an integrator with lag and delay, kept at 500 Hz."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit

from flysid.dataset import FloatArray
from flysid.loops.controller import Controller
from flysid.loops.margins import _falls
from flysid.loops.stick_response import ComplexArray, StickRecord

STEP_S = 0.0005
EVERY = 4


@dataclass(frozen=True)
class Vehicle:
    """gain / (s (lag s + 1)) e^(-delay s), from the controller's output to the rate."""

    gain: float = 70.0
    lag_s: float = 0.02
    delay_steps: int = 8

    def response(self, f: FloatArray) -> ComplexArray:
        """Of the steps in which it is simulated."""
        back = np.exp(-2j * np.pi * f * STEP_S)
        keep = np.exp(-STEP_S / self.lag_s)
        turning = (1.0 - keep) / (1.0 - keep * back)
        return np.asarray(self.gain * STEP_S * back ** (1 + self.delay_steps) / (1.0 - back) * turning)


class Answers(Protocol):
    """What has a response from the controller's output to the rate."""

    def response(self, f: FloatArray) -> ComplexArray: ...


class FeedsBack(Protocol):
    """What has a response from the rate to the output, sign turned."""

    def feedback(self, f: FloatArray) -> ComplexArray: ...


PID = Controller({"rollPID P": 46.0}, 1.47, 11.0, 0.013, 0.6, ((1, 100.0), (1, 200.0)))


def fly(
    vehicle: Vehicle,
    controller: Controller,
    seconds: float,
    seed: int,
    *,
    stick: float = 120.0,
    disturbance: float = 40.0,
    noise: float = 2.0,
) -> StickRecord:
    """One flight: flicks of the stick, disturbances of the torque, noise of the gyro."""
    rng = np.random.default_rng(seed)
    n = round(seconds / STEP_S)
    flicks = n // 100 + 1
    held = np.repeat(rng.standard_normal(flicks), rng.integers(100, 900, flicks))[:n]
    box = np.ones(60) / 60.0
    r = stick * np.convolve(np.convolve(held, box, "same"), box, "same")
    d = disturbance * np.convolve(rng.standard_normal(n), np.ones(100) / 10.0, "same")
    cuts = [cut for _, cut in controller.filters]
    numbers = np.array(
        [
            controller.p,
            controller.i,
            controller.d,
            controller.weight or 0.0,
            *cuts,
            vehicle.gain,
            vehicle.lag_s,
        ]
    )
    u, y = _run(r, d, noise * rng.standard_normal(n), numbers, vehicle.delay_steps)
    return StickRecord("simulated", 1.0 / (STEP_S * EVERY), (np.stack([r, u, y])[:, ::EVERY],))


@njit(cache=True)
def _run(r, d, noise, numbers, delay):  # type: ignore[no-untyped-def]
    p, i, kd, weight, cut1, cut2, gain, lag = numbers
    n = r.size
    u = np.zeros(n)
    y = np.zeros(n)
    rate = 0.0
    torque = 0.0
    total = 0.0
    low1 = 0.0
    low2 = 0.0
    before = 0.0
    a1 = 1.0 - np.exp(-2.0 * np.pi * cut1 * STEP_S)
    a2 = 1.0 - np.exp(-2.0 * np.pi * cut2 * STEP_S)
    keep = np.exp(-STEP_S / lag)
    for k in range(n):
        y[k] = rate + noise[k]
        low1 += a1 * (y[k] - low1)
        low2 += a2 * (low1 - low2)
        error = r[k] - y[k]
        total += i * error * STEP_S
        asked = weight * r[k] - low2
        u[k] = p * error + total + kd * (asked - before) / STEP_S
        before = asked
        given = u[k - delay] if k >= delay else 0.0
        torque = keep * torque + (1.0 - keep) * (given + d[k])
        rate += gain * torque * STEP_S
    return u, y


def truth(vehicle: Answers, controller: FeedsBack) -> dict[str, float]:
    """Crossover (Hz), phase margin (deg), gain margin (dB) and Ms of the loop itself."""
    f = np.geomspace(0.5, 200.0, 20_000)
    loop = vehicle.response(f) * controller.feedback(f)
    crossover = _falls(f, np.log(np.abs(loop)))
    turn = np.unwrap(np.angle(loop))
    turn -= 2.0 * np.pi * np.round((turn[0] + np.pi) / (2.0 * np.pi))
    turned = _falls(f, turn + np.pi)
    return {
        "crossover_hz": crossover,
        "phase_deg": 180.0 + float(np.degrees(np.interp(crossover, f, turn))),
        "gain_db": -20.0 * float(np.log10(np.interp(turned, f, np.abs(loop)))),
        "ms": float(np.abs(1.0 / (1.0 + loop)).max()),
    }
