"""Plants drawn at random from ten kinds, whose noise-free truth is known: `drawn(number)`.

The number is the seed: constants, excitation, number of flights and noise hang on it alone. Kinds take turns,
so that ten numbers in a row hold each of them once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.ts_experiment import Derivative, Experiment, experiment, integrate, steps
from flysid.dataset import FloatArray

Sensor = Callable[[FloatArray], FloatArray]
DT_S = 0.05
NOISE = (0.005, 0.04)


@dataclass(frozen=True)
class Plant:
    """A plant over one input: what its states do, and what is seen of them.

    Attributes
    ----------
    order : number of states, which begin at `rest`.
    late : samples by which the input comes late.
    low, high : range of the input.
    """

    rate: Derivative
    order: int
    sensor: Sensor = lambda x: x[:, 0]
    late: int = 0
    low: float = -1.0
    high: float = 1.0
    rest: float = 0.0

    def flown(self, samples: int, hold: tuple[int, int], rng: np.random.Generator) -> tuple[FloatArray, ...]:
        """(u, y) of one flight: levels held for random times."""
        u = self.low + (self.high - self.low) * 0.5 * (1.0 + steps(samples + self.late, hold, rng))
        x = integrate(self.rate, np.full(self.order, self.rest), u[:samples], DT_S)
        return u[self.late :], self.sensor(x)


def drag(rng: np.random.Generator) -> Plant:
    """A commanded tilt that lags, and a speed with linear and quadratic drag."""
    lag, thin, thick = rng.uniform(0.1, 0.4), rng.uniform(0.05, 0.4), rng.uniform(0.05, 0.4)

    def rate(x: FloatArray, u: float) -> FloatArray:
        return np.array([9.81 * x[1] - thin * x[0] - thick * x[0] * abs(x[0]), (0.4 * u - x[1]) / lag])

    return Plant(rate, 2)


def hammerstein(rng: np.random.Generator) -> Plant:
    """An actuator that saturates or has a dead band, in front of a second-order lag."""
    w, damping, bend = rng.uniform(2.0, 5.0), rng.uniform(0.4, 1.0), rng.uniform(0.2, 0.5)
    saturates = rng.random() < 0.5

    def rate(x: FloatArray, u: float) -> FloatArray:
        push = np.tanh(u / bend) if saturates else np.sign(u) * max(abs(u) - bend, 0.0)
        return np.array([x[1], w * w * (push - x[0]) - 2.0 * damping * w * x[1]])

    return Plant(rate, 2)


def wiener(rng: np.random.Generator) -> Plant:
    """A second-order lag behind a bent sensor."""
    w, damping, bend = rng.uniform(2.0, 5.0), rng.uniform(0.5, 1.0), rng.uniform(0.8, 2.0)

    def rate(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], w * w * (u - x[0]) - 2.0 * damping * w * x[1]])

    return Plant(rate, 2, lambda x: np.tanh(bend * x[:, 0]))


def bilinear(rng: np.random.Generator) -> Plant:
    """An input that also changes how fast the state decays."""
    slow, fast, cross = rng.uniform(0.5, 1.5), rng.uniform(3.0, 8.0), rng.uniform(0.3, 0.7)

    def rate(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1] - slow * x[0] * (1.0 + cross * u), fast * (u - x[1])])

    return Plant(rate, 2)


def late_third_order(rng: np.random.Generator) -> Plant:
    """Linear: three lags behind a dead time."""
    lags = rng.uniform(0.15, 1.2, size=3)

    def rate(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1] - x[0], x[2] - x[1], u - x[2]]) / lags

    return Plant(rate, 3, late=int(rng.integers(2, 8)))


def scheduled_gain(rng: np.random.Generator) -> Plant:
    """A lag whose gain and speed change with its own output."""
    slow, more = rng.uniform(0.5, 1.5), rng.uniform(0.5, 1.5)

    def rate(x: FloatArray, u: float) -> FloatArray:
        weight = 1.0 / (1.0 + np.exp(-3.0 * x[0]))
        return np.array([(x[1] - x[0]) * slow * (1.0 + more * weight), 5.0 * ((1.0 + weight) * u - x[1])])

    return Plant(rate, 2)


def duffing(rng: np.random.Generator) -> Plant:
    """A spring that hardens."""
    w, damping, hard = rng.uniform(1.5, 4.0), rng.uniform(0.15, 0.5), rng.uniform(0.5, 2.0)

    def rate(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], w * w * (u - x[0] - hard * x[0] ** 3) - 2.0 * damping * w * x[1]])

    return Plant(rate, 2)


def tanks(rng: np.random.Generator) -> Plant:
    """Two tanks in a row, of which the lower one's level is seen."""
    pump, upper, lower = rng.uniform(0.8, 1.4), rng.uniform(0.8, 1.2), rng.uniform(0.7, 1.1)

    def rate(x: FloatArray, u: float) -> FloatArray:
        out = np.sqrt(np.maximum(x, 0.0)) * np.array([upper, lower])
        return np.array([pump * u - out[0], out[0] - out[1]])

    return Plant(rate, 2, lambda x: x[:, 1], low=0.2, high=2.2, rest=1.0)


def integrator(rng: np.random.Generator) -> Plant:
    """Linear: acceleration to place, with hardly any damping."""
    damping, gain = rng.uniform(0.03, 0.5), rng.uniform(0.8, 2.0)

    def rate(x: FloatArray, u: float) -> FloatArray:
        return np.array([x[1], gain * u - damping * x[1]])

    return Plant(rate, 2)


def dead_zone_and_drag(rng: np.random.Generator) -> Plant:
    """A dead zone of the actuator, and quadratic drag."""
    zone, thin, thick = rng.uniform(0.1, 0.3), rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.8)

    def rate(x: FloatArray, u: float) -> FloatArray:
        push = np.sign(u) * max(abs(u) - zone, 0.0)
        return np.array([4.0 * x[1] - thin * x[0] - thick * x[0] * abs(x[0]), 5.0 * (push - x[1])])

    return Plant(rate, 2)


KINDS: tuple[Callable[[np.random.Generator], Plant], ...] = (
    *(drag, hammerstein, wiener, bilinear, late_third_order),
    *(scheduled_gain, duffing, tanks, integrator, dead_zone_and_drag),
)
FIRST = 40_000
"""Number of the first plant of `bench.lottery`."""


def kind_of(number: int) -> str:
    """The kind of the plant of a number, by its name."""
    return KINDS[number % len(KINDS)].__name__.replace("_", " ")


def drawn(number: int) -> Experiment:
    """Two to four noisy flights of a drawn plant, and three without noise that nothing is learned from."""
    rng = np.random.default_rng(number)
    plant = KINDS[number % len(KINDS)](rng)
    flights, samples = int(rng.integers(2, 5)), int(rng.integers(350, 700))
    hold = (int(rng.integers(8, 16)), int(rng.integers(40, 80)))
    noise = float(np.exp(rng.uniform(*np.log(NOISE))))
    learned = [plant.flown(samples, hold, rng) for _ in range(flights)]
    fresh = [plant.flown(samples, hold, rng) for _ in range(3)]
    return experiment(learned, fresh, DT_S, noise, rng)  # type: ignore[arg-type]
