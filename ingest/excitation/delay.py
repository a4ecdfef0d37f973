"""Dead time between input and output: cross-correlation, impulse response, and a search over `nk`.

A lag of the dynamics shifts the peak of the correlation too, so the peak alone overestimates the dead
time. The search fits a model for every dead time and takes the one that errs least:

- without feedback, second order by output error (Steiglitz and McBride 1965, iterated least squares on
  filtered data, then Gauss-Newton), whose free run the measurement noise does not bias;
- with feedback (the output leads the input: a pilot or a controller answers it), ARX of high order by one
  step prediction, since output error is biased there (Ljung 1999, System Identification, section 13.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset
from flysid.errors import DataError

FloatArray = npt.NDArray[np.float64]

ORDER = 2
ITERATIONS, REFINEMENTS = 6, 6  # of Steiglitz-McBride, then of Gauss-Newton
ARX_ORDERS = (20, 10)  # of past outputs and inputs
MAX_SAMPLES = 20_000  # of the longest segments; more does not sharpen an answer in whole samples
STEP_S = 0.5  # the sign is that of the step response so long after the dead time


@dataclass(frozen=True)
class Delay:
    """Dead time from an input to an output.

    Attributes
    ----------
    nk : samples until the output can answer: y[k] depends on u[k - nk] and earlier, so the dead time lies
        between nk - 1 and nk samples; 0 where the log shows an answer within the same sample.
    delay_s : dead time in seconds, between samples by interpolation of the error.
    low_s, high_s : dead times whose error is not significantly larger.
    sign : +1 where the output follows the input, -1 where it goes against it; 0 where a loop hides it: the
        model and the correlation at later times disagree.
    correlation, peak_s : largest absolute correlation, and the lag where it lies.
    feedback : the output leads the input; the dead time was then found by prediction error.
    """

    nk: int
    delay_s: float
    low_s: float
    high_s: float
    sign: int
    correlation: float
    peak_s: float
    feedback: bool


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
    last = max(2, round(max_delay_s / data.dt_s))
    pieces = _pieces(data, column, output, min_length=2 * (last + sum(ARX_ORDERS)))
    lag_s, r = cross_correlation(data, column, output, max(2 * max_delay_s, 1.0))
    at = int(np.argmax(np.abs(r)))
    feedback = bool(lag_s[at] < -0.5 * data.dt_s)
    fit = _predictor if feedback else _output_error
    fits = [fit(pieces, nk) for nk in range(last + 1)]
    errors = np.array([f.error for f in fits])
    best = int(np.argmin(errors))
    samples = sum(len(y) for _, y in pieces)
    slack = 8.0 / samples if feedback else 4.0 / np.sqrt(samples)
    close = np.flatnonzero(errors <= errors[best] * (1.0 + slack))
    sign = fits[best].sign(best + round(STEP_S / data.dt_s))
    if feedback and sign * _largest(r[len(r) // 2 :]) < 0:
        sign = 0
    return Delay(
        nk=best,
        delay_s=max(0.0, (best - 0.5 + _vertex(errors, best)) * data.dt_s),
        low_s=max(0.0, (int(close[0]) - 1) * data.dt_s),
        high_s=int(close[-1]) * data.dt_s,
        sign=sign,
        correlation=float(np.abs(r[at])),
        peak_s=float(lag_s[at]),
        feedback=feedback,
    )


def _largest(r: FloatArray) -> float:
    """The value of largest size."""
    return float(r[np.argmax(np.abs(r))])


def _pieces(data: Dataset, column: int, output: int, min_length: int) -> list[tuple[FloatArray, FloatArray]]:
    """Longest segments first, means removed, up to MAX_SAMPLES in all."""
    pieces: list[tuple[FloatArray, FloatArray]] = []
    total = 0
    for segment in sorted(data.segments, key=len, reverse=True):
        if len(segment) < min_length or (pieces and total + len(segment) > MAX_SAMPLES):
            break
        u, y = segment.u[:MAX_SAMPLES, column], segment.y[:MAX_SAMPLES, output]
        pieces.append((u - u.mean(), y - y.mean()))
        total += len(u)
    if not pieces:
        raise DataError(f"channel {data.name!r}: segments are too short to estimate a delay")
    if not any(u.any() for u, _ in pieces) or not any(y.any() for _, y in pieces):
        raise DataError(f"channel {data.name!r}: no delay without a moving input and output")
    return pieces


@dataclass(frozen=True, eq=False)
class _Fit:
    """A transfer function and the mean squared error it leaves."""

    error: float
    zeros: FloatArray
    poles: FloatArray

    def sign(self, steps: int) -> int:
        """Sign of the step response after `steps` samples."""
        from scipy.signal import lfilter

        response = lfilter(self.zeros, self.poles, np.ones(steps + 2))
        return -1 if response[-1] < 0 else 1


def _output_error(pieces: list[tuple[FloatArray, FloatArray]], nk: int) -> _Fit:
    """The best second-order model with this dead time, by its free run."""
    from scipy.signal import lfilter

    poles, best = np.array([1.0, *np.zeros(ORDER)]), _Fit(np.inf, np.zeros(nk + ORDER), np.ones(1 + ORDER))
    for _ in range(ITERATIONS):
        filtered = [(lfilter([1.0], poles, u), lfilter([1.0], poles, y)) for u, y in pieces]
        theta, _ = _least_squares(filtered, nk, (ORDER, ORDER))
        poles = _stable(np.concatenate([[1.0], theta[:ORDER]]))
        fit = _free_run(pieces, np.concatenate([np.zeros(nk), theta[ORDER:]]), poles)
        best = min(best, fit, key=lambda f: f.error)
    for _ in range(REFINEMENTS):
        step = _gauss_newton_step(pieces, best, nk)
        tried = [_moved(pieces, best, share * step, nk) for share in (1.0, 0.3)]
        better = min(tried, key=lambda f: f.error)
        if better.error > best.error * (1.0 - 1e-4):
            break
        best = better
    return best


def _free_run(pieces: list[tuple[FloatArray, FloatArray]], zeros: FloatArray, poles: FloatArray) -> _Fit:
    error = sum(float(np.sum((y - _simulate(zeros, poles, u, y)) ** 2)) for u, y in pieces)
    return _Fit(error / sum(len(y) for _, y in pieces), zeros, poles)


def _moved(pieces: list[tuple[FloatArray, FloatArray]], fit: _Fit, step: FloatArray, nk: int) -> _Fit:
    """The fit with its parameters (a1, a2, b1, b2) moved."""
    poles = _stable(np.concatenate([[1.0], fit.poles[1:] + step[:ORDER]]))
    return _free_run(pieces, np.concatenate([np.zeros(nk), fit.zeros[nk:] + step[ORDER:]]), poles)


def _gauss_newton_step(pieces: list[tuple[FloatArray, FloatArray]], fit: _Fit, nk: int) -> FloatArray:
    """(4,) change of (a1, a2, b1, b2) by the free run's own sensitivities: -y_hat/A and u/A, delayed."""
    from scipy.signal import lfilter

    gram, right = np.zeros((2 * ORDER, 2 * ORDER)), np.zeros(2 * ORDER)
    for u, y in pieces:
        model = _simulate(fit.zeros, fit.poles, u, y)
        by_pole, by_zero = lfilter([-1.0], fit.poles, model), lfilter([1.0], fit.poles, u)
        columns = [_late(by_pole, i + 1) for i in range(ORDER)] + [
            _late(by_zero, nk + i) for i in range(ORDER)
        ]
        jacobian = np.stack(columns, axis=1)
        gram += jacobian.T @ jacobian
        right += jacobian.T @ (y - model)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.asarray(np.linalg.lstsq(gram / np.outer(scale, scale), right / scale, rcond=1e-10)[0] / scale)


