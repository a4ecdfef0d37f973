"""Records of a plant whose truth is known: noisy ones to learn from, noise-free ones to be judged on."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.model.base import Fitted
from flysid.model.start import estimate_start, start_window

Derivative = Callable[[FloatArray, float], FloatArray]


@dataclass(frozen=True)
class Experiment:
    """Noisy records to learn from and noise-free ones to be judged on."""

    train: Dataset
    test: Dataset
    noise: float


def integrate(f: Derivative, x0: FloatArray, u: FloatArray, dt: float, substeps: int = 4) -> FloatArray:
    """(N, n) states of x' = f(x, u) under inputs held over each sample; Runge-Kutta of order 4."""
    h = dt / substeps
    x = np.array(x0, dtype=np.float64)
    out = np.empty((len(u), len(x0)))
    for k, value in enumerate(u):
        out[k] = x
        for _ in range(substeps):
            k1 = f(x, value)
            k2 = f(x + 0.5 * h * k1, value)
            k3 = f(x + 0.5 * h * k2, value)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3, value))
    return out


def multisine(n: int, dt: float, band: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """(N,) unit-variance sum of sines of random phase between two frequencies in Hz."""
    f = np.fft.rfftfreq(n, dt)
    spectrum = np.where((f >= band[0]) & (f <= band[1]), np.exp(2j * np.pi * rng.random(len(f))), 0)
    x = np.fft.irfft(spectrum, n)
    return np.asarray(x / x.std())


def steps(n: int, hold: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """(N,) steps of uniform height in [-1, 1] and random length."""
    lengths = rng.integers(*hold, size=n // hold[0] + 1)
    return np.repeat(rng.uniform(-1, 1, len(lengths)), lengths)[:n]


def _set(parts: list[tuple[FloatArray, FloatArray]], dt: float) -> Dataset:
    segments = tuple(
        Segment(u.reshape(len(u), -1), y.reshape(len(y), -1), flight=str(i)) for i, (u, y) in enumerate(parts)
    )
    return Dataset(
        dt, _signals("u", segments[0].u.shape[1]), _signals("y", segments[0].y.shape[1]), segments, name="y"
    )


def _signals(name: str, count: int) -> tuple[Signal, ...]:
    return (Signal(name),) if count == 1 else tuple(Signal(f"{name}{i + 1}") for i in range(count))


def experiment(
    train: list[tuple[FloatArray, FloatArray]],
    test: list[tuple[FloatArray, FloatArray]],
    dt: float,
    share: float,
    rng: np.random.Generator,
) -> Experiment:
    """White noise of `share` times the training output's spread on the training outputs.

    Records are (u, y), each (N,), or (N, n_u) and (N, n_y) where there are several signals.
    """
    level = share * np.concatenate([y for _, y in train]).std(axis=0)
    noisy = [(u, y + level * rng.normal(size=y.shape)) for u, y in train]
    spread = np.concatenate([y for _, y in test]).std(axis=0)
    return Experiment(_set(noisy, dt), _set(test, dt), float(np.mean(level / spread)))


def off(model: Fitted, test: Dataset) -> float:
    """Free-run error against the truth, per cent of its spread; started and skipped as in the verdict."""
    gaps = []
    for s in test.segments:
        skip = start_window(max(model.n_init, 4), len(s), test.dt_s)
        start = estimate_start(model, s.u[:skip], s.y[:skip])
        gaps.append((model.simulate(s.u, start) - s.y)[skip:])
    spread = np.concatenate([s.y for s in test.segments]).std(axis=0)
    return float(100 * np.sqrt(np.mean((np.concatenate(gaps) / spread) ** 2)))


def print_lines(
    description: str | None, names: Iterable[str], line: Callable[[str, int], str], seeds: int
) -> None:
    """The command of a bench: what `line` says of every plant, or of those named, and of every seed."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("names", nargs="*", default=list(names))
    parser.add_argument("--seeds", type=int, default=seeds)
    options = parser.parse_args()
    for name in options.names or names:
        for seed in range(options.seeds):
            print(line(name, seed), flush=True)
