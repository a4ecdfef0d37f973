"""Whether a free run comes back from bounded inputs, and forgets how it was started.

Rules can run away under inputs that training never held for long, and they can hold a model at two places at
once: a run that starts a little off then ends elsewhere and stays there, inside all limits, while the record,
started well, is followed closely. A stable linear model forgets its start always (its modes decay); of rules
it is asked by runs on the same inputs from starts far apart, the sampled form of a contraction (Lohmiller and
Slotine 1998).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.free_run_error import range_of, widen
from flysid.model.rules.kernel import Lags, Parameters, free_run
from flysid.model.rules.recursion import rule_radius
from flysid.model.rules.stages import Stage

FAR = 10.0
"""Ranges: in a closed loop an output that integrates is never seen to move as it can."""
_NEAR = 0.5  # of what was seen: hidden states, and outputs beside them, that are farther out have left it
PUSHES = 3000
"""Random inputs, then as many shuffled ones."""
_RARELY = 0.02  # of the samples
_ROUNDING = float(np.cbrt(np.finfo(float).eps))  # of a pole at one that stands up to three times
_RUN_STEPS = (3000, 30_000)  # at least, and at most; between them as long as the training runs together


def is_bounded(stage: Stage) -> bool:
    """Whether the free run comes back from bounded random inputs, and stays near under usual ones.

    First random steps over the whole range of the training inputs, which may push any plant far out; then
    blocks of the training inputs in random order. In that second part no more than one sample in fifty may
    lie on an output limit (the range of training, widened by itself on each side) or, with hidden states,
    half the range beyond what was simulated: ends at which a plant itself saturates are no limits in this
    sense. The model must also forget how it was started (`is_contracting`). Of a model that holds an
    integrator the changes of the output are asked instead (the range widened tenfold), as its output may go
    anywhere. Lags are held at the limits here, those of a single rule too (`drop_held`): one that stays there
    is too near to instability.
    """
    problem = stage.problem
    layout = stage.layout
    par = problem.parameters(stage.body)
    W = probe_run(problem.runs, layout.n, PUSHES, seed=0)
    free_run(W, layout.depth, layout.lags, par)
    x = W[PUSHES + PUSHES // 4 :, : layout.n]
    limits = problem.limits
    seen = [run[layout.uncompared :, : layout.n] for run in stage.simulated()]
    if layout.hidden:
        limits = widen(range_of(seen), _NEAR)
    if problem.integrates:
        if not all(rule_radius(layout.lags, rule) < 1.0 + _ROUNDING for rule in par.theta):
            return False  # behind an integrator it would drift away
        x = np.diff(x, axis=0)
        limits = widen(range_of([np.diff(run, axis=0) for run in seen]), FAR)
    if not _share_at(x, limits) < _RARELY:
        return False
    return problem.integrates or is_contracting(problem.runs, range_of(seen), layout.depth, layout.lags, par)


def _share_at(x: FloatArray, limits: FloatArray) -> float:
    """Share of the rows of x (N, n) in which a column is at a limit, beyond it, or no number."""
    return float((~((x > limits[0]) & (x < limits[1]))).any(axis=1).mean())


def is_contracting(
    runs: Sequence[FloatArray],
    seen: FloatArray,
    depth: int,
    lags: Lags,
    par: Parameters,
    *,
    apart: float = 0.25,
) -> bool:
    """Whether runs from the ends of what was seen come together under the training inputs, shuffled.

    Parameters
    ----------
    runs : (N, n + n_u) normalised training runs; of them only the inputs matter.
    seen : (2, n) smallest and largest simulated quantities: outputs, or states.
    depth : first row that is simulated.
    apart : of what was seen, in the end of a run; starts at its ends are half of it from the middle.
    """
    n = seen.shape[1]
    steps = int(np.clip(sum(len(W) for W in runs), *_RUN_STEPS))
    W = probe_run(runs, n, steps, seed=0)[steps:]
    middle = seen.mean(axis=0)
    last = len(W) - len(W) // 4
    reach = np.where(seen[1] > seen[0], seen[1] - seen[0], 1.0)
    reference = _run(W, middle, depth, lags, par)[last:]
    for start in _starts(seen, middle):
        gap = np.abs(_run(W, start, depth, lags, par)[last:] - reference) / reach
        if not (gap > apart).any(axis=1).mean() < _RARELY:
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


def probe_run(runs: Sequence[FloatArray], n_y: int, steps: int, seed: int) -> FloatArray:
    """W (2 steps, n_y + n_u): `steps` random inputs in the training range, then training ones shuffled.

    Random ones are held, and training ones kept together, for a 200th of the training inputs.
    """
    rng = np.random.default_rng(seed)
    pool = np.vstack([W[:, n_y:] for W in runs])
    low = pool.min(axis=0)
    high = pool.max(axis=0)
    hold = max(2, len(pool) // 200)
    count = -(-steps // hold)
    begins = rng.integers(0, max(1, len(pool) - hold), size=count)
    usual = np.vstack([pool[b : b + hold] for b in begins])[:steps]
    wild = np.repeat(rng.uniform(low, high, (count, len(low))), hold, axis=0)[:steps]
    W = np.zeros((2 * steps, n_y + len(low)))
    W[:, n_y:] = np.vstack([wild, usual])
    return W
