"""Fewer points, the same picture: minimum and maximum of every bucket, on one time axis for all series."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray


def decimate(
    t: FloatArray, series: Mapping[str, FloatArray], points: int
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """At most about `points` samples of every series (N,), as they are where N is smaller.

    A bucket becomes two samples: its minimum and maximum in the order in which they occur, so that no peak is
    lost. They stand at the bucket's first and middle time, for all series alike.
    """
    n = len(t)
    if n <= points:
        return t, dict(series)
    size = int(np.ceil(n / max(1, points // 2)))
    starts = np.arange(0, n, size)
    middle = np.minimum(starts + size // 2, n - 1)
    times = np.unique(np.ravel(np.column_stack([t[starts], t[middle]])))
    if len(times) != 2 * len(starts):  # the last bucket holds one sample
        starts = starts[:-1]
        middle = middle[:-1]
        times = np.ravel(np.column_stack([t[starts], t[middle]]))
    return times, {name: _extremes(values, starts, size) for name, values in series.items()}


def _extremes(values: FloatArray, starts: npt.NDArray[np.int_], size: int) -> FloatArray:
    out = np.empty(2 * len(starts))
    for i, start in enumerate(starts):
        bucket = values[int(start) : int(start) + size]
        low = int(np.argmin(bucket))
        high = int(np.argmax(bucket))
        out[2 * i], out[2 * i + 1] = bucket[min(low, high)], bucket[max(low, high)]
    return out


def round_for_json(values: FloatArray, digits: int = 4) -> list[float | None]:
    """Values for JSON: `digits` digits of the series' range, null where not finite."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return [None] * len(values)
    reach = float(np.max(np.abs(finite - finite.mean()))) or float(np.max(np.abs(finite))) or 1.0
    places = int(np.clip(digits - np.ceil(np.log10(reach)), 0, 12))
    out = np.round(values, places)
    return [float(v) + 0.0 if np.isfinite(v) else None for v in out]


def extremes(values: FloatArray, size: int) -> npt.NDArray[np.intp]:
    """Indices of the lowest and the highest of every `size` values, and of the NaNs, in order; (M,)."""
    n = len(values)
    if size <= 2:
        return np.arange(n)
    starts = np.arange(0, n, size)
    padded = np.full(len(starts) * size, np.nan)
    padded[:n] = values
    table = padded.reshape(-1, size)
    lows = np.argmin(np.where(np.isnan(table), np.inf, table), axis=1) + starts
    highs = np.argmax(np.where(np.isnan(table), -np.inf, table), axis=1) + starts
    kept = np.unique(np.concatenate([lows, highs, np.flatnonzero(np.isnan(values))]))
    return kept[kept < n]
