"""Find the pairs of flights that share a stretch, without comparing every pair.

Every window of the training flights is a point: its slow shape (the first cosines), whatever its size and
mean. Windows of a held-out flight look for points near by in a tree. A copy agrees in each window that both
have whole, but for what the other recorder did to it: how far it may lie away is a share of the flight's
spread, so that windows in which much happens ask for less.

Half a sample is the most by which another recorder's samples lie off; the points stand half a sample apart.
What is found so is measured (docs/measured/alignment.md), not proven: few flights are compared pair by pair.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.fft import dct
from scipy.spatial import cKDTree

from flysid.leakage.alike import SAME_OUTPUT
from flysid.stretch import FloatArray

Indices = npt.NDArray[np.int64]

SLOWEST = 4  # times slower than the flight's grid another recorder may sample: what is faster is noise
COARSEST = 0.3  # of the spread: its rounding
WINDOW = 48  # samples; five times as many, with the step, has a flight whose every copy shares a window whole
STEP = WINDOW // 6  # samples between the windows of a held-out flight
COSINES = WINDOW // SLOWEST  # up to half the slowest recorder's rate
APART = SAME_OUTPUT + COARSEST / np.sqrt(12.0 * SLOWEST)  # of the spread: what rounding leaves in these
FARTHEST = 0.2  # of a window's size: beyond it, windows are not alike
POINTS = 1 << 18  # in a tree: some 50 MB
SLOW_SHAPES = dct(np.eye(WINDOW), norm="ortho", axis=0)[1 : COSINES + 1].T
"""(WINDOW, COSINES) the first cosines."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows as points.

    `points`: (n, COSINES) shapes, in units of each window's size.
    `size`: (n,) root mean square of each, without its mean.
    `flight`: (n,) whose they are.
    """

    points: FloatArray
    size: FloatArray
    flight: Indices


def sure_overlap() -> int:
    """Any overlap of so many samples holds a window of the held-out flight."""
    return WINDOW + STEP


def pairs_alike(
    theirs: Sequence[FloatArray],
    mine: Sequence[FloatArray],
    *,
    apart: float = APART,
    farthest: float = FARTHEST,
) -> Iterator[tuple[int, int]]:
    """Numbers of a flight of `mine` and one of `theirs` that have a window in common, each pair once.

    `theirs`, `mine`: one output of every flight, without gaps.
    `apart`: how far a copy may lie from the flight, root mean square over a window, of the flight's spread.
    `farthest`: of a window's size: beyond it, windows are not alike.
    """
    if not len(theirs) or not len(mine):
        return
    sought = _join([_choose(y, i) for i, y in enumerate(mine)])
    spread = np.array([np.std(y) for y in mine])[sought.flight]
    reach = np.minimum(apart * spread / np.maximum(sought.size, 1e-300), farthest)
    for first, last in _batches([len(y) for y in theirs]):
        known = _join([_known(y, k) for k, y in enumerate(theirs[first:last], start=first)])
        tree = cKDTree(known.points, balanced_tree=False)
        found = tree.query_ball_point(sought.points, reach)
        near = [known.flight[np.array(hits, dtype=np.int64)] for hits in found]
        flights = np.repeat(sought.flight, [len(hits) for hits in near])
        both = np.unique(np.stack([flights, np.concatenate(near)], axis=1), axis=0)
        yield from ((int(i), int(k)) for i, k in both)


def _batches(lengths: Sequence[int]) -> Iterator[tuple[int, int]]:
    """From which flight to which, with at most POINTS points, or one flight."""
    first = 0
    points = 0
    for k, length in enumerate(lengths):
        if points and points + 2 * length > POINTS:
            yield first, k
            first = k
            points = 0
        points += 2 * length
    yield first, len(lengths)


def _known(y: FloatArray, flight: int) -> Windows:
    """Every window of a flight, and every one half a sample later."""
    between = (y[1:] + y[:-1]) / 2.0
    return _join([_windows(y, flight, 1), _windows(between, flight, 1)])


def _choose(y: FloatArray, flight: int) -> Windows:
    """Some windows of a flight, but those in which less happens than in both beside them."""
    every = _windows(y, flight, STEP)
    beside = np.concatenate([[np.inf], every.size, [np.inf]])
    kept = every.size >= np.minimum(beside[:-2], beside[2:])
    return Windows(every.points[kept], every.size[kept], every.flight[kept])


def _windows(y: FloatArray, flight: int, step: int) -> Windows:
    """Windows that begin every `step` samples; what stands still has no shape."""
    if len(y) < WINDOW:
        return Windows(np.empty((0, COSINES)), np.empty(0), np.empty(0, dtype=np.int64))
    cut = np.lib.stride_tricks.sliding_window_view(y, WINDOW)[::step]
    shapes = cut @ SLOW_SHAPES
    size = np.sqrt(np.maximum((cut**2).mean(axis=1) - cut.mean(axis=1) ** 2, 0.0))
    moves = size > 1e-9 * (np.abs(cut).max(axis=1) + 1e-300)
    points = shapes[moves] / (size[moves] * np.sqrt(WINDOW))[:, None]
    return Windows(points, size[moves], np.full(int(moves.sum()), flight, dtype=np.int64))


def _join(parts: Sequence[Windows]) -> Windows:
    return Windows(
        np.concatenate([p.points for p in parts]),
        np.concatenate([p.size for p in parts]),
        np.concatenate([p.flight for p in parts]),
    )
