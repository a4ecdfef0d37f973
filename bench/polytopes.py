"""Is a common quadratic Lyapunov function found where there is one, and in what time?

`python -m bench.polytopes [POLYTOPES] [SEED]`

Polytopes of 2 to 6 states and 2 to 5 rules whose answer is known as they are made. Of one half, every rule
shrinks a hidden metric (condition 1 to 1000) by 1e-4 to 1e-1 a step; of the other, every rule is stable in a
metric of its own, and a product of two of them grows. Printed: how many are answered rightly, and the CPU
time of an answer (`certificate_of`: is there one at all, then six bisections of its decay).
"""

from __future__ import annotations

import sys
import time

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.lyapunov import certificate_of

STATES = (2, 6)
RULES = (2, 5)
CONDITION = (0.0, 3.0)
SHRINKS = (-4.0, -1.0)
"""Decimal logarithms."""


def _metric(rng: np.random.Generator, n: int) -> FloatArray:
    """(n, n) coordinates T; the metric is T'T."""
    sizes = np.geomspace(1.0, np.sqrt(10.0 ** rng.uniform(*CONDITION)), n)
    return np.asarray(_rotation(rng, n) * sizes @ _rotation(rng, n))


def _rotation(rng: np.random.Generator, n: int) -> FloatArray:
    return np.asarray(np.linalg.qr(rng.standard_normal((n, n)))[0])


def _shrinking(rng: np.random.Generator, T: FloatArray) -> FloatArray:
    """A rule whose norm in the metric of T is 1 less what it shrinks by."""
    M = rng.standard_normal(T.shape)
    M *= (1.0 - 10.0 ** rng.uniform(*SHRINKS)) / np.linalg.norm(M, 2)
    return np.asarray(np.linalg.solve(T, M @ T))


def with_one(rng: np.random.Generator) -> list[FloatArray]:
    """Rules that shrink one metric."""
    T = _metric(rng, int(rng.integers(STATES[0], STATES[1] + 1)))
    return [_shrinking(rng, T) for _ in range(rng.integers(RULES[0], RULES[1] + 1))]


def without(rng: np.random.Generator) -> list[FloatArray]:
    """Stable rules of which two, one after the other, grow."""
    n = int(rng.integers(STATES[0], STATES[1] + 1))
    count = int(rng.integers(RULES[0], RULES[1] + 1))
    while True:
        rules = [_shrinking(rng, _metric(rng, n)) for _ in range(count)]
        products = (A @ B for k, A in enumerate(rules) for B in rules[:k])
        if max(np.abs(np.linalg.eigvals(P)).max() for P in products) > 1.0:
            return rules


def main(count: int, seed: int) -> None:
    """Print the table."""
    seconds = []
    for draw, exists in ((with_one, True), (without, False)):
        right = 0
        for k in range(count // 2):
            rules = draw(np.random.default_rng([seed, k, exists]))
            begin = time.process_time()
            right += certificate_of(rules).proved == exists
            seconds.append(time.process_time() - begin)
        print(f"{'with' if exists else 'without'} a common function: {right} of {count // 2} right")
    low, high = np.quantile(seconds, [0.5, 0.95])
    print(f"CPU: median {low:.3f} s, 95 % {high:.3f} s, longest {max(seconds):.3f} s")


if __name__ == "__main__":
    given = [int(a) for a in sys.argv[1:3]]
    main(*(given + [200, 1][len(given) :]))
