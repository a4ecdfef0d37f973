"""Two recorders, two clocks: offset and drift between them, from a quantity that both have measured.

0. Both signals pass one zero-phase band-pass (a narrow Gaussian less a wide one): noise would bias the
   estimate, and sensors disagree about slow parts.
1. On one grid, the peak of their correlation gives a first offset.
2. Gauss-Newton on other(t) = gain * reference(t + offset + drift (t - t_mid)) + bias, with the weights of
   Huber (1964) against outliers, refines offset and drift together.
3. Standard errors come from the Jacobian, widened by the residuals' autocorrelation (an effective number
   of samples), since flight signals' errors are far from white.

What cannot be told apart: a delay inside one of the sensors looks like an offset of its clock. Attitudes
are better references than filtered velocities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.errors import DataError
from flysid.ingest.align.resample import RecordedSignal, period_ns, smooth
from flysid.stretch import FloatArray

IntArray = npt.NDArray[np.int64]

# standard deviation of the narrow Gaussian: the larger of the two
NARROW_PERIODS = 3.0
NARROW_S = 0.03
WIDE_S = 2.0  # and of the wide one


@dataclass(frozen=True)
class ClockFit:
    """reference time = other time + offset + drift * (other time - at).

    `offset_s`, `offset_std_s`: at time `at_ns` of the other clock, with its standard error.
    `drift_ppm`, `drift_std_ppm`: rate of the reference clock against the other one, minus 1.
    `at_ns`: middle of the common part, on the other clock.
    `correlation`: of the two signals once aligned; the sign tells whether they point the same way.
    `gain`: other signal = gain * reference signal.
    `samples`: number compared.
    """

    offset_s: float
    offset_std_s: float
    drift_ppm: float
    drift_std_ppm: float
    at_ns: int
    correlation: float
    gain: float
    samples: int

    def to_reference(self, t_ns: IntArray) -> IntArray:
        """(N,) times of the reference clock for (N,) times of the other one, ns."""
        elapsed = (t_ns - self.at_ns).astype(np.float64)
        shift = self.offset_s * 1e9 + 1e-6 * self.drift_ppm * elapsed
        return np.asarray(t_ns + np.round(shift).astype(np.int64))

    def __str__(self) -> str:
        return (
            f"offset {1e3 * self.offset_s:+.1f} ± {1e3 * self.offset_std_s:.1f} ms, "
            f"drift {self.drift_ppm:+.0f} ± {self.drift_std_ppm:.0f} ppm, correlation {self.correlation:.3f}"
        )


def fit_clock(
    reference: RecordedSignal,
    other: RecordedSignal,
    max_offset_s: float = 10.0,
    drift: bool = True,
    *,
    significant: float = 2.0,
) -> ClockFit:
    """Estimate offset and drift of `other`'s clock against `reference`'s.

    `reference`, `other`: one quantity, measured by both; units and sign may differ.
    `max_offset_s`: largest offset to look for.
    `drift`: False fixes the drift to zero; a drift below twice its standard error is taken as zero anyway.
    `significant`: standard deviations of a drift that counts.
    Raises DataError: the signals do not overlap, do not move, or correlate by less than 0.5.
    """
    if len(reference.x) < 20 or len(other.x) < 20:
        raise DataError("too few samples to align two clocks", hint="record longer")
    narrow = max(NARROW_S, NARROW_PERIODS * max(period_ns(reference.t_ns), period_ns(other.t_ns)) * 1e-9)
    reference = band_passed(reference, narrow)
    other = band_passed(other, narrow)
    start = _first_offset(reference, other, max_offset_s)
    usable = _inside(reference, other, start)
    if int(usable.sum()) < 20:
        raise DataError("the two recordings do not overlap", hint="check that both are of the same flight")
    t = other.t_ns[usable]
    y = other.x[usable]
    at_ns = int((t[0] + t[-1]) // 2)
    pair = _Pair(_Curve.of(reference, at_ns), np.asarray((t - at_ns) * 1e-9, dtype=np.float64), y)
    found = _refine(pair, start, drift, at_ns)
    if drift and abs(found.drift_ppm) < significant * found.drift_std_ppm:
        return _refine(pair, found.offset_s, False, at_ns)
    return found


def band_passed(series: RecordedSignal, narrow_s: float, wide_s: float = WIDE_S) -> RecordedSignal:
    """The series on an even grid of its own rate, less its slow and its fast parts, no phase added."""
    dt = period_ns(series.t_ns)
    grid = np.arange(0.0, float(series.t_ns[-1] - series.t_ns[0]), dt)
    x = np.interp(grid, (series.t_ns - series.t_ns[0]).astype(float), series.x)
    slow_removed = smooth(x, narrow_s * 1e9 / dt) - smooth(x, wide_s * 1e9 / dt)
    return RecordedSignal(series.t_ns[0] + np.round(grid).astype(np.int64), slow_removed)


@dataclass(frozen=True, eq=False)
class _Curve:
    """The reference signal as a function of seconds since `at`, with its slope."""

    t: FloatArray
    x: FloatArray
    slope: FloatArray

    @classmethod
    def of(cls, series: RecordedSignal, at_ns: int) -> _Curve:
        t = np.asarray((series.t_ns - at_ns) * 1e-9, dtype=np.float64)
        return cls(t, series.x, np.gradient(series.x, t))

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.interp(s, self.t, self.x), np.interp(s, self.t, self.slope)


@dataclass(frozen=True, eq=False)
class _Pair:
    """The reference as a curve, and the samples (N,) of the other signal at s seconds from the middle."""

    curve: _Curve
    s: FloatArray
    y: FloatArray


def _refine(pair: _Pair, start: float, drift: bool, at_ns: int, *, iterations: int = 12) -> ClockFit:
    """Gauss-Newton from a first offset."""
    theta = np.array([start, 0.0])
    for _ in range(iterations):
        theta, step = _gauss_newton(pair, theta, drift)
        if np.abs(step[0]) < 1e-7 and np.abs(step[1]) < 1e-9:
            break
    return _describe(pair, theta, drift, at_ns)


def _first_offset(
    reference: RecordedSignal, other: RecordedSignal, max_offset_s: float, *, least_correlation: float = 0.5
) -> float:
    """Offset, s, where the correlation of both signals, on a grid of the slower rate, is largest."""
    dt = max(period_ns(reference.t_ns), period_ns(other.t_ns)) * 1e-9
    zero = int(min(reference.t_ns[0], other.t_ns[0]))
    a, mask_a = _on_grid(reference, zero, dt)
    b, mask_b = _on_grid(other, zero, dt)
    reach = int(np.ceil(max_offset_s / dt))
    size = 1 << int(np.ceil(np.log2(len(a) + len(b) + reach)))
    product = _correlate(a, b, size)
    power = np.sqrt(np.maximum(_correlate(a * a, mask_b, size) * _correlate(mask_a, b * b, size), 1e-30))
    overlap = _correlate(mask_a, mask_b, size)
    lags = np.arange(-reach, reach + 1)
    enough = overlap[lags] > 0.3 * min(mask_a.sum(), mask_b.sum())
    score = np.where(enough, np.abs(product[lags]) / power[lags], 0.0)
    best = int(np.argmax(score))
    if score[best] < least_correlation:
        raise DataError(
            f"the two recordings do not match: correlation {score[best]:.2f} at best",
            hint="check that both are of the same flight and axis, or allow a larger offset",
        )
    return float(lags[best] * dt)


def _on_grid(series: RecordedSignal, zero: int, dt: float) -> tuple[FloatArray, FloatArray]:
    """Values without their mean on a grid from `zero`, and a mask of where the series is."""
    t = (series.t_ns - zero) * 1e-9
    grid = np.arange(0.0, t[-1] + dt, dt)
    mask = ((grid >= t[0]) & (grid <= t[-1])).astype(np.float64)
    return (np.interp(grid, t, series.x) - series.x.mean()) * mask, mask


def _correlate(a: FloatArray, b: FloatArray, size: int) -> FloatArray:
    """sum over n of a[n + lag] b[n], for lag 0, 1, ..., and negative lags at the end."""
    return np.asarray(np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size))


def _inside(reference: RecordedSignal, other: RecordedSignal, offset_s: float) -> npt.NDArray[np.bool_]:
    """Samples of `other` inside the reference; of long ones without the ends, which the filter bends."""
    span = min(reference.t_ns[-1] - reference.t_ns[0], other.t_ns[-1] - other.t_ns[0]) * 1e-9
    margin = round(1e9 * (WIDE_S if span > 10 * WIDE_S else 0.02 * span))
    t = other.t_ns + round(offset_s * 1e9)
    in_reference = (t >= reference.t_ns[0] + margin) & (t <= reference.t_ns[-1] - margin)
    own = (other.t_ns >= other.t_ns[0] + margin) & (other.t_ns <= other.t_ns[-1] - margin)
    return np.asarray(in_reference & own)


def _gauss_newton(pair: _Pair, theta: FloatArray, drift: bool) -> tuple[FloatArray, FloatArray]:
    """One weighted step for (offset, drift); gain and bias are solved along."""
    jacobian, residual, gain = _linearise(pair, theta, drift)
    weight = _huber(residual)
    solution, *_ = np.linalg.lstsq(jacobian * weight[:, None], residual * weight, rcond=None)
    step = np.zeros(2)
    step[: 2 if drift else 1] = solution[2 : 4 if drift else 3]
    limit = np.array([0.5, 1e-3])
    return theta + np.clip(step, -limit, limit), step if gain else np.zeros(2)


def _linearise(pair: _Pair, theta: FloatArray, drift: bool) -> tuple[FloatArray, FloatArray, float]:
    """Jacobian for (gain, bias, offset, drift), residual of the best gain and bias, and that gain."""
    s = pair.s
    y = pair.y
    value, slope = pair.curve.at(s + theta[0] + theta[1] * s)
    base = np.stack([value, np.ones_like(value)], axis=1)
    (gain, bias), *_ = np.linalg.lstsq(base, y, rcond=None)
    columns = [*base.T, gain * slope, *([gain * slope * s] if drift else [])]
    return np.stack(columns, axis=1), y - gain * value - bias, float(gain)


def _huber(residual: FloatArray, *, bend: float = 1.345) -> FloatArray:
    """(N,) square roots of Huber's weights; the scale is the median absolute residual.

    `bend`: standard deviations from which on a residual counts less.
    """
    scale = 1.4826 * float(np.median(np.abs(residual))) or 1.0
    ratio = np.abs(residual) / (bend * scale)
    return np.asarray(1.0 / np.sqrt(np.maximum(ratio, 1.0)))


def _describe(pair: _Pair, theta: FloatArray, drift: bool, at_ns: int) -> ClockFit:
    jacobian, residual, gain = _linearise(pair, theta, drift)
    weight = _huber(residual)
    effective = len(residual) / _correlation_time(residual * weight)
    variance = float(np.sum((weight * residual) ** 2)) / max(effective - jacobian.shape[1], 1.0)
    weighted = jacobian * weight[:, None]
    covariance = np.linalg.pinv(weighted.T @ weighted) * variance
    std = np.sqrt(np.diag(covariance))
    total = float(np.var(pair.y))
    share = 1.0 - float(np.var(residual)) / total if total > 0 else 0.0
    return ClockFit(
        offset_s=float(theta[0]),
        offset_std_s=float(std[2]),
        drift_ppm=float(theta[1] * 1e6),
        drift_std_ppm=float(std[3] * 1e6) if drift else 0.0,
        at_ns=at_ns,
        correlation=float(np.sign(gain) * np.sqrt(max(share, 0.0))),
        gain=gain,
        samples=len(pair.y),
    )


def _correlation_time(residual: FloatArray) -> float:
    """Samples per independent sample: 1 + 2 sum of the autocorrelation up to its first zero."""
    r = residual - residual.mean()
    size = 1 << int(np.ceil(np.log2(2 * len(r))))
    power = np.abs(np.fft.rfft(r, size)) ** 2
    auto = np.fft.irfft(power, size)[: len(r) // 2]
    if auto[0] <= 0:
        return 1.0
    auto = auto / auto[0]
    negative = np.flatnonzero(auto <= 0)
    stop = int(negative[0]) if len(negative) else len(auto)
    return max(1.0, 1.0 + 2.0 * float(auto[1:stop].sum()))
