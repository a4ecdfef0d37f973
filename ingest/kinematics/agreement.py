"""Two accounts of one motion: bias, scale, lag and lever arm between an instrument and what others imply.

An instrument's axes read y_i(t) = s_i (x_i(t - lag) + sum_j r_j z_ij(t - lag)) + b_i + noise, where x is what
the other instruments imply through rigid-body kinematics and z are the accelerations that one metre of lever
arm adds. All is fitted in the frequency domain, where a lag is a phase and noise of any colour a weight, by
maximum likelihood with noise on both sides: x is a derivative of something noisy, and plain least squares
would find every scale too small. The noise of `implied` must be given. The residual's own spectrum is a sum
of powers of frequency: a drift, white noise, and white noise of what was differentiated.

Sources: Klein and Morelli (2006), Aircraft System Identification, chapter 10; Jategaonkar (2015), Flight
Vehicle System Identification, chapter 10; noise on both sides: Pintelon and Schoukens (2012), System
Identification, section 8.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray

ComplexArray = npt.NDArray[np.complex128]
Number = TypeVar("Number", np.float64, np.complex128)

LONGEST_LAG_S = 0.5
NOISE_POWERS = (-2.0, 0.0, 2.0, 4.0)
"""Of frequency: drift, white noise, white noise of what was differentiated once, twice."""
NEIGHBOURS = 21
"""Lines over which a power is averaged."""
ROUNDS = 8


@dataclass(frozen=True, eq=False)
class MotionRecord:
    """One motion without a pause, at equal steps.

    `dt_s`: step.
    `measured`, `implied`: (N, n) what the instrument reads, and what the others say that it should.
    `arm`: (N, n, m) what one unit of each of m further parameters adds to `implied`; m may be 0.
    `noise`: (n,) spectral density of the white noise whose derivative is in `implied`, units^2 s^2 / Hz.
    `flat`: (n,) spectral density of the white noise that is in it as it is, units^2 / Hz.
    """

    dt_s: float
    measured: FloatArray
    implied: FloatArray
    arm: FloatArray
    noise: FloatArray
    flat: FloatArray


@dataclass(frozen=True, eq=False)
class Agreement:
    """What stands between an instrument and the others, with standard deviations.

    `scale`, `bias`: (n,) per axis, and `offset`: by how much the axis is off at its mean over the flight.
    `lag_s`: of the instrument behind the others.
    `arm`: (m,)
    `..._sd`: standard deviations of the same shapes.
    `mean`, `spread`: (n,) of what is implied, mean and standard deviation.
    `moved`: (n,) its standard deviation without noise, below the highest frequency.
    `lines`: (n,) how many frequencies carry motion that both show.
    """

    scale: FloatArray
    bias: FloatArray
    offset: FloatArray
    lag_s: float
    arm: FloatArray
    scale_sd: FloatArray
    bias_sd: FloatArray
    offset_sd: FloatArray
    lag_sd: float
    arm_sd: FloatArray
    mean: FloatArray
    spread: FloatArray
    moved: FloatArray
    lines: FloatArray


@dataclass(frozen=True, eq=False)
class _SpectralLines:
    """Spectra at (K,) frequencies of all records: y, x (K, n), z (K, n, m), of a constant (K,).

    `share` (K, n) is the motion's share of x's power, the weight with which noise on both sides costs least,
    times the coherence of x and y, as x may hold what is not told of. `half` (K,) is 1/2 at zero frequency,
    where a spectrum is real, else 1. `brought` (K, n) is the power of x's noise, `slowest` the record's
    lowest frequency.
    """

    omega: FloatArray
    y: ComplexArray
    x: ComplexArray
    z: ComplexArray
    one: ComplexArray
    share: FloatArray
    half: FloatArray
    slowest: FloatArray
    brought: FloatArray


def agreement(records: Sequence[MotionRecord], highest_hz: float, *, shifts: int = 3) -> Agreement:
    """Fit one instrument to what the others imply.

    `records`: all stretches of one flight, all with the same axes.
    `highest_hz`: what is faster is not looked at.
    """
    implied = np.concatenate([r.implied for r in records])
    mean = implied.mean(axis=0)
    records = [replace(r, implied=r.implied - mean) for r in records]  # a phase would turn the mean too
    axes = len(mean)
    lag_s = 0.0
    theta = np.empty(0)
    for _ in range(shifts):
        lines = _lines(records, highest_hz, lag_s)
        theta = _start(lines) if not len(theta) else theta
        taken = np.zeros(lines.y.shape)
        for _ in range(ROUNDS):
            step = _Normal.of(lines, theta, _noises(lines, theta, taken))
            theta = theta + np.linalg.pinv(step.matrix) @ step.score
            taken = step.taken
        # a phase delays the window too: what was found is shifted in time, and only the rest is a phase
        lag_s = float(np.clip(lag_s + theta[2 * axes], -LONGEST_LAG_S, LONGEST_LAG_S))
        theta[2 * axes] = 0.0
    lines = _lines(records, highest_hz, lag_s)
    covariance = _Normal.of(lines, theta, _noises(lines, theta, taken)).deviations
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = theta[:axes]
    reading = theta[axes : 2 * axes]  # where `implied` is at its mean
    to_bias = np.hstack([-np.diag(mean), np.eye(axes)])
    of_bias = to_bias @ covariance[: 2 * axes, : 2 * axes] @ to_bias.T
    return Agreement(
        scale=scale,
        bias=reading - scale * mean,
        offset=reading - mean,
        lag_s=lag_s,
        arm=theta[2 * axes + 1 :],
        scale_sd=sd[:axes],
        bias_sd=np.sqrt(np.maximum(np.diag(of_bias), 0.0)),
        offset_sd=sd[axes : 2 * axes],
        lag_sd=float(sd[2 * axes]),
        arm_sd=sd[2 * axes + 1 :],
        mean=mean,
        spread=implied.std(axis=0),
        moved=np.sqrt(2.0 * np.sum(lines.share * np.abs(lines.x) ** 2, axis=0) / len(implied)),
        lines=lines.share.sum(axis=0),
    )


def _lines(records: Sequence[MotionRecord], highest_hz: float, lag_s: float) -> _SpectralLines:
    parts = [_of_record(r, highest_hz, lag_s) for r in records]
    names = _SpectralLines.__annotations__
    return _SpectralLines(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})


def late(values: FloatArray, steps: float) -> FloatArray:
    """(N, ...) values as they were so many steps before, not a whole number: a line, and a Fourier series.

    Before the first and after the last value the line goes on.
    """
    count = len(values)
    at = np.arange(count).reshape(-1, *(1,) * (values.ndim - 1))
    slope = (values[-1] - values[0]) / (count - 1)
    spectrum = np.fft.rfft(values - values[0] - slope * at, 2 * count, axis=0)
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(2 * count) * steps).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(
        values[0] + slope * (at - steps) + np.fft.irfft(spectrum * turn, 2 * count, axis=0)[:count]
    )


def _of_record(
    record: MotionRecord, highest_hz: float, lag_s: float, *, tapered: float = 0.2
) -> _SpectralLines:
    """`tapered`: share of a record over which it fades in and out, or its ends leak over all frequencies."""
    from flysid.filters import tukey

    count = len(record.measured)
    taper = tukey(count, tapered)
    taper = taper / np.sqrt(np.sum(taper**2))
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(count, record.dt_s), dtype=np.float64)
    low = omega <= 2.0 * np.pi * highest_hz

    def spectrum(values: FloatArray) -> ComplexArray:
        faded = values * taper.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(np.fft.rfft(faded, axis=0)[low])

    measured = spectrum(record.measured)
    implied = spectrum(late(record.implied, lag_s / record.dt_s))
    brought = (omega[low, None] ** 2 * record.noise + record.flat) / record.dt_s
    power = _smooth(np.abs(implied) ** 2)
    motion = np.clip(1.0 - brought / np.maximum(power, 1e-300), 0.0, 1.0) * _coherence(measured, implied)
    return _SpectralLines(
        omega[low],
        measured,
        implied,
        spectrum(late(record.arm, lag_s / record.dt_s)),
        spectrum(np.ones(count)),
        motion,
        np.where(omega[low] > 0.0, 1.0, 0.5),
        np.full(int(low.sum()), omega[1]),
        brought,
    )


def _smooth(values: npt.NDArray[Number]) -> npt.NDArray[Number]:
    """(K, n) means over neighbouring frequencies."""
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(values, NEIGHBOURS, axis=0))


def _coherence(y: ComplexArray, x: ComplexArray) -> FloatArray:
    """(K, n) share of two spectra's power that is common to both, less what chance gives."""
    cross = _smooth(y * x.conj())
    powers = [_smooth(np.abs(s) ** 2) for s in (x, y)]
    seen = np.abs(cross) ** 2 / np.maximum(powers[0] * powers[1], 1e-300)
    return np.asarray(np.clip((NEIGHBOURS * seen - 1.0) / (NEIGHBOURS - 1.0), 0.0, 1.0))


