"""Inputs that a model must come back from: random ones over the training range, then training ones shuffled.

While a model grows, what its outputs leave the range by under such inputs counts as an error like any other:
a model that follows the training record on the edge of instability is not what anybody wants. Whether a
finished model may be offered is asked with other random numbers than it was trained with.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray


def probe_run(
    runs: Sequence[FloatArray], n_y: int, steps: int, seed: int, longest: int | None = None
) -> FloatArray:
    """W (2 steps, n_y + n_u): `steps` random inputs in the training range, then training ones shuffled.

    Parameters
    ----------
    longest : random inputs are held for 2 samples up to so many, or up to a 200th of the training inputs if
        that is more; for just that 200th where None.
    """
    rng = np.random.default_rng(seed)
    pool = np.vstack([W[:, n_y:] for W in runs])
    low = pool.min(axis=0)
    high = pool.max(axis=0)
    hold = max(2, len(pool) // 200)
    begins = rng.integers(0, max(1, len(pool) - hold), size=-(-steps // hold))
    usual = np.vstack([pool[b : b + hold] for b in begins])[:steps]
    even = np.full(-(-steps // hold), hold)
    holds = even if longest is None else _lengths(steps, max(longest, hold), rng)
    wild = np.repeat(rng.uniform(low, high, (len(holds), len(low))), holds, axis=0)[:steps]
    W = np.zeros((2 * steps, n_y + len(low)))
    W[:, n_y:] = np.vstack([wild, usual])
    return W


def _lengths(steps: int, longest: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Lengths from 2 to `longest`, evenly spread in logarithms, that make at least `steps` together."""
    lengths = np.exp(rng.uniform(np.log(2.0), np.log(longest + 1.0), size=steps // 2 + 1)).astype(np.int64)
    return lengths[: int(np.searchsorted(np.cumsum(lengths), steps)) + 1]
