"""One judge of all candidates: the free run over blocks that a model had no part of.

A quarter of the training data is left out, the model refined by a few steps on the rest, and run free over
the record: what it misses in the quarter counts, and every quarter is left out in turn. So all candidates
learn from all data, and no choice hangs on which part happened to be held out. Where a validation part is
given, its blocks judge instead.

Candidates are compared block by block, in logarithms, so that what is hard for both cancels and no manoeuvre
that is hard for all decides alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.polynomials import VANISHING
from flysid.model.rules.free_run_error import started_run
from flysid.model.rules.likely_start import initial_states
from flysid.model.rules.linear_starts import LinearStart
from flysid.model.rules.recursion import drop_held
from flysid.model.rules.stages import Stage, prior_of
from flysid.model.selection import FEWEST, block_means, standard_error
from flysid.model.start import MAX_SHARE

INTEGRATES = (
    "The process integrates: its free run keeps the initial condition, and an input with a non-zero "
    "mean drives it to the output limits."
)
"""What users are told of a model that does not come back."""
AWAY = 1.0 / VANISHING
"""Mean square of what ran away, or may not be offered."""
BLOCKS = 16
"""Of the training data, about, over which errors are compared."""
PARTS = 4
"""Of consecutive blocks, each left out in turn."""
_STEPS = 4  # of a model's refinement without a part


@dataclass(frozen=True, eq=False)
class Candidate:
    """A trained model and what the judge says of it.

    Attributes
    ----------
    errors : mean squares over blocks that it had no part of, in variances of the outputs.
    stable : it came back from bounded random inputs, or need not.
    linear : the model of the linear side that a stage of one rule comes from.
    origin : over hidden states, the linear system it was grown from, and what its states are.
    may_grow : rules are grown from it.
    """

    stage: Stage
    errors: FloatArray
    stable: bool = True
    linear: LinearStart | None = None
    origin: str = ""
    may_grow: bool = True

    @property
    def logs(self) -> FloatArray:
        """(blocks,) logarithms of the mean squares; those of the worst where it is not bounded."""
        return np.log(self.errors if self.stable else np.full(len(self.errors), AWAY))

    @property
    def score(self) -> float:
        """Mean logarithm of the mean squares: what candidates are ranked by."""
        return float(self.logs.mean())

    @property
    def rmse(self) -> float:
        """Typical error in standard deviations of the output."""
        return float(np.exp(0.5 * self.score))


def left_out(stage: Stage) -> FloatArray:
    """(blocks,) mean squares over blocks of the training runs, by a model refined without their part.

    A part is a few blocks in a row: what noise lasts, or a slow mode, would tell a single block from its
    neighbours. The runs start as the whole data have it: what a start is worth is no property of the model.
    """
    known = _blocks(stage)
    found: list[float] = []
    for part in np.array_split(np.arange(len(known)), min(PARTS, len(known))):
        own = [known[i] for i in part]
        found += _missed(stage, _without(stage, own), own)
    return within_reach(np.array(found))


Block = tuple[int, int, int]
"""Of a run: its number, first row, row after the last."""


def _blocks(stage: Stage) -> list[Block]:
    """About `BLOCKS` of consecutive rows, as many for every model; no block crosses a run's edge."""
    runs = stage.problem.runs
    size = sum(map(len, runs)) / BLOCKS
    found = []
    for at, W in enumerate(runs):
        edges = np.linspace(stage.layout.depth, len(W), max(round(len(W) / size), 1) + 1).astype(int)
        found += [(at, a, b) for a, b in itertools.pairwise(edges.tolist()) if b > a]
    return found