def _start(lines: _SpectralLines) -> FloatArray:
    """Least squares at the best of many lags, lever arm at 0."""
    best = np.inf
    found = np.empty(0)
    for lag in np.linspace(-LONGEST_LAG_S, LONGEST_LAG_S, 101):
        shift = np.exp(-1j * lines.omega * lag)
        total = 0.0
        scales = []
        biases = []
        for y, x, weight in zip(lines.y.T, lines.x.T, lines.share.T, strict=True):
            columns = np.column_stack([shift * x, lines.one])
            weighted = columns.conj().T * weight
            solved = np.linalg.lstsq(np.real(weighted @ columns), np.real(weighted @ y), rcond=None)[0]
            power = float(np.sum(weight * np.abs(y) ** 2))
            total += float(np.sum(weight * np.abs(y - columns @ solved) ** 2)) / max(power, 1e-300)
            scales.append(solved[0])
            biases.append(solved[1])
        if total < best:
            best = total
            found = np.array([*scales, *biases, lag, *np.zeros(lines.z.shape[2])])
    return found


def _move(lines: _SpectralLines, theta: FloatArray) -> ComplexArray:
    """(K, n) what is implied, lever arm and lag included."""
    axes = lines.y.shape[1]
    turn = np.exp(-1j * lines.omega * theta[2 * axes])
    return np.asarray(turn[:, None] * (lines.x + lines.z @ theta[2 * axes + 1 :]))


