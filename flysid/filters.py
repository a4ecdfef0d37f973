"""What is taken of `scipy.signal`, whose import costs every command a second: filters, a density, a taper.

Polynomials stand in rising powers of q⁻¹; the denominator is monic.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray

NOTHING = np.zeros(0)
ONE = np.ones(1)
"""The polynomial that changes nothing."""


def apply_filter(b: FloatArray, a: FloatArray, x: FloatArray, state: FloatArray = NOTHING) -> FloatArray:
    """(N,) x, or each of (N, columns), through B / A.

    `state`: (L,) of the transposed direct form before the first sample, as `lfilter` takes it, the same for
        every column; zero when empty.
    """
    if x.ndim > 1:
        return np.stack([apply_filter(b, a, column, state) for column in x.T], axis=1) if x.shape[1] else x
    y: FloatArray = _run_filter(own(b), own(a), own(x), own(state))
    return y


def own(x: FloatArray) -> FloatArray:
    """One row that may be written to, as nearly all are: compiled code is made for one kind of array only."""
    return x if x.flags.c_contiguous and x.flags.writeable else x.copy()


@njit(cache=True, error_model="numpy")
def _run_filter(b: FloatArray, a: FloatArray, x: FloatArray, start: FloatArray) -> FloatArray:
    order = max(a.size, b.size) - 1
    state = np.zeros(order + 1)
    for i in range(min(order, start.size)):
        state[i] = start[i]
    y = np.empty(x.size)
    for k in range(x.size):
        value = b[0] * x[k] + state[0]
        for i in range(order):
            kept = state[i + 1]
            if i + 1 < b.size:
                kept += b[i + 1] * x[k]
            if i + 1 < a.size:
                kept -= a[i + 1] * value
            state[i] = kept
        y[k] = value
    return y


def decimate(x: FloatArray, factor: int, *, half_width: int = 10) -> FloatArray:
    """Every `factor`-th row of x, (N,) or (N, columns), behind a low-pass without phase.

    As `scipy.signal.decimate` with an FIR filter has it: a sinc under a Hamming window, zero beyond the ends.

    `half_width`: of the filter, in rows that are kept.

    >>> x = np.sin(0.01 * np.arange(4000.0))
    >>> bool(np.abs(decimate(x, 5) - x[::5])[20:-20].max() < 2e-3)
    True
    """
    if x.ndim > 1:
        return np.stack([decimate(column, factor, half_width=half_width) for column in x.T], axis=1)
    reach = half_width * factor
    taps = np.sinc(np.arange(-reach, reach + 1) / factor) * np.hamming(2 * reach + 1)
    slow: FloatArray = np.convolve(x, taps / taps.sum())[reach : reach + len(x) : factor]
    return slow


def power_density(pieces: Sequence[FloatArray], dt_s: float) -> tuple[FloatArray, FloatArray]:
    """(F,) frequencies above zero and Welch's estimate of the pieces together, weighted by their length.

    Half-overlapping Hann windows without their means, as `scipy.signal.welch` has them. One-sided.
    """
    width = int(min(256, max(len(p) for p in pieces)))
    inner = slice(1, (width + 1) // 2)  # the mean and half the sample rate have windows of their own
    hz = np.asarray(np.fft.rfftfreq(width, dt_s), dtype=np.float64)[inner]
    hann = np.hanning(width + 1)[:-1]
    total = np.zeros(len(hz))
    weight = 0
    for piece in pieces:
        if len(piece) < width:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(np.nan_to_num(piece), width)[:: width - width // 2]
        power = np.abs(np.fft.rfft((windows - windows.mean(axis=1, keepdims=True)) * hann)) ** 2
        total += len(piece) * 2.0 * dt_s / np.sum(hann**2) * power.mean(axis=0)[inner]
        weight += len(piece)
    return hz, total / max(1, weight)


def tukey(count: int, share: float) -> FloatArray:
    """(count,) ones that fade in and out as a cosine, over this share of all together."""
    distance = np.minimum(np.arange(count), np.arange(count)[::-1]) / (count - 1)
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * np.minimum(distance / share, 0.5)))
