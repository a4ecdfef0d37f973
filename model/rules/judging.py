"""Choosing among TS models without looking at the test: validation free run, one standard error, stability.

A model is judged by its free run over validation runs, cut into blocks; two models are compared block by
block, so that what is hard for both cancels. The simplest model whose mean square is within one standard
error of the best is taken (Breiman et al. 1984). A model that does not come back from bounded random inputs
is never offered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.model.rules.boundedness import is_bounded
from flysid.model.rules.free_run_error import started_run
from flysid.model.rules.likely_start import initial_states
from flysid.model.rules.linear_starts import LinearStart
from flysid.model.rules.recursion import unheld
from flysid.model.rules.regressor_layout import windows
from flysid.model.rules.search_settings import QUARTERS
from flysid.model.rules.stages import Stage, prior_of
from flysid.model.selection import block_means
from flysid.model.start import MAX_SHARE

INTEGRATES = (
    "The process integrates: its free run keeps the initial condition, and an input with a non-zero "
    "mean drives it to the output limits."
)
"""What users are told of a model that does not come back."""
EXACT = 1e-10
"""Mean squares, in variances of the output, that count as none."""
_LONGER = 3  # times what starts it, that a window of a judging part is at least long,
_SCORED = 5  # with so many rows at least to score
AWAY = 1e12
"""Mean square of what ran away, or may not be offered."""


def hold_out(train: Dataset, least: int, fold: int = 0) -> tuple[Dataset, Dataset]:
    """Training and validation parts of `train`: every fourth segment, or a quarter of each where few.

    Whole segments are held out where there are at least four long enough; otherwise one quarter of each,
    the last one in fold 0, earlier ones in folds 1 to 3. Nothing is drawn sample by sample.
    """
    usable = [s for s in train.segments if len(s) >= least]
    if len(usable) >= QUARTERS:
        held = [s for i, s in enumerate(usable) if i % QUARTERS == (2 + fold) % QUARTERS]
        kept = [s for i, s in enumerate(usable) if i % QUARTERS != (2 + fold) % QUARTERS]
        return train.with_segments(kept), train.with_segments(held)
    first: list[Segment] = []
    last: list[Segment] = []
    for segment in usable:
        n = len(segment)
        begin = n - (fold + 1) * (n // QUARTERS)
        end = n - fold * (n // QUARTERS)
        parts = [segment.slice(a, b, train.dt_s) for a, b in ((0, begin), (end, n)) if b - a >= least]
        if end - begin < least or not parts:
            first.append(segment)
            continue
        first += parts
        last.append(segment.slice(begin, end, train.dt_s))
    return train.with_segments(first), train.with_segments(last or first)


def free_run_errors(stage: Stage, runs: Sequence[FloatArray], window: int) -> list[FloatArray]:
    """(N - window, n_y) simulated minus measured outputs of every run, normalised.

    The first `window` rows only give the initial state, as in the comparison on held-out data: a choice
    must not hang on how well a few noisy samples start a high order. Hidden states start where they are
    most likely.
    """
    layout = stage.layout
    n_y = layout.n_y
    par = stage.problem.parameters(stage.body)
    par = par if layout.hidden else unheld(layout.lags, par)
    first = initial_states(layout, runs, par, prior_of(stage), window - layout.uncompared)
    limits = stage.problem.limits[:, :n_y]
    return [
        (np.clip(started_run(layout, W, x, par)[:, :n_y], *limits) - W[:, :n_y])[window:]
        for W, x in zip(runs, first, strict=True)
    ]


def judging_window(runs: Sequence[FloatArray], least: int) -> int:
    """Rows of every validation run that start the candidates: a tenth of the shortest, or `least`."""
    return max(least, int(MAX_SHARE * min(len(W) for W in runs)))


def blocks(errors: Sequence[FloatArray]) -> FloatArray:
    """Mean squares over about 16 blocks of consecutive samples; no block crosses a run's edge."""
    return block_means([np.mean(e * e, axis=1) for e in errors])


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model on a judging part, simplest first in every list.

    Attributes
    ----------
    errors : mean squares over about 16 blocks of one free run per segment.
    stable : it came back from bounded random inputs.
    linear : the model of the linear side that a stage of one rule comes from.
    moved : it was refined since.
    windows : mean squares over a few windows, each with a start of its own, so that what one manoeuvre left
        behind does not speak again in the next.
    """

    stage: Stage
    errors: FloatArray
    stable: bool = True
    linear: LinearStart | None = None
    moved: bool = True
    windows: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def mean(self) -> float:
        """Mean square of the validation free run, in units of the outputs' variance."""
        return float(self.errors.mean())


def judged(stage: Stage, runs: Sequence[FloatArray], skip: int, *, must_be_bounded: bool = True) -> Candidate:
    """A stage on judging runs, of which the first rows (at least `skip`) only start it; may it be offered?"""
    errors = blocks(free_run_errors(stage, runs, judging_window(runs, skip)))
    own = _window_errors(stage, runs, skip)
    stable = is_bounded(stage) if must_be_bounded else True
    return Candidate(stage, _finite(errors), stable, windows=_finite(own if len(own) else errors))


def _window_errors(stage: Stage, runs: Sequence[FloatArray], skip: int) -> FloatArray:
    """Mean squares of free runs over windows, cut alike for every depth, so that any two can be compared."""
    rows = max(sum(len(W) for W in runs) // QUARTERS, _LONGER * skip)
    pieces = [W for W in windows(runs, skip, rows) if len(W) > skip + _SCORED]
    return np.array([float((e * e).mean()) for e in free_run_errors(stage, pieces, skip)])


def _finite(errors: FloatArray) -> FloatArray:
    return np.where(np.isfinite(errors), np.minimum(errors, AWAY), AWAY)