def _without(stage: Stage, part: Sequence[Block]) -> Stage | None:
    """The stage after a few steps on what is beside a part; None where nothing is, or they lead nowhere.

    What follows the part starts where the model is then.
    """
    depth = stage.layout.depth
    pieces: list[FloatArray] = []
    starts: list[FloatArray] = []
    for at, (W, run) in enumerate(zip(stage.problem.runs, stage.simulated(), strict=True)):
        rows = [row for number, *rows in part if number == at for row in rows]
        edges = [(0, min(rows)), (max(rows) - depth, len(W))] if rows else [(0, len(W))]
        for begin, end in edges:
            if end - begin >= depth + FEWEST:
                pieces.append(np.ascontiguousarray(W[begin:end]))
                starts.append(run[begin:end])
    if not pieces:
        return None
    apart = replace(stage.under(runs=tuple(pieces)), initial=stage.problem.starts(starts))
    found = apart.refined(_STEPS, 1e-4)
    return found if np.isfinite(found.cost) else None


def _missed(stage: Stage, apart: Stage | None, part: Sequence[Block]) -> list[float]:
    """Mean squares over the blocks of a part, by another model's numbers."""
    if apart is None:
        return [AWAY] * len(part)
    par = apart.problem.parameters(apart.body)
    n_y = stage.layout.n_y
    found = []
    for at, begin, end in part:
        W = stage.problem.runs[at][:end]
        gap = (started_run(stage.layout, W, stage.initial[at], par) - W)[begin:, :n_y]
        found.append(float((gap * gap).mean()))
    return found


def followed(stage: Stage, runs: Sequence[FloatArray], least: int) -> FloatArray:
    """(blocks,) mean squares of the free run over a validation part, after what starts it.

    Parameters
    ----------
    least : rows that start every run at least; a tenth of the shortest where that is more.
    """
    window = max(least, int(MAX_SHARE * min(len(W) for W in runs)))
    errors = free_run_errors(stage, runs, window)
    return within_reach(block_means([np.mean(e * e, axis=1) for e in errors], blocks=BLOCKS))


def free_run_errors(stage: Stage, runs: Sequence[FloatArray], window: int) -> list[FloatArray]:
    """(N - window, n_y) simulated minus measured outputs of every run, normalised.

    The first `window` rows only give the initial state, as in the comparison on held-out data: a choice
    must not hang on how well a few noisy samples start a high order.
    """
    layout = stage.layout
    n_y = layout.n_y
    par = stage.problem.parameters(stage.body)
    par = par if layout.hidden else drop_held(layout.lags, par)
    first = initial_states(layout, runs, par, prior_of(stage), window - layout.uncompared)
    limits = stage.problem.limits[:, :n_y]
    return [
        (np.clip(started_run(layout, W, x, par)[:, :n_y], *limits) - W[:, :n_y])[window:]
        for W, x in zip(runs, first, strict=True)
    ]


def within_reach(errors: FloatArray) -> FloatArray:
    """Mean squares between what vanishes and what is away."""
    return np.where(np.isfinite(errors), np.clip(errors, VANISHING, AWAY), AWAY)


def gap_between(one: Candidate, other: Candidate) -> FloatArray:
    """By how much the first errs more, in logarithms, block by block; on the whole where blocks differ."""
    if len(one.errors) == len(other.errors):
        return np.asarray(one.logs - other.logs)
    return np.array([one.score - other.score])


def fewest(candidates: Sequence[Candidate], gain: float) -> int:
    """Index of the first (simplest) that is not clearly worse than the best: one standard error, or `gain`.

    Parameters
    ----------
    gain : share of the mean square that what is less simple must win, however sure it is.
    """
    best = min(candidates, key=lambda c: c.score)
    for i, one in enumerate(candidates):
        gap = gap_between(one, best)
        if one is best or gap.mean() <= max(standard_error(gap), gain) or one.errors.max() <= VANISHING:
            return i
    return 0


def in_words(candidates: Sequence[Candidate]) -> str:
    """ "1: 0.183 +- 0.012, 2: 0.134, 3: not bounded"; +- is a standard error of the distance to the best."""
    best = min(candidates, key=lambda c: c.score)
    said = []
    for one in candidates:
        if not one.stable:
            said.append(f"{one.stage.rules}: not bounded")
            continue
        spread = 0.5 * one.rmse * standard_error(gap_between(one, best))
        said.append(f"{one.stage.rules}: {one.rmse:.3g}" + (f" +- {spread:.2g}" if spread > 0.0 else ""))
    return ", ".join(said)
