"""Kinds of plants that TS was not developed on: `python -m bench.ts_unknown_plants [NAME...]`.

After published benchmarks and textbook examples. The defaults are fitted as `flysid fit` does it: dead times
found in the log, the baseline the best linear model by validation. A line each: both free-run errors against
the noise-free output of fresh records, in per cent of its spread, beside the noise in the training records.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import cheby1, cheby2, lfilter

from bench.ts_experiment import Experiment, experiment, integrate, multisine, off, print_lines, steps
from flysid.dataset import FloatArray
from flysid.errors import FlysidError
from flysid.ingest.excitation.dead_time import dead_times, delays_to_try, least_delays
from flysid.model.base import Fitted
from flysid.model.linear_choice import choose_baseline, confirm
from flysid.model.one_rule import linear_rivals
from flysid.model.ts import TS

Record = tuple[FloatArray, FloatArray]
Recorder = Callable[[], Record]


def _records(run: Recorder, dt: float, noise: float, rng: np.random.Generator, train: int = 1) -> Experiment:
    return experiment([run() for _ in range(train)], [run(), run()], dt, noise, rng)


def diode(rng: np.random.Generator) -> Experiment:
    """Wiener-Hammerstein: a diode-like saturation between two third-order filters (Schoukens 2009)."""
    first = cheby1(3, 0.5, 2 * 4.4 / 51.2)
    second = cheby2(3, 40, 2 * 5.0 / 51.2)
    shaping = cheby1(4, 0.5, 2 * 10.0 / 51.2)

    def run() -> Record:
        u = lfilter(*shaping, rng.normal(size=6000))
        x = lfilter(*first, u)
        x = np.where(x < 0.3, x, 0.3 + 0.15 * np.tanh((x - 0.3) / 0.15))
        return u, np.asarray(lfilter(*second, x))

    return _records(run, 1 / 51200, 0.005, rng)


def drives(rng: np.random.Generator) -> Experiment:
    """Coupled electric drives: the sensor gives the absolute value of a speed (Wigren 2017)."""
    dt = 0.02
    n = 500

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], 120.0 * (x[2] - x[0]) - 3.0 * x[1], (u - x[2]) / 0.6])

    def run() -> Record:
        u = np.sign(steps(n, (5, 60), rng)) * (0.5 + np.abs(steps(n, (5, 60), rng)))
        return u, np.abs(integrate(f, np.zeros(3), u, dt)[:, 0])

    return _records(run, dt, 0.02, rng)


def ph(rng: np.random.Generator) -> Experiment:
    """Neutralisation of an acid by a base in a stirred tank (Henson and Seborg, 1994)."""
    dt = 15.0
    n = 1500
    k1 = 10**-6.35
    k2 = 10**-10.25

    def run() -> Record:
        u = 15.6 + 3.0 * steps(n, (10, 60), rng)
        wa = -4.32e-4
        wb = 5.28e-4
        y = np.empty(n)
        low = 0.0
        high = 14.0
        for k in range(n):
            low = 1.0
            high = 13.0
            for _ in range(40):
                p = 0.5 * (low + high)
                h = 10.0**-p
                share = (h * k1 + 2 * k1 * k2) / (h * h + h * k1 + k1 * k2)
                low, high = (p, high) if wa + 1e-14 / h - h + wb * share < 0 else (low, p)
            y[k] = 0.5 * (low + high)
            for _ in range(4):
                flow = (16.6, 0.55, u[k])
                a = (3e-3, -3e-2, -3.05e-3)
                b = (0.0, 3e-2, 5e-5)
                wa += dt / 4 * sum(q * (c - wa) for q, c in zip(flow, a, strict=True)) / 2900.0
                wb += dt / 4 * sum(q * (c - wb) for q, c in zip(flow, b, strict=True)) / 2900.0
        return u, y

    return _records(run, dt, 0.02, rng)


def exchanger(rng: np.random.Generator) -> Experiment:
    """Flow to temperature: gain and time constant fall with flow; the inlet drifts slowly."""
    dt = 1.0
    n = 4000

    def run() -> Record:
        u = 0.4 + 0.3 * steps(n, (30, 150), rng)
        drift = 1.5 * lfilter([0.002], [1, -0.998], rng.normal(size=n)) / 0.0316

        def f(x: FloatArray, v: float) -> FloatArray:
            return np.array([0.15 * v * (30.0 - x[0]) + 0.05 * (90.0 - x[0]), (x[0] - x[1]) / 8.0])

        return u, integrate(f, np.array([50.0, 50.0]), u, dt, 2)[:, 1] + drift

    return _records(run, dt, 0.02, rng)


def bouc_wen(rng: np.random.Generator) -> Experiment:
    """The Bouc-Wen benchmark of hysteresis (Noel and Schoukens, 2016), one period of a multisine."""
    dt = 1 / 750
    n = 4096

    def f(x: FloatArray, u: float) -> FloatArray:
        y, v, z = x
        turn = 5e4 * v - 1e3 * (0.8 * abs(v) * z - 1.1 * v * abs(z))
        return np.array([v, (u - 10.0 * v - 5e4 * y - z) / 2.0, turn])

    def run() -> Record:
        u = 50.0 * multisine(n, dt, (5.0, 150.0), rng)
        return u, integrate(f, np.zeros(3), u, dt, 8)[:, 0]

    return _records(run, dt, 0.005, rng)


def van_der_pol(rng: np.random.Generator) -> Experiment:
    """An oscillation that keeps itself going, pushed by an input: no free run forgets its phase for long."""
    dt = 0.1
    n = 2000

    def f(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], (1.0 - x[0] ** 2) * x[1] - x[0] + u])

    def run() -> Record:
        u = 1.5 * steps(n, (10, 60), rng)
        return u, integrate(f, np.array([1.0, 0.0]), u, dt)[:, 0]

    return _records(run, dt, 0.01, rng)


def _narendra(
    step: Callable[[float, float, float], float], size: float
) -> Callable[[np.random.Generator], Experiment]:
    """y(k + 1) = step(y(k), y(k - 1), u(k)), after Narendra and Parthasarathy (1990).

    Learnt from inputs like noise, tried on their sines and on steps: far from the training data.
    """

    def plant(rng: np.random.Generator) -> Experiment:
        def answer(shape: FloatArray) -> Record:
            u = size * shape
            y = np.zeros(len(u))
            for k in range(2, len(u) - 1):
                y[k + 1] = step(y[k], y[k - 1], u[k])
            return u, y

        k = np.arange(800)
        slow = np.sin(2 * np.pi * k / 250)
        fast = np.sin(2 * np.pi * k / 25)
        train = rng.uniform(-1.0, 1.0, 1200)
        tests = [np.where(k < 400, slow, 0.8 * slow + 0.2 * fast), steps(800, (5, 40), rng)]
        return experiment([answer(train)], [answer(u) for u in tests], 1.0, 0.02, rng)

    return plant


def roll(rng: np.random.Generator) -> Experiment:
    """Fixed wing: aileron to roll rate, L_p growing with airspeed, L_da with its square; two inputs."""
    dt = 0.02
    n = 1500

    def run() -> Record:
        aileron = np.radians(10.0) * steps(n, (15, 80), rng)
        speed = 20.0 + 8.0 * np.convolve(steps(n + 100, (200, 400), rng), np.full(101, 1 / 101), "valid")
        p = 0.0
        y = np.empty(n)
        for k in range(n):
            y[k] = p
            for _ in range(4):
                p += dt / 4 * (-0.25 * speed[k] * p + 0.12 * speed[k] ** 2 * aileron[k])
        return np.column_stack([aileron, speed]), y

    return _records(run, dt, 0.03, rng, 4)


def quadruple(rng: np.random.Generator) -> Experiment:
    """Two inputs, two outputs, coupled: four tanks (Johansson, 2000)."""
    dt = 3.0
    n = 2500

    def run() -> Record:
        u = 3.0 + 2.0 * np.column_stack([steps(n, (20, 100), rng), steps(n, (20, 100), rng)])
        x = np.array([12.0, 12.0, 2.0, 2.0])
        y = np.empty((n, 2))
        for k in range(n):
            y[k] = 0.5 * x[:2]
            for _ in range(4):
                out = np.array([0.071, 0.057, 0.071, 0.057]) * np.sqrt(2 * 981.0 * np.maximum(x, 0.0))
                a = 3.33 * u[k, 0]
                b = 3.35 * u[k, 1]
                into = np.array([0.7 * a + out[2], 0.6 * b + out[3], 0.4 * b, 0.3 * a])
                x = np.maximum(x + dt / 4 * (into - out) / np.array([28.0, 32.0, 28.0, 32.0]), 0.0)
        return u, y

    return _records(run, dt, 0.02, rng)


@dataclass(frozen=True)
class Bent:
    """A static bend, a dead time and an oscillating lag.

    Attributes
    ----------
    bend : of the input.
    n, pieces, noise : of the training records.
    late : samples of dead time.
    two_levels : the input is a PRBS.
    quantum : of the training outputs, in spreads.
    """

    bend: Callable[[FloatArray], FloatArray]
    n: int
    noise: float = 0.02
    pieces: int = 1
    late: int = 1
    two_levels: bool = False
    quantum: float = 0.0

    def __call__(self, rng: np.random.Generator) -> Experiment:
        a = np.real(np.poly(np.exp(0.05 * np.array([-1.2 + 2.2j, -1.2 - 2.2j]))))
        b = np.append(np.zeros(self.late), a.sum())

        def run(n: int = 1000) -> Record:
            u = steps(n, (8, 60), rng)
            u = np.sign(u) if self.two_levels else u
            return u, np.asarray(lfilter(b, a, self.bend(u)))

        train = [run(self.n) for _ in range(self.pieces)]
        made = experiment(train, [run(), run()], 0.05, self.noise, rng)
        return _quantised(made, self.quantum) if self.quantum else made


def _quantised(made: Experiment, share: float) -> Experiment:
    quantum = share * float(np.concatenate([s.y for s in made.train.segments]).std())
    rounded = [replace(s, y=quantum * np.round(s.y / quantum)) for s in made.train.segments]
    return replace(made, train=made.train.with_segments(rounded))


def drag(
    n: int, size: float = 1.0, hold: tuple[int, int] = (15, 80)
) -> Callable[[np.random.Generator], Experiment]:
    """A lagging push against linear and quadratic drag; tried on inputs `size` times those of training."""

    def plant(rng: np.random.Generator) -> Experiment:
        def run(n: int, times: float) -> Record:
            u = times * steps(n, hold, rng)
            x = np.zeros(2)
            y = np.empty(n)
            for k in range(n):
                y[k] = x[1]
                for _ in range(2):
                    against = 0.3 * x[1] + 1.5 * x[1] * abs(x[1])
                    x = x + 0.02 * np.array([(u[k] - x[0]) / 0.2, 3.0 * x[0] - against])
            return u, y

        return experiment([run(n, 1.0)], [run(1000, size), run(1000, size)], 0.04, 0.02, rng)

    return plant


def spin(rng: np.random.Generator) -> Experiment:
    """A rotor that spins up faster than it spins down, thrust with its square."""
    dt = 0.02
    n = 2000

    def run() -> Record:
        u = 0.5 + 0.45 * steps(n, (15, 100), rng)
        x = 0.5
        y = np.empty(n)
        for k in range(n):
            y[k] = x * x
            for _ in range(4):
                x += dt / 4 * (u[k] - x) / (0.08 if u[k] > x else 0.25)
        return u, y

    return _records(run, dt, 0.02, rng)


def backlash(rng: np.random.Generator) -> Experiment:
    """Play in a gear between a lagging motor and the measured side."""
    dt = 0.02
    n = 3000

    def run() -> Record:
        u = steps(n, (15, 100), rng)
        x = 0.0
        place = 0.0
        y = np.empty(n)
        for k in range(n):
            y[k] = place
            x += dt * (u[k] - x) / 0.3
            place = float(np.clip(place, x - 0.1, x + 0.1))
        return u, y

    return _records(run, dt, 0.01, rng)


def levitation(rng: np.random.Generator) -> Experiment:
    """A magnet's ball in closed loop: unstable by itself, current to gap."""
    dt = 0.005
    n = 3000

    def run() -> Record:
        goal = 0.01 + 0.002 * steps(n, (100, 300), rng)
        u = np.empty(n)
        y = np.empty(n)
        x = np.array([0.01, 0.0])
        for k in range(n):
            y[k] = x[0]
            u[k] = np.clip(1.0 + 250.0 * (x[0] - goal[k]) + 6.0 * x[1] + 0.02 * rng.normal(), 0.1, 3.0)
            for _ in range(5):
                x = x + dt / 5 * np.array([x[1], 9.81 - 9.81e-4 * (u[k] / x[0]) ** 2])
        return u, y

    return _records(run, dt, 0.005, rng)


