"""How many rules over hidden states: `python -m bench.hidden_rules linear 11 15`, or nonlinear.

Simulated plants whose noise-free answer is known, recordings of the seeds given, `TSStateSpace()` with its
defaults beside `StateSpace()`: on linear plants one rule is the truth, on the others rules should come nearer
to it. Errors are free runs on a fresh recording against the noise-free outputs, from a start that 60 noisy
samples suggest, in spreads of the output. CPU seconds are not a claim.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from bench.hidden_plants import LINEAR, PLANTS, Plant
from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.base import Fitted
from flysid.model.statespace import StateSpace
from flysid.model.ts_state_space import TSStateSpace
from flysid.validate.compare.trials import free_run

SETTINGS = ((1024, 0.02), (512, 0.1))
"""Samples to learn from, and noise in spreads of the output."""
START = 60


def error(model: Fitted, test: Dataset, truth: list[FloatArray]) -> float:
    """Root mean square of free run less truth, in spreads of the true outputs."""
    gaps = [free_run(model, s, START)[:, 0] - y[START:] for s, y in zip(test.segments, truth, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)) / np.std(np.concatenate(truth)))


def main(kind: str, first: int, last: int) -> int:
    """Print a line per plant and recording, then how often one rule was enough."""
    plants = LINEAR if kind == "linear" else PLANTS
    counts = []
    for seed in range(first, last + 1):
        for name, plant in plants.items():
            for samples, noise in SETTINGS:
                counts.append(_one(name, plant, seed, (samples, noise)))
    print(f"{kind}: {sum(c == 1 for c in counts)} of {len(counts)} with one rule")
    return 0


def _one(name: str, plant: Plant, seed: int, setting: tuple[int, float]) -> int:
    samples, noise = setting
    train, _ = plant.dataset((seed,), samples, noise)
    test, truth = plant.dataset((1000 + seed,), 1024, noise)
    linear = StateSpace().fit(train)
    begin = time.process_time()
    try:
        rules = TSStateSpace().fit(train)
    except FlysidError as fault:
        print(f"{name}, recording {seed}: {fault}", flush=True)
        return 0
    seconds = time.process_time() - begin
    count = len(rules.rules())
    print(
        f"{name}, {samples} samples, noise {noise:.0%}, recording {seed}: {count} rules"
        f" {error(rules, test, truth):.4f}, linear state space {error(linear, test, truth):.4f},"
        f" {seconds:.1f} s CPU",
        flush=True,
    )
    return count


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