def _residual(lines: _SpectralLines, theta: FloatArray, axis: int, moved: ComplexArray) -> ComplexArray:
    axes = lines.y.shape[1]
    return np.asarray(lines.y[:, axis] - theta[axis] * moved[:, axis] - theta[axes + axis] * lines.one)


def _noises(lines: _SpectralLines, theta: FloatArray, taken: FloatArray) -> list[FloatArray]:
    """Of every axis."""
    return [_noise(lines, theta, i, taken[:, i]) for i in range(taken.shape[1])]


def _noise(lines: _SpectralLines, theta: FloatArray, axis: int, taken: FloatArray) -> FloatArray:
    """(K,) power of an axis's noise: of its residual, and what the fit took of it.

    A sum of powers of frequency with weights that are not negative, by iterated least squares on the
    residual's periodogram, whose scatter is as large as itself.
    """
    from scipy.optimize import nnls

    seen = np.abs(_residual(lines, theta, axis, _move(lines, theta))) ** 2 + taken
    omega = np.maximum(lines.omega, 0.5 * lines.slowest)
    shapes = np.column_stack([(omega / omega.max()) ** power for power in NOISE_POWERS])
    fitted = np.full(len(seen), seen.mean() + 1e-300)
    weights = np.zeros(len(NOISE_POWERS))
    for _ in range(ROUNDS):
        weights, _ = nnls(shapes / fitted[:, None], seen / fitted)
        fitted = np.maximum(shapes @ weights, 1e-9 * seen.mean() + 1e-300)
    return np.asarray(fitted)


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations of one step, and the covariance of what they solve for.

    `taken` (K, n) is the power by which the fit makes residuals smaller than the noise: without it the slow
    lines, of which few tell a bias and its noise, give intervals that are too narrow by a tenth.
    """

    matrix: FloatArray
    score: FloatArray
    deviations: FloatArray
    taken: FloatArray

    @classmethod
    def of(
        cls,
        lines: _SpectralLines,
        theta: FloatArray,
        noise: Sequence[FloatArray],
        *,
        most_relief: float = 0.95,
    ) -> _Normal:
        """`most_relief`: of what is known of a parameter; where noise is more of `implied`, nothing is."""
        axes = lines.y.shape[1]
        moved = _move(lines, theta)
        turn = np.exp(-1j * lines.omega * theta[2 * axes])
        matrix = np.zeros((len(theta), len(theta)))
        expected = np.zeros_like(matrix)
        scores = np.zeros((len(lines.omega), len(theta)))
        every = []
        for i, power in enumerate(noise):
            slopes = np.zeros((len(lines.omega), len(theta)), dtype=np.complex128)
            slopes[:, i] = moved[:, i]
            slopes[:, axes + i] = lines.one
            slopes[:, 2 * axes] = -1j * lines.omega * theta[i] * moved[:, i]
            slopes[:, 2 * axes + 1 :] = theta[i] * turn[:, None] * lines.z[:, i]
            every.append(slopes)
            weighted = slopes.conj() * (lines.share[:, i] * lines.half / power)[:, None]
            weighted[:, axes + i] = lines.one.conj() * lines.half / power  # a constant has no noise
            scores += np.real(weighted * _residual(lines, theta, i, moved)[:, None])
            matrix += np.real(weighted.T @ slopes)
            expected += np.real(weighted.T @ (weighted.conj() * (0.5 * power / lines.half)[:, None]))
            # noise of `implied` is in its slope and in the residual: both are relieved of what they share
            shared = lines.brought[:, i] * lines.share[:, i] * lines.half / power
            scores[:, i] += theta[i] * shared
            matrix[i, i] -= min(float(np.sum(shared)), most_relief * matrix[i, i])
            late_shared = float(np.sum(lines.omega**2 * theta[i] ** 2 * shared))
            matrix[2 * axes, 2 * axes] -= min(late_shared, most_relief * matrix[2 * axes, 2 * axes])
        inverse = np.linalg.pinv(matrix)
        told = inverse @ expected @ inverse.T
        seen = inverse @ (scores.T @ scores) @ inverse.T
        larger = np.sqrt(np.maximum(np.diag(seen) / np.maximum(np.diag(told), 1e-300), 1.0))
        taken = np.column_stack(
            [np.real(np.sum((slopes @ told) * slopes.conj(), axis=1)) for slopes in every]
        )
        return cls(matrix, scores.sum(axis=0), told * np.outer(larger, larger), taken)
