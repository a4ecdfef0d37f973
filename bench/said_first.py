"""Is a baseline that errs more than a constant said first?  python -m bench.said_first N FIRST

N lags that answer the size of their input alone, which no linear model follows, fitted as `flysid fit` does:
what is printed before the verdict where the baseline errs more than a constant, and the verdict.
"""

from __future__ import annotations

import sys

import numpy as np

from bench.verdict_fairness import TEST, TRAIN, Plant, flights
from flysid.dataset import FloatArray
from flysid.model.arx import ARX
from flysid.model.ts import TS
from flysid.validate.compare_models import compare
from flysid.validate.show.page.narrative import worse_than_constant
from flysid.validate.show.terminal import summary

POLE = 0.9
NOISE = 0.05


def answered_size(u: FloatArray) -> FloatArray:
    """A lag of the input's absolute value."""
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = POLE * y[k - 1] + (1.0 - POLE) * abs(u[k - 1])
    return y


def main(words: list[str]) -> int:
    """Print what a user reads first."""
    count, first = (int(w) for w in words)
    plant = Plant("size", answered_size, NOISE, 0.0)
    for seed in range(first, first + count):
        rng = np.random.default_rng(seed)
        train = flights(plant, TRAIN, rng, "t")
        test = flights(plant, TEST, rng, "h")
        c = compare({"arx": ARX().fit(train), "ts": TS().fit(train)}, test, train=train)
        print("\n".join([f"{seed}:", *worse_than_constant({"": c}), summary({"": c})]), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
