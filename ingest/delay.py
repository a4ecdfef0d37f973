"""Dead time between input and output: cross-correlation, impulse response, and a search over `nk`.

A lag of the dynamics shifts the peak of the correlation too, so the peak alone overestimates the dead
time. The search fits a model of second order by output error for every dead time (Steiglitz and McBride
1965, iterated least squares on filtered data) and takes the one whose free run errs least; the same data
decide how sure that is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset
from flysid.errors import DataError

FloatArray = npt.NDArray[np.float64]

ORDER = 2
ITERATIONS = 6
MAX_SAMPLES = 60_000  # of the longest segments; more does not sharpen an answer in whole samples


@dataclass(frozen=True)
class Delay:
    """Dead time from an input to an output.

    Attributes
    ----------
    nk : samples until the output can answer: y[k] depends on u[k - nk] and earlier; at least 1 unless the
        log shows an answer within the same sample.
    delay_s : dead time in seconds, between samples by interpolation of the error.
    low_s, high_s : dead times whose error is not significantly larger.
    sign : +1 where the output follows the input, -1 where it goes against it.
    correlation, peak_s : largest absolute correlation, and the lag where it lies.
    """

    nk: int
    delay_s: float
    low_s: float
    high_s: float
    sign: int
    correlation: float
    peak_s: float


@dataclass(frozen=True, eq=False)
class ImpulseResponse:
    """(L,) lags, s; (L,) response of the output to a unit sample of the input; (L,) standard errors."""

    lag_s: FloatArray
    g: FloatArray
    std: FloatArray


def cross_correlation(
    data: Dataset, column: int = 0, output: int = 0, max_lag_s: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """(lags in s, correlation in [-1, 1]); positive lags: the output comes after the input."""
    lags = max(1, round(max_lag_s / data.dt_s))
    total, power_u, power_y = np.zeros(2 * lags + 1), 0.0, 0.0
    for segment in data.segments:
        u = segment.u[:, column] - segment.u[:, column].mean()
        y = segment.y[:, output] - segment.y[:, output].mean()
        size = 1 << int(np.ceil(np.log2(len(u) + lags + 1)))
        product = np.fft.irfft(np.conj(np.fft.rfft(u, size)) * np.fft.rfft(y, size), size)
        reach = min(lags, len(u) - 1)
        total[lags : lags + reach + 1] += product[: reach + 1]
        total[lags - reach : lags] += product[size - reach :]
        power_u, power_y = power_u + float(u @ u), power_y + float(y @ y)
    scale = np.sqrt(power_u * power_y)
    lag_s = np.asarray(np.arange(-lags, lags + 1) * data.dt_s, dtype=np.float64)
    return lag_s, np.asarray(total / scale if scale > 0 else total)


def impulse_response(
    data: Dataset, column: int = 0, output: int = 0, length_s: float = 1.0, before_s: float = 0.2
) -> ImpulseResponse:
    """Finite impulse response by regularised least squares over all segments.

    Taps at negative lags (`before_s`) are estimated too: where they differ from zero, the output acts on
    the input (feedback), or the clocks of the two are not the same.

    Raises
    ------
    DataError : the segments are too short.
    """
    before, after = round(before_s / data.dt_s), max(2, round(length_s / data.dt_s))
    taps = before + after + 1
    gram, right, squares, rows = np.zeros((taps, taps)), np.zeros(taps), 0.0, 0
    for segment in data.segments:
        if len(segment) <= 2 * taps:
            continue
        u = segment.u[:, column] - segment.u[:, column].mean()
        y = segment.y[after : len(segment) - before, output] - segment.y[:, output].mean()
        phi = np.lib.stride_tricks.sliding_window_view(u, taps)[:, ::-1]
        gram += phi.T @ phi
        right += phi.T @ y
        squares, rows = squares + float(y @ y), rows + len(y)
    if rows <= taps:
        raise DataError(
            f"channel {data.name!r}: segments are too short for an impulse response of {taps} samples",
            hint="a shorter response, or longer segments",
        )
    ridge = 1e-3 * np.trace(gram) / taps * np.eye(taps)
    inverse = np.linalg.inv(gram + ridge)
    g = inverse @ right
    variance = max(0.0, squares - float(g @ right)) / (rows - taps)
    return ImpulseResponse(
        lag_s=np.asarray(np.arange(-before, after + 1) * data.dt_s, dtype=np.float64),
        g=g,
        std=np.sqrt(variance * np.diag(inverse)),
    )


def estimate_delay(data: Dataset, column: int = 0, output: int = 0, max_delay_s: float = 0.5) -> Delay:
    """Dead time from input `column` to output `output`.

    Raises
    ------
    DataError : the segments are too short, or the input or output does not move.
    """
    pieces = _pieces(data, column, output)
    lag_s, r = cross_correlation(data, column, output, max(2 * max_delay_s, 1.0))
    at = int(np.argmax(np.abs(r)))
    candidates = range(max(2, round(max_delay_s / data.dt_s)) + 1)
    errors = np.array([_free_run_error(pieces, nk) for nk in candidates])
    best = int(np.argmin(errors))
    samples = sum(len(y) for _, y in pieces)
    close = np.flatnonzero(errors <= errors[best] * (1.0 + 4.0 / np.sqrt(samples)))
    offset = _vertex(errors, best)
    return Delay(
        nk=best,
        delay_s=max(0.0, (best - 1 + offset) * data.dt_s),
        low_s=max(0.0, (int(close[0]) - 1) * data.dt_s),
        high_s=int(close[-1]) * data.dt_s,
        sign=int(np.sign(r[at])) or 1,
        correlation=float(np.abs(r[at])),
        peak_s=float(lag_s[at]),
    )


def _pieces(data: Dataset, column: int, output: int) -> list[tuple[FloatArray, FloatArray]]:
    """Longest segments first, means removed, up to MAX_SAMPLES in all."""
    pieces: list[tuple[FloatArray, FloatArray]] = []
    total = 0
    for segment in sorted(data.segments, key=len, reverse=True):
        if len(segment) < 10 * ORDER or (pieces and total + len(segment) > MAX_SAMPLES):
            break
        u, y = segment.u[:MAX_SAMPLES, column], segment.y[:MAX_SAMPLES, output]
        pieces.append((u - u.mean(), y - y.mean()))
        total += len(u)
    if not pieces:
        raise DataError(f"channel {data.name!r}: segments are too short to estimate a delay")
    if not any(u.any() for u, _ in pieces) or not any(y.any() for _, y in pieces):
        raise DataError(f"channel {data.name!r}: no delay without a moving input and output")
    return pieces


def _free_run_error(pieces: list[tuple[FloatArray, FloatArray]], nk: int) -> float:
    """Mean squared free-run error of the best second-order model with this dead time."""
    from scipy.signal import lfilter

    poles = np.array([1.0, *np.zeros(ORDER)])
    best = np.inf
    for _ in range(ITERATIONS):
        gram, right = np.zeros((2 * ORDER, 2 * ORDER)), np.zeros(2 * ORDER)
        for u, y in pieces:
            u_f, y_f = lfilter([1.0], poles, u), lfilter([1.0], poles, y)
            phi, target = _regressors(u_f, y_f, nk)
            gram += phi.T @ phi
            right += phi.T @ target
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        theta = np.linalg.lstsq(gram / np.outer(scale, scale), right / scale, rcond=1e-12)[0] / scale
        poles = _stable(np.concatenate([[1.0], theta[:ORDER]]))
        zeros = np.concatenate([np.zeros(nk), theta[ORDER:]])
        error = sum(float(np.sum((y - _simulate(zeros, poles, u, y)) ** 2)) for u, y in pieces)
        best = min(best, error / sum(len(y) for _, y in pieces))
    return best


def _simulate(zeros: FloatArray, poles: FloatArray, u: FloatArray, y: FloatArray) -> FloatArray:
    """Free run from the best initial state: the model's own free responses are fitted to the error."""
    from scipy.signal import lfilter

    forced = lfilter(zeros, poles, u)
    impulse = np.zeros(len(u))
    impulse[0] = 1.0
    first = lfilter([1.0], poles, impulse)
    free = np.stack([first, np.concatenate([[0.0], first[:-1]])], axis=1)
    start, *_ = np.linalg.lstsq(free, y - forced, rcond=None)
    return np.asarray(forced + free @ start)


