"""Dead time between input and output: cross-correlation, and a search over `nk`.

A lag of the dynamics shifts the peak of the correlation too, so the peak alone overestimates the dead
time. The search compares models with different dead times and takes the one that errs least (`delay_fits`):

- without feedback, second order by output error, whose free run the measurement noise does not bias;
- with feedback (the output leads the input: a pilot or a controller answers it), ARX of high order by one
  step prediction, since output error is biased there (Ljung 1999, System Identification, section 13.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.blas import one_thread
from flysid.dataset import Dataset
from flysid.errors import DataError
from flysid.ingest.excitation.delay_fits import ARX_ORDERS, Piece, predictors, searched_free_runs
from flysid.stretch import FloatArray


@dataclass(frozen=True)
class Delay:
    """Dead time from an input to an output.

    `nk`: samples until the output can answer: y[k] depends on u[k - nk] and earlier, so the dead time lies
        between nk - 1 and nk samples; 0 where the log shows an answer within the same sample.
    `delay_s`: dead time in seconds, between samples by interpolation of the error.
    `low_s`, `high_s`: dead times whose error is not significantly larger.
    `sign`: +1 where the output follows the input, -1 where it goes against it; 0 where a loop hides it: the
        model and the correlation at later times disagree.
    `correlation`, `peak_s`: largest absolute correlation, and the lag where it lies.
    `feedback`: the output leads the input; the dead time was then found by prediction error.
    """

    nk: int
    delay_s: float
    low_s: float
    high_s: float
    sign: int
    correlation: float
    peak_s: float
    feedback: bool


def cross_correlation(
    data: Dataset, column: int = 0, output: int = 0, max_lag_s: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """(lags in s, correlation in [-1, 1]); positive lags: the output comes after the input."""
    lags = max(1, round(max_lag_s / data.dt_s))
    total = np.zeros(2 * lags + 1)
    power_u = 0.0
    power_y = 0.0
    for segment in data.segments:
        u = segment.u[:, column] - segment.u[:, column].mean()
        y = segment.y[:, output] - segment.y[:, output].mean()
        size = 1 << int(np.ceil(np.log2(len(u) + lags + 1)))
        product = np.fft.irfft(np.conj(np.fft.rfft(u, size)) * np.fft.rfft(y, size), size)
        reach = min(lags, len(u) - 1)
        total[lags : lags + reach + 1] += product[: reach + 1]
        total[lags - reach : lags] += product[size - reach :]
        power_u = power_u + float(u @ u)
        power_y = power_y + float(y @ y)
    scale = np.sqrt(power_u * power_y)
    lag_s = np.asarray(np.arange(-lags, lags + 1) * data.dt_s, dtype=np.float64)
    return lag_s, np.asarray(total / scale if scale > 0 else total)


def estimate_delay(
    data: Dataset, column: int = 0, output: int = 0, max_delay_s: float = 0.5, *, step_s: float = 0.5
) -> Delay:
    """Dead time from input `column` to output `output`.

    `step_s`: the sign is that of the step response so long after the dead time.

    Raises DataError: the segments are too short, or the input or output does not move.
    """
    last = max(2, round(max_delay_s / data.dt_s))
    pieces = _pieces(data, column, output, min_length=2 * (last + sum(ARX_ORDERS)))
    lag_s, r = cross_correlation(data, column, output, max(2 * max_delay_s, 1.0))
    at = int(np.argmax(np.abs(r)))
    feedback = bool(lag_s[at] < -0.5 * data.dt_s)
    samples = sum(len(y) for _, y in pieces)
    slack = 8.0 / samples if feedback else 4.0 / np.sqrt(samples)
    with one_thread():
        fits = predictors(pieces, last) if feedback else searched_free_runs(pieces, last, slack)
    best = min(fits, key=lambda nk: fits[nk].error)
    close = [nk for nk, fit in fits.items() if fit.error <= fits[best].error * (1.0 + slack)]
    sign = fits[best].sign(best + round(step_s / data.dt_s))
    if feedback and sign * _largest(r[len(r) // 2 :]) < 0:
        sign = 0
    return Delay(
        nk=best,
        delay_s=max(0.0, (best - 0.5 + _vertex([fits[nk].error for nk in _around(best, last)])) * data.dt_s),
        low_s=max(0.0, (min(close) - 1) * data.dt_s),
        high_s=max(close) * data.dt_s,
        sign=sign,
        correlation=float(np.abs(r[at])),
        peak_s=float(lag_s[at]),
        feedback=feedback,
    )


def _largest(r: FloatArray) -> float:
    """The value of largest size."""
    return float(r[np.argmax(np.abs(r))])


def _pieces(
    data: Dataset, column: int, output: int, min_length: int, *, most_samples: int = 20_000
) -> list[Piece]:
    """Longest segments first, means removed, up to most_samples in all.

    `most_samples`: of the longest segments; more does not sharpen an answer in whole samples.
    """
    pieces: list[Piece] = []
    total = 0
    for segment in sorted(data.segments, key=len, reverse=True):
        if len(segment) < min_length or (pieces and total + len(segment) > most_samples):
            break
        u = segment.u[:most_samples, column]
        y = segment.y[:most_samples, output]
        pieces.append((u - u.mean(), y - y.mean()))
        total += len(u)
    if not pieces:
        raise DataError(f"channel {data.name!r}: segments are too short to estimate a delay")
    if not any(u.any() for u, _ in pieces) or not any(y.any() for _, y in pieces):
        raise DataError(f"channel {data.name!r}: no delay without a moving input and output")
    return pieces


def _around(best: int, last: int) -> range:
    """The dead time and its neighbours; () at either end of the search."""
    return range(best - 1, best + 2) if 0 < best < last else range(0)


def _vertex(errors: Sequence[float]) -> float:
    """Where a parabola through three neighbours' errors has its minimum, in samples; 0 without them."""
    if not errors:
        return 0.0
    left, middle, right = errors
    bend = left - 2 * middle + right
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend > 0 else 0.0
