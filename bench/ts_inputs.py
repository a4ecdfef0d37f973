"""Several inputs; some do nothing, or act only on the gain: `python -m bench.ts_inputs [seeds]`.

Four records of 25 s, with noise of 2 % (even seeds) or 10 % (odd ones) of the output's spread; free run on
eight fresh noise-free records, per cent of the output's spread, and how many past samples of every input the
consequents use.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from bench.ts_experiment import off
from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.model.arx import ARX
from flysid.model.ts import TS, over_lags

DT_S = 0.05
LENGTH = 500


def commands(rng: np.random.Generator, inputs: int) -> FloatArray:
    """(LENGTH, inputs) smoothed steps of random height and length."""
    columns = []
    for _ in range(inputs):
        lengths = rng.integers(8, 60, size=LENGTH // 8)
        steps = np.repeat(rng.normal(size=len(lengths)), lengths)[:LENGTH]
        columns.append(np.convolve(np.r_[np.full(3, steps[0]), steps], np.full(4, 0.25), "valid"))
    return np.stack(columns, axis=1)


def lag(v: FloatArray, frequency: float = 3.0, damping: float = 0.7) -> FloatArray:
    """(N,) answer of a second-order lag of gain one to v (N,), frequency in rad/s."""
    x = np.zeros(2)
    y = []
    step = DT_S / 5
    for value in v:
        y.append(x[0])
        for _ in range(5):
            push = frequency**2 * (value - x[0]) - 2.0 * damping * frequency * x[1]
            x = x + step * np.array([x[1], push])
    return np.array(y)


def scheduled(u: FloatArray) -> FloatArray:
    """Roll rate: airspeed, the second input, sets gain and bandwidth and does nothing by itself."""
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        speed = 1.0 + 0.4 * np.tanh(u[k - 1, 1])
        y[k] = y[k - 1] + DT_S * speed * (3.0 * speed * u[k - 1, 0] - 2.0 * y[k - 1])
    return y


def dead_band(v: FloatArray) -> FloatArray:
    """v without what lies within 0.3 of zero."""
    return np.asarray(np.sign(v) * np.maximum(np.abs(v) - 0.3, 0.0))


PLANTS: dict[str, tuple[int, Callable[[FloatArray], FloatArray]]] = {
    "dead band, two inputs idle": (3, lambda u: lag(dead_band(u[:, 0]))),
    "linear, two inputs idle": (3, lambda u: lag(u[:, 0])),
    "linear, a tenth from the other": (2, lambda u: lag(u[:, 0]) + 0.1 * lag(u[:, 1], 2.0, 0.9)),
    "gain by the other": (2, scheduled),
    "square of the other": (2, lambda u: lag(u[:, 0]) + 0.5 * lag(u[:, 1] ** 2, 2.0, 0.9)),
    "both saturate": (2, lambda u: lag(np.tanh(u[:, 0] / 0.6)) + 0.7 * lag(u[:, 1], 2.0, 0.9)),
}
"""Number of inputs, and the noise-free output of inputs (N, n_u)."""


def records(plant: str, count: int, noise: float, rng: np.random.Generator) -> Dataset:
    """`count` records with white noise of a share of the output's spread."""
    inputs, respond = PLANTS[plant]
    runs = [(u, respond(u)) for u in (commands(rng, inputs) for _ in range(count))]
    spread = noise * np.std(np.concatenate([y for _, y in runs]))
    segments = [
        Segment(u, (y + spread * rng.normal(size=len(y)))[:, None], flight=str(i))
        for i, (u, y) in enumerate(runs)
    ]
    signals = tuple(Signal(f"u{j}") for j in range(inputs))
    return Dataset(DT_S, signals, (Signal("y"),), tuple(segments), name=plant)


def main() -> None:
    """Print a row per plant and seed."""
    print("| plant | seed | ARX, % | TS, % | rules | past inputs |")
    print("|---|---|---|---|---|---|")
    for plant in PLANTS:
        for seed in range(int(sys.argv[1]) if len(sys.argv) > 1 else 4):
            rng = np.random.default_rng(seed)
            train = records(plant, 4, (0.02, 0.1)[seed % 2], rng)
            fresh = records(plant, 8, 0.0, rng)
            linear = ARX().fit(train)
            ts = over_lags(TS(), train)
            print(
                f"| {plant} | {seed} | {off(linear, fresh):.2f} | {off(ts, fresh):.2f} | "
                f"{len(ts.rules())} | {list(ts.layout.orders.nb)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
