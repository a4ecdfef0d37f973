"""Straight lines in the data: a sensor's drift, wind that freshens, a trim that wanders.

"remove": every segment loses the least-squares line of each of its signals and keeps the means over all
segments, so that a fitted model still knows where the vehicle was. It serves every structure, and is exact
for what a constant and a line pass through a linear model as.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError

Trend = Literal["none", "remove", "estimate"]
TRENDS: tuple[Trend, ...] = ("none", "remove", "estimate")


def check_trend(trend: str, allowed: tuple[str, ...] = TRENDS) -> None:
    """Raise UsageError for a trend that is not offered."""
    if trend not in allowed:
        raise UsageError(f"trend is {trend!r}", hint=f"one of {', '.join(map(repr, allowed))}")


def detrend(data: Dataset, trend: Trend = "remove") -> Dataset:
    """The dataset with lines taken out of every segment; itself unless `trend` is "remove".

    Segments of fewer than 3 samples lose their means alone.
    """
    if trend != "remove" or not len(data):
        return data
    segments = [s for s in data.segments if len(s)]
    u_mean = np.concatenate([s.u for s in segments]).mean(axis=0)
    y_mean = np.concatenate([s.y for s in segments]).mean(axis=0)
    flat = [_without_line(s.u) for s in segments], [_without_line(s.y) for s in segments]
    return data.with_segments(
        [replace(s, u=u + u_mean, y=y + y_mean) for s, u, y in zip(segments, *flat, strict=True)]
    )


def _without_line(values: FloatArray) -> FloatArray:
    """Columns minus their least-squares line over the row number."""
    centred = values - values.mean(axis=0)
    if len(values) < 3:
        return np.asarray(centred)
    rows = np.arange(len(values), dtype=np.float64) - (len(values) - 1) / 2.0
    return np.asarray(centred - np.outer(rows, rows @ centred / (rows @ rows)))
