"""Further plants for `ts_plants`: block structures, a servo that integrates, and linear ones.

On the linear ones nothing may be found: one rule is the answer, and it must free-run as well as the linear
side does.
"""

from __future__ import annotations

import numpy as np

from bench.ts_experiment import Experiment, experiment, integrate, multisine, steps
from flysid.dataset import FloatArray

Record = tuple[FloatArray, FloatArray]


def hammerstein(rng: np.random.Generator) -> Experiment:
    """A dead band in front of a second-order lag; three short records, 2 % noise."""
    dt = 0.05
    n = 400

    def f(x: FloatArray, u: float) -> FloatArray:
        push = np.sign(u) * max(abs(u) - 0.3, 0.0)
        return np.array([x[1], 9.0 * (push - x[0]) - 4.0 * x[1]])

    def run() -> Record:
        u = steps(n, (8, 50), rng)
        return u, integrate(f, np.zeros(2), u, dt)[:, 0]

    return experiment([run() for _ in range(3)], [run() for _ in range(2)], dt, 0.02, rng)


def wiener(rng: np.random.Generator) -> Experiment:
    """A sensor that saturates softly behind a second-order lag; three short records, 2 % noise."""
    dt = 0.05
    n = 400

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], 9.0 * (u - x[0]) - 4.0 * x[1]])

    def run() -> Record:
        u = steps(n, (8, 50), rng)
        return u, np.tanh(1.8 * integrate(f, np.zeros(2), u, dt)[:, 0])

    return experiment([run() for _ in range(3)], [run() for _ in range(2)], dt, 0.02, rng)


def servo(rng: np.random.Generator) -> Experiment:
    """An axis at 250 Hz under position control, dry friction; learnt on smooth moves, tried on pulses."""
    return _axis(rng, friction=0.6)


def linear_servo(rng: np.random.Generator) -> Experiment:
    """The same axis with viscous friction alone: linear, and it integrates."""
    return _axis(rng, friction=0.0)


def _axis(rng: np.random.Generator, friction: float) -> Experiment:
    dt = 0.004
    n = 3000

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], (u - 1.5 * x[1] - friction * np.tanh(x[1] / 0.005)) / 0.8])

    def run(goal: FloatArray, bump: FloatArray) -> Record:
        u = np.empty(len(goal))
        y = np.empty(len(goal))
        x = np.zeros(2)
        for k, r in enumerate(goal):
            y[k], u[k] = x[0], np.clip(120.0 * (r - x[0]) - 15.0 * x[1] + bump[k], -10, 10)
            x = integrate(f, x, np.full(2, u[k]), dt, 8)[1]
        return u, y

    goal = np.convolve(0.2 * steps(n + 200, (300, 700), rng), np.full(201, 1 / 201), "valid")
    pulses = np.where(
        np.arange(n) % 500 < 60, 3.0 * np.sign(rng.normal(size=n // 500 + 1)).repeat(500)[:n], 0.0
    )
    return experiment([run(goal, np.zeros(n))], [run(0.5 * goal[::-1], pulses)], dt, 0.001, rng)


def linear_modes(rng: np.random.Generator) -> Experiment:
    """Three lightly damped modes, one short record, little noise: a high order, and linear."""
    dt = 1.0
    n = 512
    modes = ((0.25, 0.05, 1.0), (0.9, 0.03, 0.5), (1.7, 0.03, -0.4))

    def run() -> Record:
        u = multisine(n, dt, (0.01, 0.4), rng)
        y = np.zeros(n)
        for w, damping, gain in modes:

            def f(x: FloatArray, v: float, w: float = w, damping: float = damping) -> FloatArray:
                return np.array([x[1], w * w * (v - x[0]) - 2 * damping * w * x[1]])

            y += gain * integrate(f, np.zeros(2), u, dt, 8)[:, 0]
        return u, y

    return experiment([run()], [run()], dt, 0.01, rng)


def linear_lags(rng: np.random.Generator) -> Experiment:
    """Three lags in a row and a dead time, one short record with 3 % noise."""
    dt = 1.0
    n = 800

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([(u - x[0]) / 4.0, (x[0] - x[1]) / 9.0, (x[1] - x[2]) / 15.0])

    def run() -> Record:
        u = steps(n + 5, (10, 80), rng)
        return u[5:], integrate(f, np.zeros(3), u[:n], dt)[:, 2]

    return experiment([run()], [run()], dt, 0.03, rng)


def linear_noisy(rng: np.random.Generator) -> Experiment:
    """An oscillation behind a lag; two records, 10 % noise."""
    dt = 0.05
    n = 700

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], 16.0 * (u - x[0]) - 1.6 * x[1], (x[0] - x[2]) / 0.7])

    def run() -> Record:
        u = steps(n, (8, 60), rng)
        return u, integrate(f, np.zeros(3), u, dt)[:, 2]

    return experiment([run() for _ in range(2)], [run() for _ in range(2)], dt, 0.10, rng)
