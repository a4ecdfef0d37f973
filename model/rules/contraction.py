"""Whether a free run forgets how it was started.

Rules can hold a model at two places at once: a run that starts a little off then ends elsewhere and stays
there, inside all limits, while the training record, started well, is followed closely. A stable linear model
forgets its start always (its modes decay); of rules it is asked by runs on the same inputs from starts far
apart, the sampled form of a contraction (Lohmiller and Slotine 1998).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.kernel import Lags, Parameters, free_run
from flysid.model.rules.probe_inputs import probe_run

_STEPS = (3000, 30_000)  # at least, and at most; between them as long as the training runs together
_APART = 0.25  # of what was seen, in the end of a run; starts at its ends are half of it from the middle
_RARELY = 0.02  # of the samples


def is_contracting(
    runs: Sequence[FloatArray], seen: FloatArray, depth: int, lags: Lags, par: Parameters
) -> bool:
    """Whether runs from the ends of what was seen come together under the training inputs, shuffled.

    Parameters
    ----------
    runs : (N, n + n_u) normalised training runs; of them only the inputs matter.
    seen : (2, n) smallest and largest simulated quantities: outputs, or states.
    depth : first row that is simulated.
    """
    n = seen.shape[1]
    steps = int(np.clip(sum(len(W) for W in runs), *_STEPS))
    W = probe_run(runs, n, steps, seed=0)[steps:]
    middle = seen.mean(axis=0)
    last = len(W) - len(W) // 4
    reach = np.where(seen[1] > seen[0], seen[1] - seen[0], 1.0)
    reference = _run(W, middle, depth, lags, par)[last:]
    for start in _starts(seen, middle):
        gap = np.abs(_run(W, start, depth, lags, par)[last:] - reference) / reach
        if not (gap > _APART).any(axis=1).mean() < _RARELY:
            return False
    return True


def _starts(seen: FloatArray, middle: FloatArray) -> Iterator[FloatArray]:
    """Everything at one end; where there are several quantities, each alone at either end too."""
    yield from seen
    for end in seen if len(middle) > 1 else ():
        for j in range(len(middle)):
            yield np.where(np.arange(len(middle)) == j, end, middle)


def _run(W: FloatArray, start: FloatArray, depth: int, lags: Lags, par: Parameters) -> FloatArray:
    run = W.copy()
    run[:depth, : len(start)] = start
    free_run(run, depth, lags, par)
    return run[:, : len(start)]
