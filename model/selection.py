"""Choosing among fitted models by the free run on validation data, with the noise of that measure in mind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.base import Fitted

LEVEL = 0.01
"""Relative difference in mean square that nobody would pay an order for."""
FEWEST = 10
"""Samples that say anything at all, as a block, or beside those that start a model."""
HELD_OUT = 0.25
"""Of training data, where no part was given to choose on."""
STRONG = 10.0
"""A difference in BIC, or a squared gain over its variance: very strong evidence.

Kass & Raftery, 1995, J. Am. Stat. Assoc. 90.
"""


def parts_to_choose_on(train: Dataset) -> tuple[Dataset, Dataset]:
    """What candidates are fitted to and what they are judged on; raises DataError where there is too little.

    Whoever chooses on whole flights takes the same, so that a fit which several ask for is done once.
    """
    return train.split(holdout=HELD_OUT)


def block_errors(model: Fitted, data: Dataset, skip: int, scale: FloatArray) -> FloatArray:
    """Mean squared free-run errors of about 16 blocks of consecutive samples, outputs averaged.

    The first `skip` rows of every segment start the models and are left out; (0,) where nothing is left.

    Parameters
    ----------
    model : one that fits its start to the first n_init = `skip` samples, as candidates do: its run is that of
        `start.run_from_window`, without a search for it.
    scale : (n_y,) unit of every output's error.
    """
    errors = []
    for segment in data.segments:
        if len(segment) > skip:
            miss = (model.simulate(segment.u, segment.y[: model.n_init]) - segment.y)[skip:] / scale
            errors.append(np.mean(miss**2, axis=1))
    return block_means(errors)


def block_means(squares: Sequence[FloatArray], *, blocks: int = 16) -> FloatArray:
    """Means over about 16 blocks of consecutive samples; no block crosses a segment's edge."""
    size = max(sum(len(s) for s in squares) // blocks, 1)
    pieces = [p for s in squares if len(s) for p in np.array_split(s, max(round(len(s) / size), 1))]
    return np.array([p.mean() for p in pieces])


def standard_error(gap: FloatArray) -> float:
    """Of the mean of block differences (n,); 0 for a single block."""
    return float(gap.std(ddof=1) / np.sqrt(len(gap))) if len(gap) > 1 else 0.0


def clearly_better(new: FloatArray, old: FloatArray) -> bool:
    """The new block errors are lower than the old by more than one standard error of the difference, and by
    more than `LEVEL`."""
    if not len(new):
        return False
    gap = old - new
    return bool(gap.mean() > max(standard_error(gap), LEVEL * float(old.mean())))


def simplest(errors: Sequence[FloatArray], most_loss: float = np.inf, level: float = LEVEL) -> int:
    """Index of the first (simplest) within one standard error of the best (Breiman et al., 1984, 3.4.3).

    `most_loss` bounds what simplicity may cost, relative to the best mean square; `level` of it is always
    granted.
    """
    means = [float(e.mean()) if len(e) else np.inf for e in errors]
    best = int(np.argmin(means))
    for index, e in enumerate(errors[:best]):
        if len(e) == 0:
            continue
        gap = e - errors[best]
        allowed = max(standard_error(gap), level * means[best])
        if gap.mean() <= min(allowed, most_loss * means[best]):
            return index
    return best
