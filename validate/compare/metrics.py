"""Measures of error, in the unit of the output, pooled over segments.

fit % is MATLAB's `compare` (Ljung, System Identification Toolbox): 100 (1 - ||y - yh|| / ||y - mean y||),
with the mean of the scored test samples. VAF % is 100 (1 - var(y - yh) / var y) (Babuska 1998; the gamma of
the AR.Drone paper): it does not see a constant bias, so it never stands alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray


@dataclass(frozen=True)
class Scores:
    """Errors of one model on one output.

    Attributes
    ----------
    n : samples scored.
    rmse, mae, worst : root mean square, mean absolute and largest absolute error, in the output's unit.
    fit_pct, vaf_pct : percent; None where the measured output is constant (beside the error).
    r2 : coefficient of determination; None where the measured output is constant.
    bias : mean of measured minus modelled, in the output's unit.
    """

    n: int
    rmse: float
    mae: float
    worst: float
    bias: float
    fit_pct: float | None
    vaf_pct: float | None
    r2: float | None


def scores(y: FloatArray, yh: FloatArray) -> Scores:
    """Errors of yh (N,) against the measured y (N,), N >= 1.

    Squares are taken of values divided by the largest one, so outputs of 1e200 or 1e-200 do no harm.
    """
    e = y - yh
    worst = float(np.max(np.abs(e)))
    rms = root_mean_square(e)
    spread = root_mean_square(y - np.mean(y))
    fit = vaf = r2 = None
    if spread > max(1e-14 * float(np.max(np.abs(y))), 1e-100 * worst):
        ratio = rms / spread
        fit = 100.0 * (1.0 - ratio)
        r2 = 1.0 - ratio**2
        vaf = 100.0 * (1.0 - (root_mean_square(e - np.mean(e)) / spread) ** 2)
    return Scores(
        n=len(e),
        rmse=rms,
        mae=float(np.mean(np.abs(e))),
        worst=worst,
        bias=float(np.mean(e)),
        fit_pct=fit,
        vaf_pct=vaf,
        r2=r2,
    )


def root_mean_square(e: FloatArray) -> float:
    """sqrt(mean(e^2)) without overflow or underflow."""
    largest = float(np.max(np.abs(e)))
    if largest == 0.0:
        return 0.0
    return largest * float(np.sqrt(np.mean((e / largest) ** 2)))


def pool(ys: Sequence[FloatArray], yhs: Sequence[FloatArray]) -> Scores:
    """`scores` over the samples of all segments together."""
    return scores(np.concatenate(list(ys)), np.concatenate(list(yhs)))


def resolution_of(ys: Sequence[FloatArray], declared: float = 0.0) -> float:
    """The smallest difference in RMSE that the data can show, in the output's unit.

    The largest of: the root mean square of rounding to the signal's step q, q / sqrt(12) (Widrow 1956), with
    q `declared` by the source or seen as the smallest step between distinct values; and 1e-4 of the range.
    """
    y = np.concatenate(list(ys))
    span = float(np.max(y) - np.min(y))
    step = declared if declared > 0 else _smallest_step(y, span)
    return max(step / math.sqrt(12.0), 1e-4 * span)


def _smallest_step(y: FloatArray, span: float) -> float:
    """Step of a quantised signal; 0 where values are continuous (nearly every sample is distinct)."""
    distinct = np.unique(y)
    if len(distinct) < 3 or len(distinct) > 0.5 * len(y):
        return 0.0
    steps = np.diff(distinct)
    steps = steps[steps > 1e-9 * span]  # rounding of the conversion to the unit
    return float(steps.min()) if len(steps) else 0.0
