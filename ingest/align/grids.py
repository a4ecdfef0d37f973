"""Pauses and grids of a channel: which pauses end a segment, and how fast the grid below the grid is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flysid.ingest.align import resample
from flysid.ingest.align.recipe import Recipe, SignalSpec
from flysid.ingest.align.resample import RecordedSignal
from flysid.stretch import FloatArray


def pauses(spec: SignalSpec, period_ns: float, dt_ns: int) -> tuple[float, float]:
    """The longest pause in a signal's source that is bridged, and for how long its last sample counts; ns."""
    if spec.max_gap_s is not None:
        gap = min(spec.max_gap_s * 1e9, float(resample.FOREVER))
    else:
        gap = max(resample.GAP_PERIODS * period_ns, 1.5 * dt_ns)
    if spec.max_gap_s == float("inf"):
        return gap, gap
    return gap, 1.0 if spec.hold == "linear" else min(period_ns, gap)


def ratio_of(recipe: Recipe, series: Mapping[str, RecordedSignal], dt_ns: int, *, most: int = 64) -> int:
    """How many times faster than the grid the fastest state is sampled; 1: no filter is needed.

    `most`: of the fastest source's rate to the grid's.
    """
    if not recipe.antialias:
        return 1
    states = [s for name, s in series.items() if recipe.signals[name].hold == "linear"]
    fastest = min((s.period_ns for s in states), default=float(dt_ns))
    return int(np.clip(dt_ns / fastest + 0.2, 1, most))


def command_on_grid(
    series: RecordedSignal, grid: resample.IntArray, dt_ns: int, ratio: int, tolerance_ns: int
) -> FloatArray:
    """A command on every `ratio`-th point of a `fine_grid`: see `resample.on_grid`."""
    last = grid[-1] + np.round(np.arange(1, ratio) * (dt_ns / ratio)).astype(np.int64)
    return resample.on_grid(series, np.append(grid, last), dt_ns / ratio, tolerance_ns, ratio)


def fine_grid(begin_ns: int, first: int, stop: int, dt_ns: int, ratio: int) -> resample.IntArray:
    """Times from point `first` of a grid that begins at `begin_ns` to the last before `stop`, and between."""
    steps = np.arange(first * ratio, (stop - 1) * ratio + 1)
    return np.asarray(begin_ns + np.round(steps * (dt_ns / ratio)).astype(np.int64))
