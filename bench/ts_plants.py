"""Nonlinear plants whose truth is known, for developing the TS estimator without touching a test set.

`python -m bench.ts_plants [NAME...] [--seeds 3]` fits the defaults of ARX and TS to noisy records and
prints the free-run error against the noise-free output of fresh ones, in per cent of its spread, beside the
noise in the training records. A perfect model reads near 0, the mean reads 100.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from bench import ts_more_plants as more
from bench.ts_experiment import Experiment, experiment, integrate, multisine, off, print_lines, steps
from flysid.dataset import FloatArray
from flysid.model.arx import ARX
from flysid.model.base import Estimator
from flysid.model.statespace import StateSpace
from flysid.model.ts import TS


def duffing(rng: np.random.Generator, hardening: float = 0.06) -> Experiment:
    """An oscillator with a hardening spring; of the tests one is a little weaker, one stronger."""
    dt = 1 / 600
    n = 6000

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], 1.6e5 * (u - x[0] - hardening * x[0] ** 3) - 25.0 * x[1]])

    def run(amplitude: float) -> tuple[FloatArray, FloatArray]:
        u = amplitude * multisine(n, dt, (1.0, 150.0), rng)
        return u, integrate(f, np.zeros(2), u, dt)[:, 0]

    return experiment([run(0.15)], [run(0.13), run(0.18)], dt, 0.005, rng)


def stiff(rng: np.random.Generator) -> Experiment:
    """The same oscillator, so hard a spring that a linear model explains next to nothing."""
    return duffing(rng, 0.6)


def tanks(rng: np.random.Generator) -> Experiment:
    """Two tanks in cascade; the upper one flows over, partly into the lower one. One short record."""
    dt = 4.0
    n = 1024

    def f(x: FloatArray, u: float) -> FloatArray:
        x = np.maximum(x, 0.0)
        over = max(x[0] - 10.0, 0.0)
        first = -0.05 * np.sqrt(x[0]) + 0.042 * max(u, 0.0) - 0.2 * over
        return np.array([first, 0.05 * np.sqrt(x[0]) + 0.1 * over - 0.05 * np.sqrt(x[1])])

    def run() -> tuple[FloatArray, FloatArray]:
        u = 2.8 + 1.3 * multisine(n, dt, (1e-4, 0.0144), rng)
        return u, np.minimum(integrate(f, np.array([4.0, 4.0]), u, dt)[:, 1], 10.0)

    return experiment([run()], [run()], dt, 0.02, rng)


def cart(rng: np.random.Generator) -> Experiment:
    """A cart with viscous and dry friction under position control: force to position, which integrates."""
    dt = 0.01

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], (u - 2.0 * x[1] - 2.0 * np.tanh(x[1] / 0.01)) / 1.0])

    def run(goal: FloatArray) -> tuple[FloatArray, FloatArray]:
        u = np.empty(len(goal))
        y = np.empty(len(goal))
        x = np.zeros(2)
        for k, r in enumerate(goal):
            y[k], u[k] = x[0], np.clip(60.0 * (r - x[0]) - 12.0 * x[1], -10, 10)
            x = integrate(f, x, np.full(2, u[k]), dt, 8)[1]
        return u, y

    n = 2500
    smooth = np.convolve(0.25 * steps(n + 40, (60, 200), rng), np.full(41, 1 / 41), "valid")
    other = 0.12 * multisine(n, dt, (0.1, 1.0), rng)
    return experiment([run(smooth)], [run(other)], dt, 0.001, rng)


def propeller(rng: np.random.Generator) -> Experiment:
    """A rotor on a hinged arm in closed loop: quadratic thrust with a lag, gravity; steps and a sweep."""
    dt = 0.05

    def f(x: FloatArray, u: float) -> FloatArray:
        lift = 0.06 * x[2] * abs(x[2])
        return np.array(
            [x[1], lift - 9.0 * np.sin(x[0]) - 1.2 * x[1] - 0.8 * np.tanh(x[1] / 0.1), (u - x[2]) / 0.15]
        )

    def run(goal: FloatArray) -> tuple[FloatArray, FloatArray]:
        u = np.empty(len(goal))
        y = np.empty(len(goal))
        x = np.array([0.0, 0.0, 2.0])
        total = 0.0
        for k, r in enumerate(goal):
            miss = r - x[0]
            total = float(np.clip(total + 3.0 * dt * miss, -12, 12))
            y[k], u[k] = np.degrees(x[0]), np.clip(4.0 + 3.0 * miss + total - 1.5 * x[1], 0.0, 15.0)
            x = integrate(f, x, np.full(2, u[k]), dt)[1]
        return u, y

    n = 1600
    t = np.arange(n) * dt
    level = np.radians(25 + 25 * steps(n, (80, 160), rng))
    sweep = np.radians(25 + 15 * np.sin(2 * np.pi * (0.05 * t + 0.45 / (2 * t[-1]) * t * t)))
    fresh = np.radians(25 + 10 * multisine(n, dt, (0.02, 0.4), rng))
    return experiment([run(level), run(sweep)], [run(fresh)], dt, 0.01, rng)


def drone(rng: np.random.Generator) -> Experiment:
    """Pitch command to speed: attitude lag, quadratic drag, four flights at 50 Hz."""
    dt = 0.02
    n = 1500

    def f(x: FloatArray, u: float) -> FloatArray:
        push = 9.81 * np.tan(x[1])
        return np.array([push - 0.15 * x[0] - 0.06 * x[0] * abs(x[0]), x[2], 60.0 * (u - x[1]) - 10.0 * x[2]])

    def run() -> tuple[FloatArray, FloatArray]:
        u = np.radians(14.0) * steps(n, (50, 220), rng)
        return u, integrate(f, np.zeros(3), u, dt)[:, 0]

    return experiment([run() for _ in range(4)], [run() for _ in range(2)], dt, 0.01, rng)


def saturated(rng: np.random.Generator) -> Experiment:
    """A saturating actuator in front of second-order dynamics, four records, a good deal of noise."""
    dt = 0.05
    n = 600

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], 4.0 * (np.tanh(2.0 * u) - x[0]) - 2.0 * x[1]])

    def run() -> tuple[FloatArray, FloatArray]:
        u = steps(n, (8, 60), rng)
        return u, integrate(f, np.zeros(2), u, dt)[:, 0]

    return experiment([run() for _ in range(4)], [run() for _ in range(2)], dt, 0.05, rng)


def arm(rng: np.random.Generator) -> Experiment:
    """A lightly damped flexible arm whose first mode's damping grows with speed; a short record."""
    dt = 1.0
    n = 512

    def f(x: FloatArray, u: float) -> FloatArray:
        drag = 0.05 * x[1] + 1.5 * x[1] * abs(x[1])
        return np.array([x[1], u - 0.12 * x[0] - drag, x[3], 0.6 * u - 0.9 * x[2] - 0.1 * x[3]])

    def run() -> tuple[FloatArray, FloatArray]:
        u = 0.15 * multisine(n, dt, (0.01, 0.25), rng)
        x = integrate(f, np.zeros(4), u, dt)
        return u, x[:, 0] + 0.3 * x[:, 2]

    return experiment([run()], [run()], dt, 0.01, rng)