def _soft(u: FloatArray) -> FloatArray:
    return np.asarray(np.tanh(2.0 * u))


def _cubic(u: FloatArray) -> FloatArray:
    return u**3


def _wavy(y: float, before: float, u: float) -> float:
    sines = 0.6 * np.sin(np.pi * u) + 0.3 * np.sin(3 * np.pi * u) + 0.1 * np.sin(5 * np.pi * u)
    return float(0.3 * y + 0.6 * before + sines)


def _product(y: float, before: float, u: float) -> float:
    return y * before * (y + 2.5) / (1 + y * y + before * before) + u


PLANTS: dict[str, Callable[[np.random.Generator], Experiment]] = {
    "diode": diode,
    "drives": drives,
    "ph": ph,
    "exchanger": exchanger,
    "bouc-wen": bouc_wen,
    "van der pol": van_der_pol,
    "narendra 1": _narendra(_wavy, 1.0),
    "narendra 2": _narendra(_product, 2.0),
    "narendra 3": _narendra(lambda y, _, u: y / (1 + y * y) + u**3, 2.0),
    "roll": roll,
    "quadruple": quadruple,
    "spin": spin,
    "backlash": backlash,
    "levitation": levitation,
    "late": Bent(_soft, 2500, late=25),
    "short pieces": Bent(_soft, 25, 0.03, pieces=100),
    "few": Bent(_soft, 150),
    "few, drag": drag(150, hold=(4, 20)),
    "many": drag(50_000),
    "noisy": Bent(_cubic, 2000, 0.3),
    "quantised": Bent(_soft, 1500, 0.0, quantum=0.3),
    "prbs": Bent(_soft, 1500, two_levels=True),
    "beyond": drag(2000, size=2.0),
}


