"""How far held-out samples lie from every training sample: holes inside the range that training spans.

A sample is a point of what models look back on: inputs and outputs, each in units of its spread in training,
now and a moment ago, where a model's regressors lie. The distance between training samples is measured by
blocks: the nearest sample in any other block, as neighbours in time are always near.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray

USUAL = 0.99
"""Share of training samples that are as near to others as `Nearness.usual`."""
UNUSUAL = 5.0 * (1.0 - USUAL)
"""Share of held-out samples beyond it from which people are warned; another flight always has a few."""
_BLOCKS = 10


@dataclass(frozen=True)
class Nearness:
    """Held-out samples inside the range of every signal, by their distance to the nearest training sample.

    Attributes
    ----------
    usual : distance that 99 % of training samples keep to other blocks, in spreads of the signals.
    typical : median distance of the held-out samples.
    far : share of the held-out samples that are inside the range, and farther than `usual`.
    worst_segment, worst_far : where most of them are.
    """

    usual: float
    typical: float
    far: float
    worst_segment: int
    worst_far: float


def nearness(train: Dataset, test: Dataset, lag: int) -> Nearness | None:
    """Distances of `test` to `train`; None where there is too little to tell.

    `lag`: samples between now and a moment ago.
    """
    from scipy.spatial import cKDTree

    signals = np.vstack([np.hstack([s.u, s.y]) for s in train.segments])
    spread = signals.std(axis=0)
    moving = spread > 0.0
    if not moving.any():
        return None
    known = _points(train, lag, moving, spread)
    asked = _points(test, lag, moving, spread)
    blocks = _blocks(known)
    if len(blocks) < 2 or not any(len(p) for p in asked):
        return None
    own = []
    for i, block in enumerate(blocks):
        others = cKDTree(np.vstack([b for j, b in enumerate(blocks) if j != i]))
        own.append(others.query(block)[0])
    usual = float(np.quantile(np.concatenate(own), USUAL))
    everywhere = np.vstack(known)
    tree = cKDTree(everywhere)
    low = everywhere.min(axis=0)
    high = everywhere.max(axis=0)
    distances = [tree.query(p)[0] if len(p) else np.zeros(0) for p in asked]
    far = [
        (d > usual) & ((p >= low) & (p <= high)).all(axis=1) for d, p in zip(distances, asked, strict=True)
    ]
    shares = [float(f.mean()) if len(f) else 0.0 for f in far]
    worst = int(np.argmax(shares))
    return Nearness(
        usual=usual,
        typical=float(np.median(np.concatenate(distances))),
        far=float(np.concatenate(far).mean()),
        worst_segment=worst,
        worst_far=shares[worst],
    )


def _points(
    data: Dataset, lag: int, moving: FloatArray, spread: FloatArray, *, most: int = 5000
) -> list[FloatArray]:
    """Per segment (N, 2 n) its signals now and `lag` samples ago, in spreads; thinned where many.

    `most`: samples of either part.
    """
    found = []
    step = max(1, len(data) // most)
    for s in data.segments:
        x = np.hstack([s.u, s.y])[:, moving] / spread[moving]
        now = x[lag:][::step]
        found.append(np.hstack([now, x[: len(now) * step : step][: len(now)]]))
    return found


def _blocks(points: Sequence[FloatArray]) -> list[FloatArray]:
    """About ten pieces of consecutive samples, none across segments."""
    size = max(1, sum(map(len, points)) // _BLOCKS)
    return [b for p in points if len(p) for b in np.array_split(p, max(1, round(len(p) / size)))]
