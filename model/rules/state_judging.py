"""What may be offered and what is best: validation free run, boundedness, where a plant itself saturates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.rules.contraction import is_contracting
from flysid.model.rules.free_run_error import Stage, started_run
from flysid.model.rules.judging import blocks, judging_window, prior_of
from flysid.model.rules.kernel import free_run
from flysid.model.rules.probe_inputs import probe_run
from flysid.model.rules.realisation import initial_states
from flysid.model.rules.regressor_layout import windows

_AT_END = 2e-3  # of an output's range: this near the extreme counts as at it
_CORNER = 0.01  # of the range: an output that arrives at an end this fast per sample has hit it
_STAY = 5  # samples that it must stay there
_VISITS = 2  # times that it must have happened
_STEPS = 3000  # of random inputs
_WINDOWS = 4  # that a judging part is cut into,
_LONGER = 3  # each at least this many times as long as what starts it,
_SCORED = 5  # with so many rows at least to score
_AWAY = 1e12  # mean square of what ran away


@dataclass(frozen=True, eq=False)
class Judged:
    """A stage on a judging part.

    Attributes
    ----------
    errors : mean squares over about 16 blocks of one free run per segment.
    windows : mean squares over a few windows, each with a start of its own, so that what one manoeuvre left
        behind does not speak again in the next.
    bounded : it came back from bounded random inputs.
    """

    stage: Stage
    errors: FloatArray
    windows: FloatArray
    bounded: bool

    @property
    def mean(self) -> float:
        """Mean square of the validation free run, in units of the outputs' variance."""
        return float(self.errors.mean())


def free_run_errors(stage: Stage, runs: Sequence[FloatArray], window: int) -> list[FloatArray]:
    """(N - window, n_y) simulated minus measured outputs of every run, started from its first rows."""
    par = stage.problem.parameters(stage.body)
    n_y = stage.layout.n_y
    rows = window - stage.layout.depth + 1
    first = initial_states(stage.layout, runs, par, prior_of(stage), rows)
    pairs = zip(runs, first, strict=True)
    return [(started_run(stage.layout, W, x, par) - W)[window:, :n_y] for W, x in pairs]


def judged(stage: Stage, runs: Sequence[FloatArray], least: int) -> Judged:
    """A stage on validation runs, of which the first rows (at least `least`) only start it."""
    errors = blocks(free_run_errors(stage, runs, judging_window(runs, least)))
    rows = max(sum(len(W) for W in runs) // _WINDOWS, _LONGER * least)
    # cut alike for every depth, so that any two models are compared window by window
    pieces = [W for W in windows(runs, least, rows) if len(W) > least + _SCORED]
    own = [float((e * e).mean()) for e in free_run_errors(stage, pieces, least)]
    return Judged(stage, _finite(errors), _finite(np.array(own)), is_bounded(stage))


def _finite(errors: FloatArray) -> FloatArray:
    return np.where(np.isfinite(errors), np.minimum(errors, _AWAY), _AWAY)


def is_bounded(stage: Stage, seed: int = 0) -> bool:
    """Whether the free run stays off its limits under the training inputs in random order.

    Before that come random steps over the whole range of the inputs, which may push any plant far out. Ends
    at which the plant itself saturates are no limits in this sense. It must also forget how it was
    started, in its hidden states above all (`flysid.model.rules.contraction`).
    """
    problem = stage.problem
    layout = stage.layout
    n = layout.n
    W = probe_run(problem.runs, n, _STEPS, seed)
    free_run(W, layout.depth, layout.lags, problem.parameters(stage.body))
    seen = np.vstack([r[layout.depth - 1 :, :n] for r in stage.simulated()])
    margin = 0.5 * np.ptp(seen, axis=0)
    states = W[_STEPS + _STEPS // 4 :, :n]
    out = (states < seen.min(axis=0) - margin) | (states > seen.max(axis=0) + margin)
    if not (np.isfinite(states).all() and out.any(axis=1).mean() < 0.02):
        return False
    ends = np.stack([seen.min(axis=0), seen.max(axis=0)])
    return is_contracting(problem.runs, ends, layout.depth, layout.lags, problem.parameters(stage.body))


def saturation_limits(data: Dataset) -> FloatArray:
    """(2, n_y) outputs at which the plant or its sensor saturates; infinite where it does not.

    An end is the same extreme value, reached or left with a corner (fast, then standing still) at least
    twice: a tank that overflows, a stop that is hit, a sensor at its end. A smooth peak has no corner.
    """
    ends = np.array([[-np.inf], [np.inf]]) * np.ones(len(data.outputs))
    for i in range(len(data.outputs)):
        y = [s.y[:, i] for s in data.segments]
        for side, sign in enumerate((-1.0, 1.0)):
            ends[side, i] = sign * _upper_end([sign * v for v in y])
    return ends


def _upper_end(y: Sequence[FloatArray]) -> float:
    """The level at which y saturates above; inf where it does not."""
    top = max(float(v.max()) for v in y)
    span = top - min(float(v.min()) for v in y)
    bends = np.concatenate([np.abs(np.diff(v, n=2)) for v in y if len(v) > 2])
    noise = float(np.median(bends)) / (0.6745 * np.sqrt(6.0)) if len(bends) else 0.0
    steps = np.concatenate([np.abs(np.diff(v)) for v in y])
    quantum = float(steps[steps > 0].min(initial=span)) if len(steps) else span
    coarse = 4.0 * quantum if quantum > 1e-3 * span else 0.0
    near = min(max(_AT_END, 4.0 * noise / span), _CORNER) * span if span > 0 else 0.0
    corner = max(_CORNER * span, 6.0 * noise, coarse)
    levels = [level for v in y for level in _visits(v, top - near, corner)]
    return float(np.median(levels)) if len(levels) >= _VISITS else np.inf


def _visits(y: FloatArray, threshold: float, corner: float) -> list[float]:
    """The median of y in every stay above a threshold that begins or ends with a corner."""
    at = np.concatenate([[0], (y >= threshold).astype(np.int8), [0]])
    edges = np.flatnonzero(np.diff(at))
    levels = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        arrival = y[begin] - y[begin - 1] if begin else 0.0
        leaving = y[end - 1] - y[end] if end < len(y) else 0.0
        if end - begin >= _STAY and max(arrival, leaving) > corner:
            levels.append(float(np.median(y[begin:end])))
    return levels
