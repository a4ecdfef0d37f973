"""Choosing among fitted models by the free run on validation data, with the noise of that measure in mind."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.model.base import Fitted
from flysid.model.shared import Itself, digest, once
from flysid.model.start import Timed, drifting_of, judging_rows, run_from_window
from flysid.split import cut, resolve_way

LEVEL = 0.01
"""Relative difference in mean square that nobody would pay an order for."""
MARGIN = 0.05
"""Relative difference of errors below which two models serve alike; verdicts call them the same."""
LOST = 1e6
"""Times the output's spread: what an error that is no number counts as."""
FEWEST = 10
"""Samples that say anything at all, as a block, or beside those that start a model."""
HELD_OUT = 0.25
"""Of training data, where no part was given to choose on."""
STRONG = 10.0
"""A difference in BIC, or a squared gain over its variance: very strong evidence.

Kass & Raftery, 1995, J. Am. Stat. Assoc. 90.
"""


class FreeRunning(Timed, Protocol):
    """Requirements on a model whose free run is judged."""

    @property
    def output_limits(self) -> FloatArray: ...


def in_flight_order(data: Dataset) -> Dataset:
    """The same segments by the names of their flights and by time.

    Parts are held out by their place in the list, and what is found must not hang on how flights are listed.

    >>> from flysid.model.selection import in_flight_order
    >>> (segment,) = train.segments  # train: see `flysid.Dataset`
    >>> late = segment.slice(100, 600, train.dt_s)
    >>> [s.t0_ns for s in in_flight_order(train.with_segments([late, segment])).segments]
    [0, 10000000000]
    """
    ordered = tuple(sorted(data.segments, key=lambda s: (s.flight, s.t0_ns)))
    return data if ordered == data.segments else data.with_segments(ordered)


def _asked(train: Dataset, *, seed: int = 0, guard_s: float | None = None) -> Hashable:
    """All that a part holds; a guard counts only where time is split."""
    guard = guard_s if resolve_way("auto", len(train.flights)) == "time" else None
    places = tuple((s.t0_ns, *s.marks.items()) for s in train.segments)
    return digest(train), train.name, places, seed, guard


@once(_asked)
def parts_to_choose_on(
    train: Dataset, *, seed: int = 0, guard_s: float | None = None
) -> tuple[Dataset, Dataset]:
    """What candidates are fitted to and what they are judged on.

    Whoever chooses on whole flights takes the same, so that a fit which several need is done once. A held-out
    block of a flight begins with the guard before it, which serves neither part: runs start there, and few
    rows of the block are lost to their start. Within `sharing()` equal data are split once.

    `seed`, `guard_s`: as `flysid.Dataset.split` takes them.
    Raises DataError: there is too little.
    """
    split = train.plan_split(holdout=HELD_OUT, seed=seed, guard_s=guard_s)
    lead = round(split.guard_s / train.dt_s)
    fit, _ = split.apply(train)
    return fit, cut(train, [replace(piece, start=max(piece.start - lead, 0)) for piece in split.test])


def block_errors(model: Fitted, data: Dataset, skip: int, scale: FloatArray) -> FloatArray:
    """Mean squared free-run errors of about 16 blocks of consecutive samples, outputs averaged.

    The first `skip` rows of every segment start the models and are left out; (0,) where nothing is left.

    `model`: one that fits its start to the first n_init = `skip` samples, as candidates do: its run is that
        of `start.run_from_window`, without a search for it. An unstable one starts from its first lags.
    `scale`: (n_y,) unit of every output's error.
    """
    errors = []
    for segment in data.segments:
        if len(segment) > skip:
            miss = (model.simulate(segment.u, segment.y[: model.n_init]) - segment.y)[skip:] / scale
            errors.append(np.mean(miss**2, axis=1))
    return block_means(errors)


def free_run_errors(models: Mapping[str, FreeRunning], check: Dataset) -> dict[str, FloatArray]:
    """Mean squared free-run errors of blocks of a part of the data, in variances of the outputs.

    All models start alike: each estimates its first lags from the same window of measured samples, which is
    left out. Where one leaves out the constants of flights, so do all. Raises DataError: no segment is long
    enough.
    """
    return {name: errors for name, (errors, _) in judge_free_runs(models, check).items()}


def judge_free_runs(models: Mapping[str, FreeRunning], check: Dataset) -> dict[str, tuple[FloatArray, bool]]:
    """Errors and exceptions of `free_run_errors`, and whether the model ever reached its output limits."""
    lags = max(model.n_init for model in models.values())
    windows = [judging_rows(lags, len(s), check.dt_s) for s in check.segments]
    scored = [(s, w) for s, w in zip(check.segments, windows, strict=True) if len(s) >= w + FEWEST]
    if not scored:
        raise DataError(f"no segment has {FEWEST} samples beside those that start the models")
    judged = check.with_segments([s for s, _ in scored])
    starts = tuple(w for _, w in scored)
    drifting = drifting_of(models.values())
    return {name: _judge_free_run(model, judged, starts, drifting) for name, model in models.items()}


@once(lambda model, data, windows, drifting: (Itself(model), digest(data), windows, drifting))
def _judge_free_run(
    model: FreeRunning, data: Dataset, windows: tuple[int, ...], drifting: tuple[bool, ...] | None
) -> tuple[FloatArray, bool]:
    """One model's answer of `judge_free_runs`; within `sharing()` it runs over equal data once.

    `windows`: rows of every segment that start the model.
    """
    scored = list(zip(data.segments, windows, strict=True))
    scale = np.std(np.concatenate([s.y[w:] for s, w in scored]), axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    squares = []
    lost = False
    (low, high) = model.output_limits
    for s, window in scored:
        run = run_from_window(model, s, window, drifting)[window:]
        lost = lost or bool(((run <= low) | (run >= high) | ~np.isfinite(run)).any())
        gaps = np.nan_to_num((s.y[window:] - run) / scale, nan=LOST, posinf=LOST, neginf=-LOST)
        squares.append(np.mean(np.clip(gaps, -LOST, LOST) ** 2, axis=1))
    return block_means(squares), lost


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
