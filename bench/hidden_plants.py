"""Simulated plants with a hidden state, whose noise-free answer is known: what a state-space model is for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal

_SUBSTEPS = 10


@dataclass(frozen=True)
class Plant:
    """A sampled continuous plant.

    Attributes
    ----------
    rate : (state, input) -> derivative; `limit` holds the state where it belongs.
    sense : state -> output.
    dt_s : sample time.
    excite : (rng, samples) -> input.
    rest : the state it starts from.
    sensor : lowest and highest reading.
    """

    rate: Callable[[FloatArray, float], FloatArray]
    limit: Callable[[FloatArray], FloatArray]
    sense: Callable[[FloatArray], float]
    dt_s: float
    excite: Callable[[np.random.Generator, int], FloatArray]
    rest: tuple[float, ...]
    sensor: tuple[float, float] = (-np.inf, np.inf)

    def flown(self, seed: int, samples: int, noise: float) -> tuple[Segment, FloatArray]:
        """A recording with `noise` (a share of the output's spread), and the outputs without it."""
        rng = np.random.default_rng(seed)
        u = self.excite(rng, samples)
        x = np.array(self.rest)
        y = np.empty(samples)
        step = self.dt_s / _SUBSTEPS
        for k in range(samples):
            y[k] = self.sense(x)
            for _ in range(_SUBSTEPS):
                middle = x + 0.5 * step * self.rate(x, u[k])
                x = self.limit(x + step * self.rate(self.limit(middle), u[k]))
        measured = y + noise * y.std() * rng.standard_normal(samples)
        return Segment(u[:, None], np.clip(measured, *self.sensor)[:, None]), y

    def dataset(self, seeds: tuple[int, ...], samples: int, noise: float) -> tuple[Dataset, list[FloatArray]]:
        """One segment per seed, and the true outputs."""
        flown = [self.flown(seed, samples, noise) for seed in seeds]
        data = Dataset(self.dt_s, (Signal("u"),), (Signal("y"),), tuple(s for s, _ in flown))
        return data, [y for _, y in flown]


def smooth_noise(cut: float, low: float, high: float) -> Callable[[np.random.Generator, int], FloatArray]:
    """Random phases up to `cut` (share of the sample rate), scaled to lie between low and high."""

    def excite(rng: np.random.Generator, samples: int) -> FloatArray:
        spectrum = np.zeros(samples // 2 + 1, dtype=complex)
        count = max(3, int(cut * samples))
        spectrum[1:count] = np.exp(2j * np.pi * rng.uniform(size=count - 1))
        u = np.fft.irfft(spectrum, samples)
        return np.asarray(low + (high - low) * (u - u.min()) / np.ptp(u))

    return excite


def held_steps(hold: int, low: float, high: float) -> Callable[[np.random.Generator, int], FloatArray]:
    """Random levels held for `hold` samples."""

    def excite(rng: np.random.Generator, samples: int) -> FloatArray:
        return np.repeat(rng.uniform(low, high, samples // hold + 1), hold)[:samples]

    return excite


def _tanks(x: FloatArray, u: float) -> FloatArray:
    upper, lower = np.sqrt(np.maximum(x, 0.0))
    inflow = 0.06 * u
    over = max(inflow - 0.07 * upper, 0.0) if x[0] >= 10.0 else 0.0
    return np.array([inflow - 0.07 * upper, 0.065 * upper - 0.06 * lower + 0.6 * over])


def _drag(x: FloatArray, u: float) -> FloatArray:
    tilt, v = x
    return np.array([(u - tilt) / 0.25, 9.81 * tilt - 0.2 * v - 0.25 * v * abs(v)])


def _hammerstein(x: FloatArray, u: float) -> FloatArray:
    drive = np.tanh(2.0 * u) + 0.2 * u
    return np.array([x[1], 9.0 * (drive - x[0]) - 2.4 * x[1]])


def _wiener(x: FloatArray, u: float) -> FloatArray:
    return np.array([x[1], 9.0 * (u - x[0]) - 3.6 * x[1]])


def _bouc_wen(x: FloatArray, u: float) -> FloatArray:
    place, speed, hysteresis = x
    turn = 3.0 * speed - 2.0 * (abs(speed) * hysteresis + 0.6 * speed * abs(hysteresis))
    return np.array([speed, 6.0 * u - 2.0 * speed - 4.0 * place - 3.0 * hysteresis, turn])


def _free(x: FloatArray) -> FloatArray:
    return x


def _first(x: FloatArray) -> float:
    return float(x[0])


def _linear_tanks(x: FloatArray, u: float) -> FloatArray:
    return np.array([0.06 * u - 0.02 * x[0], 0.02 * x[0] - 0.015 * x[1]])


def _lagging_vehicle(x: FloatArray, u: float) -> FloatArray:
    return np.array([(u - x[0]) / 0.25, 9.81 * x[0] - 0.6 * x[1]])


def _arm(x: FloatArray, u: float) -> FloatArray:
    twist = 60.0 * (x[0] - x[2]) + 0.4 * (x[1] - x[3])
    return np.array([x[1], 4.0 * u - 2.0 * x[1] - 3.0 * x[0] - twist, x[3], 1.5 * twist - 0.2 * x[3]])


def _motor(x: FloatArray, u: float) -> FloatArray:
    return np.array([x[1], 8.0 * (2.0 * u - x[1]) - 4.0 * x[0]])


LINEAR: dict[str, Plant]
"""Linear plants with hidden states, on which one rule is the truth."""

PLANTS: dict[str, Plant] = {
    "two tanks with overflow": Plant(
        _tanks,
        lambda x: np.clip(x, 0.0, 10.0),
        lambda x: float(x[1]),
        4.0,
        smooth_noise(0.035, 0.4, 6.3),
        (5.0, 5.0),
        (0.0, 10.0),
    ),
    "vehicle with drag and a lagging actuator": Plant(
        _drag, _free, lambda x: float(x[1]), 0.05, held_steps(25, -0.4, 0.4), (0.0, 0.0)
    ),
    "Hammerstein": Plant(_hammerstein, _free, _first, 0.05, held_steps(20, -1.5, 1.5), (0.0, 0.0)),
    "Wiener": Plant(
        _wiener,
        _free,
        lambda x: float(x[0] + 0.5 * x[0] ** 2 * np.sign(x[0])),
        0.05,
        held_steps(20, -1.0, 1.0),
        (0.0, 0.0),
    ),
    "hysteresis": Plant(_bouc_wen, _free, _first, 0.05, smooth_noise(0.05, -2.0, 2.0), (0.0, 0.0, 0.0)),
}

LINEAR = {
    "two linear tanks": Plant(
        _linear_tanks, _free, lambda x: float(x[1]), 4.0, smooth_noise(0.035, 0.4, 6.3), (9.0, 9.0)
    ),
    "linear vehicle": Plant(
        _lagging_vehicle, _free, lambda x: float(x[1]), 0.05, held_steps(25, -0.4, 0.4), (0.0, 0.0)
    ),
    "flexible arm": Plant(
        _arm, _free, lambda x: float(x[2]), 0.05, held_steps(15, -1.0, 1.0), (0.0, 0.0, 0.0, 0.0)
    ),
    "motor": Plant(_motor, _free, _first, 0.05, smooth_noise(0.08, -1.0, 1.0), (0.0, 0.0)),
}
