"""Where a plant or its sensor saturates: an end of its travel, seen in the data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import Dataset, FloatArray

_AT_END = 2e-3  # of an output's range: this near the extreme counts as at it
_CORNER = 0.01  # of the range: an output that arrives at an end this fast per sample has hit it
_STAY = 5  # samples that it must stay there
_VISITS = 2  # times that it must have happened


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


def in_words(ends: FloatArray, train: Dataset) -> list[str]:
    """A sentence about every end."""
    return [
        f"{signal.name} {word} {ends[side, i]:.4g} {signal.unit}".rstrip()
        + ", where it stopped repeatedly: taken as a saturation limit."
        for side, word in enumerate(("never falls below", "never exceeds"))
        for i, signal in enumerate(train.outputs)
        if np.isfinite(ends[side, i])
    ]


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
