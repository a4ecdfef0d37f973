"""How often the intervals of step responses hold the truth.

`python -m bench.step_coverage [runs] [first seed] [noise]`: second order, 12 rad/s, damping 0.4, 60 s at
100 Hz, commands held for half a second, coloured noise (time constant 0.2 s) of 10 % of the output unless
said. Prints pointwise coverage, errors of the overshoot and the CPU time of one response.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.model.step_response import StepResponse, step_response

DT_S = 0.01
SECONDS = 60.0
OMEGA = 12.0
DAMPING = 0.4
NOISE = 0.1


def polynomials() -> tuple[FloatArray, FloatArray]:
    """b and a of the sampled loop."""
    s = OMEGA * (-DAMPING + 1j * np.sqrt(1.0 - DAMPING**2))
    a = np.real(np.poly(np.exp(np.array([s, np.conj(s)]) * DT_S)))
    return np.array([0.0, a.sum() / 2, a.sum() / 2]), np.asarray(a)


def true_step(n: int) -> FloatArray:
    """(n,) from the sample at which the command steps."""
    return np.asarray(lfilter(*polynomials(), np.ones(n)))


def flown(seed: int, noise: float = NOISE) -> Dataset:
    """One record."""
    rng = np.random.default_rng(seed)
    n = round(SECONDS / DT_S)
    u = np.repeat(100.0 * rng.standard_normal(n // 50 + 1), 50)[:n]
    clean = np.asarray(lfilter(*polynomials(), u))
    pole = np.exp(-DT_S / 0.2)
    colour = np.asarray(lfilter([1.0], [1.0, -pole], rng.standard_normal(n)))
    return Dataset.from_arrays(u, clean + noise * clean.std() * colour / colour.std(), DT_S)


def held(found: StepResponse) -> float:
    """Share of the points whose interval holds the truth."""
    low, high = found.interval
    true = true_step(len(found.step))
    return float(np.mean(((low <= true) & (true <= high))[1:]))


def main(runs: int, first: int, noise: float) -> None:
    """Print the figures."""
    shares = []
    overshoots = []
    inside = []
    cpu = []
    right = 100.0 * (true_step(200).max() - 1.0)
    for seed in range(first, first + runs):
        data = flown(seed, noise)
        began = time.process_time()
        found = step_response(data)
        figure = next(f for f in found.figures if f.name == "overshoot")
        cpu.append(time.process_time() - began)
        shares.append(held(found))
        if figure.value is not None and figure.low is not None and figure.high is not None:
            overshoots.append(figure.value - right)
            inside.append(figure.low <= right <= figure.high)
    miss = np.abs(overshoots)
    near = 100 * np.mean(miss < 2.0)
    print(f"points held: {100 * np.mean(shares):.1f} % of {runs} runs")
    print(f"overshoot, {right:.1f} %: within 2 points in {near:.1f} %, at most {miss.max():.1f} off")
    print(f"its interval holds: {100 * np.mean(inside):.1f} %")
    print(f"CPU time of one response: median {np.median(cpu):.2f} s")


if __name__ == "__main__":
    given = [float(word) for word in sys.argv[1:]]
    count, seed_0, size = (*given, *(40.0, 1000.0, NOISE)[len(given) :])
    main(round(count), round(seed_0), size)
