"""Real fits on plants whose nature is known: does the verdict find what is there, and nothing else?

`python -m tests.bench.verdict_fairness linear 200` and `... nonlinear 200` print one line per plant and the
totals. On linear plants TS must be called better in at most 5 %; on nonlinear plants, with noise such that a
perfect model is 20 % better than the best linear one, it should be found in at least 80 %, and the interval
should hold the change that the same two fitted models show on 60 fresh flights in 93 to 97 %.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import FlysidError
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.ts import TS
from flysid.validate.compare import Pair, compare
from flysid.validate.trials import FREE_RUN

DT_S = 0.05
TRAIN, TEST, FRESH = 4, 8, 60
LENGTH = 500


@dataclass(frozen=True)
class Plant:
    """A deterministic map from an input record (N,) to the output record (N,), and its noise."""

    name: str
    respond: Callable[[FloatArray], FloatArray]
    white: float
    coloured: float


def flights(plant: Plant, count: int, rng: np.random.Generator, prefix: str) -> Dataset:
    """`count` flights of one plant: steps of random height and length, smoothed; white and coloured noise."""
    segments = []
    for i in range(count):
        u = _input(rng)
        y = plant.respond(u) + plant.white * rng.normal(size=LENGTH)
        y = y + plant.coloured * _coloured(rng)
        segments.append(Segment(u[:, None], y[:, None], flight=f"{prefix}{i}"))
    return Dataset(DT_S, (Signal("u", "deg"),), (Signal("y", "m/s"),), tuple(segments), name="y")


def _input(rng: np.random.Generator) -> FloatArray:
    lengths = rng.integers(8, 60, size=LENGTH // 8)
    steps = np.repeat(rng.normal(size=len(lengths)), lengths)[:LENGTH]
    return np.convolve(np.concatenate([np.full(3, steps[0]), steps]), np.full(4, 0.25), mode="valid")


def _coloured(rng: np.random.Generator) -> FloatArray:
    """Unit variance, correlated over half a second: gusts."""
    return _filter([np.sqrt(1.0 - 0.81)], [1.0, -0.9], rng.normal(size=LENGTH))


def _filter(b: Sequence[float] | FloatArray, a: Sequence[float] | FloatArray, u: FloatArray) -> FloatArray:
    from scipy.signal import lfilter

    y: FloatArray = lfilter(b, a, u)
    return y


def linear_dynamics(rng: np.random.Generator) -> Callable[[FloatArray], FloatArray]:
    """Order 1 to 3, time constants 0.15 to 2 s, damping from 0.4, delay of 1 to 3 samples, gain 1."""
    poles: list[complex] = []
    for _ in range(int(rng.integers(1, 3))):
        pole = -1.0 / np.exp(rng.uniform(np.log(0.15), np.log(2.0)))
        if rng.random() < 0.4 and len(poles) < 2:
            damping = rng.uniform(0.4, 0.9)
            swing = abs(pole) * np.sqrt(1.0 / damping**2 - 1.0)
            poles += [complex(pole, swing), complex(pole, -swing)]
        else:
            poles.append(complex(pole, 0.0))
    a = np.real(np.poly(np.exp(np.array(poles[:3]) * DT_S)))
    b = np.zeros(int(rng.integers(1, 4)) + 1)
    b[-1] = a.sum()
    return lambda u: _filter(b, a, u)


def linear_plant(rng: np.random.Generator) -> Plant:
    """Noise of 2 to 20 % of the output's size, white; in half of the plants as much again coloured."""
    level = np.exp(rng.uniform(np.log(0.02), np.log(0.2)))
    return Plant("linear", linear_dynamics(rng), level, level * float(rng.random() < 0.5))


def nonlinear_plant(rng: np.random.Generator) -> Plant:
    """A saturating or dead-banded input, or drag; noise so that a perfect model is 20 % better."""
    kind = str(rng.choice(["saturation", "dead band", "drag"]))
    while True:
        plant = Plant(kind, _nonlinear(kind, rng), 0.0, 0.0)
        train, test = flights(plant, TRAIN, rng, "t"), flights(plant, TEST, rng, "h")
        error = compare([ARX().fit(train)], test, horizons=[FREE_RUN]).entry().models["arx"].scores
        if error.fit_pct is not None and error.fit_pct < 97.0:
            break
    # rmse_linear^2 = bias^2 + s^2 and rmse_perfect = s = 0.8 rmse_linear
    return Plant(kind, plant.respond, error.rmse * 0.8 / 0.6, 0.0)


def _nonlinear(kind: str, rng: np.random.Generator) -> Callable[[FloatArray], FloatArray]:
    dynamics, size = linear_dynamics(rng), rng.uniform(0.3, 0.8)
    if kind == "saturation":
        return lambda u: dynamics(np.tanh(u / size))
    if kind == "dead band":
        return lambda u: dynamics(np.sign(u) * np.maximum(np.abs(u) - size, 0.0))
    drag = rng.uniform(1.0, 3.0)
    return lambda u: _with_drag(u, drag)


def _with_drag(u: FloatArray, drag: float) -> FloatArray:
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = y[k - 1] + DT_S * (3.0 * u[k - 1] - 0.3 * y[k - 1] - drag * y[k - 1] * abs(y[k - 1]))
    return y


def judged(plant: Plant, rng: np.random.Generator) -> tuple[Pair, float | None]:
    """The free-run pair of defaults fitted to the plant, and the change they show on fresh flights."""
    train, test = flights(plant, TRAIN, rng, "t"), flights(plant, TEST, rng, "h")
    models: list[Fitted] = [ARX().fit(train), TS(most_rules=3).fit(train)]
    pair = compare(models, test, horizons=[FREE_RUN]).verdict["y"]
    fresh = compare(models, flights(plant, FRESH, rng, "f"), horizons=[FREE_RUN]).verdict["y"]
    return pair, fresh.change_pct


def main() -> None:
    """Print a line per plant and the totals."""
    kind, count = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 200
    verdicts: Counter[str] = Counter()
    covered: list[bool] = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        start = time.perf_counter()
        try:
            plant = linear_plant(rng) if kind == "linear" else nonlinear_plant(rng)
            pair, truth = judged(plant, rng)
        except FlysidError as error:
            verdicts[f"error: {error.message[:60]}"] += 1
            continue
        verdicts[str(pair.verdict)] += 1
        low, high = pair.ci95 or (np.nan, np.nan)
        if pair.ci95 and truth is not None:
            covered.append(bool(low <= truth <= high))
        said = "diverged" if truth is None else f"{truth:+6.1f} %"
        print(
            f"{seed:4d} {plant.name:10s} {pair.change_pct or np.nan:+7.1f} % [{low:+6.1f}, {high:+6.1f}] "
            f"true {said:9s} {pair.verdict:16s} {time.perf_counter() - start:5.1f} s",
            flush=True,
        )
    held = f"{100 * np.mean(covered):.1f} % of {len(covered)}" if covered else "none"
    print(f"{kind}: {dict(verdicts)}; the interval holds the truth in {held}")


if __name__ == "__main__":
    main()
