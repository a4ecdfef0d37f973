"""Inputs that a model must come back from: random ones over the training range, then training ones shuffled.

While a model grows, what its outputs leave the range by under such inputs counts as an error like any other:
a model that follows the training record on the edge of instability is not what anybody wants. Whether a
finished model may be offered is asked with other random numbers than it was trained with.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray


def stress_run(runs: Sequence[FloatArray], n_y: int, steps: int, seed: int) -> FloatArray:
    """W (2 steps, n_y + n_u): `steps` random inputs in the training range, then training ones shuffled."""
    rng = np.random.default_rng(seed)
    pool = np.vstack([W[:, n_y:] for W in runs])
    low, high = pool.min(axis=0), pool.max(axis=0)
    hold = max(2, len(pool) // 200)
    begins = rng.integers(0, max(1, len(pool) - hold), size=-(-steps // hold))
    usual = np.vstack([pool[b : b + hold] for b in begins])[:steps]
    wild = np.repeat(rng.uniform(low, high, (-(-steps // hold), len(low))), hold, axis=0)[:steps]
    W = np.zeros((2 * steps, n_y + len(low)))
    W[:, n_y:] = np.vstack([wild, usual[:steps]])
    return W


def beyond(y: FloatArray, limits: FloatArray) -> FloatArray:
    """How far (N, n_y) outputs are on their way out of the training range to its limits; 0 inside.

    Half of the margin is free: a plant may well go a little further under inputs it has not seen.
    """
    margin = (limits[1] - limits[0]) / 6.0
    low, high = limits[0] + margin, limits[1] - margin
    return np.asarray(np.maximum(y - high, 0.0) + np.minimum(y - low, 0.0))