def _late(x: FloatArray, samples: int) -> FloatArray:
    """x delayed, zeros before it."""
    return np.concatenate([np.zeros(samples), x[: len(x) - samples]])


def _predictor(pieces: list[tuple[FloatArray, FloatArray]], nk: int) -> _Fit:
    """ARX of high order with this dead time, by its one-step error."""
    theta, error = _least_squares(pieces, nk, ARX_ORDERS)
    na = ARX_ORDERS[0]
    return _Fit(error, np.concatenate([np.zeros(nk), theta[na:]]), np.concatenate([[1.0], theta[:na]]))


def _least_squares(
    pieces: list[tuple[FloatArray, FloatArray]], nk: int, orders: tuple[int, int]
) -> tuple[FloatArray, float]:
    """ARX parameters (na + nb,) and their mean squared one-step error, columns scaled alike."""
    size = sum(orders)
    gram, right, squares, rows = np.zeros((size, size)), np.zeros(size), 0.0, 0
    for u, y in pieces:
        phi, target = _regressors(u, y, nk, orders)
        gram += phi.T @ phi
        right += phi.T @ target
        squares, rows = squares + float(target @ target), rows + len(target)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    theta = np.linalg.lstsq(gram / np.outer(scale, scale), right / scale, rcond=1e-12)[0] / scale
    return theta, max(0.0, squares - float(theta @ (2 * right - gram @ theta))) / max(rows, 1)


def _simulate(zeros: FloatArray, poles: FloatArray, u: FloatArray, y: FloatArray) -> FloatArray:
    """Free run from the best initial state and input offset: the model's own responses to them are fitted."""
    from scipy.signal import lfilter

    forced = lfilter(zeros, poles, u)
    impulse = np.zeros(len(u))
    impulse[0] = 1.0
    first = lfilter([1.0], poles, impulse)
    free = np.stack([first, _late(first, 1), np.cumsum(first)], axis=1)
    free = free / np.linalg.norm(free, axis=0)
    start = np.linalg.solve(free.T @ free + 1e-10 * np.eye(free.shape[1]), free.T @ (y - forced))
    return np.asarray(forced + free @ start)


def _regressors(
    u: FloatArray, y: FloatArray, nk: int, orders: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """(N, na + nb) of -y[k-1], ..., -y[k-na], u[k-nk], ..., u[k-nk-nb+1], and the (N,) outputs y[k]."""
    na, nb = orders
    first = max(na, nk + nb - 1)
    past_y = [-y[first - i : len(y) - i] for i in range(1, na + 1)]
    past_u = [u[first - nk - i : len(u) - nk - i] for i in range(nb)]
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