def _regressors(u: FloatArray, y: FloatArray, nk: int) -> tuple[FloatArray, FloatArray]:
    """(N, 4) of -y[k-1], -y[k-2], u[k-nk], u[k-nk-1], and the (N,) outputs y[k]."""
    first = max(ORDER, nk + ORDER - 1)
    past_y = [-y[first - i : len(y) - i] for i in range(1, ORDER + 1)]
    past_u = [u[first - nk - i : len(u) - nk - i] for i in range(ORDER)]
    return np.stack([*past_y, *past_u], axis=1), y[first:]


def _stable(poles: FloatArray) -> FloatArray:
    """A polynomial whose roots outside radius 0.9999 are mirrored or pulled inside."""
    roots = np.roots(poles)
    size = np.abs(roots)
    inside = np.where(size > 1.0, roots / np.maximum(size, 1e-12) ** 2, roots)
    inside = inside * np.minimum(1.0, 0.9999 / np.maximum(np.abs(inside), 1e-12))
    return np.asarray(np.real(np.poly(inside)))


def _vertex(errors: FloatArray, best: int) -> float:
    """Where between the neighbours of `best` a parabola through the errors has its minimum, in samples."""
    if best in (0, len(errors) - 1):
        return 0.0
    left, middle, right = errors[best - 1 : best + 2]
    bend = left - 2 * middle + right
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend > 0 else 0.0