def fitted(plant: Experiment) -> tuple[str, Fitted, Fitted, float]:
    """The baseline's label, its model, the TS model, and its CPU seconds, all as `flysid fit` makes them."""
    train = plant.train
    late = dead_times(train)
    hint = delays_to_try(late, 1)
    least = least_delays(late, 1)
    linear = linear_rivals(hint, least)
    choice = choose_baseline(train, linear)
    models = {n: linear[n].fit(train) for n in dict.fromkeys(("arx", choice.label))}
    base = confirm(choice, models, train).label
    begin = time.process_time()
    ts = TS(nk_hint=hint, nk_least=least).fit(train)
    return base, models[base], ts, time.process_time() - begin


def line(name: str, seed: int) -> str:
    """What the defaults make of one plant."""
    plant = PLANTS[name](np.random.default_rng(seed))
    try:
        label, linear, ts, seconds = fitted(plant)
    except FlysidError as error:
        return f"{name:17s} {seed} refused: {error.message}"
    errors = off(linear, plant.test), off(ts, plant.test)
    return (
        f"{name:17s} {seed} noise {100 * plant.noise:5.2f}  {label:10s} {errors[0]:7.2f}  {ts.structure:5s} "
        f"{len(ts.rules())} rules {errors[1]:7.2f}  ratio {errors[1] / errors[0]:6.3f}  {seconds:5.1f} s CPU"
    )


def main() -> None:
    """Print a line per plant and seed."""
    print_lines(__doc__, PLANTS, line, 1)


if __name__ == "__main__":
    main()