def linear(rng: np.random.Generator) -> Experiment:
    """Nothing to find: a linear second-order lag with noise, four records."""
    dt = 0.05
    n = 600

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], 4.0 * (u - x[0]) - 2.0 * x[1]])

    def run() -> tuple[FloatArray, FloatArray]:
        u = steps(n, (8, 60), rng)
        return u, integrate(f, np.zeros(2), u, dt)[:, 0]

    return experiment([run() for _ in range(4)], [run() for _ in range(2)], dt, 0.05, rng)


PLANTS: dict[str, Callable[[np.random.Generator], Experiment]] = {
    "linear": linear,
    "saturated": saturated,
    "drone": drone,
    "propeller": propeller,
    "duffing": duffing,
    "stiff": stiff,
    "tanks": tanks,
    "arm": arm,
    "cart": cart,
    "hammerstein": more.hammerstein,
    "wiener": more.wiener,
    "servo": more.servo,
    "linear servo": more.linear_servo,
    "linear modes": more.linear_modes,
    "linear lags": more.linear_lags,
    "linear noisy": more.linear_noisy,
}


def line(name: str, seed: int) -> str:
    """What the defaults of linear and fuzzy models make of one plant."""
    plant = PLANTS[name](np.random.default_rng(seed))
    cells = [f"{name:12s} {seed} noise {100 * plant.noise:5.2f}"]
    estimators: list[tuple[str, Estimator]] = [("ARX", ARX()), ("SS", StateSpace()), ("TS", TS())]
    for title, estimator in estimators:
        begin = time.process_time()
        model = estimator.fit(plant.train)
        seconds = time.process_time() - begin
        cells.append(
            f"{title} {off(model, plant.test):7.3f} ({len(model.rules())} rules, "
            f"{model.n_parameters:3d} par, {seconds:5.1f} s)"
        )
    return "  ".join(cells)


def main() -> None:
    """Print a line per plant and seed."""
    print_lines(__doc__, PLANTS, line, 2)


if __name__ == "__main__":
    main()
