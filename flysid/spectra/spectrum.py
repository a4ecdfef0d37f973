"""Spectra of a logged signal: from whole stretches, at the rate that its stamps have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import DataError

ENOUGH_WINDOWS = 8
"""Of which the mean is a spectrum; windows are made shorter until there are as many."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Half-overlapping windows of a signal, each with its own spectrum.

    `hz`: (F,) frequencies, from one step above zero to just below half the rate.
    `density`: (W, F) one-sided, in the signal's unit squared per Hz.
    `at_s`: (W,) the middle of each window on the log's clock.
    `rate_hz`: samples a second, by the stamps.
    """

    hz: FloatArray
    density: FloatArray
    at_s: FloatArray
    rate_hz: float

    @property
    def nyquist_hz(self) -> float:
        """Half the rate: what is faster shows below it, at a wrong frequency."""
        return self.rate_hz / 2.0

    @property
    def step_hz(self) -> float:
        """From frequency to frequency."""
        return float(self.hz[0])

    @cached_property
    def mean(self) -> FloatArray:
        """(F,) Welch's estimate: the mean over all windows."""
        return np.asarray(self.density.mean(axis=0))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the mean: two a window, less by their overlap (Welch 1967, Hann)."""
        count = len(self.density)
        return 2.0 if count == 1 else 36.0 * count * count / (19.0 * count - 1.0)

    def rms(self, low_hz: float = 0.0, high_hz: float = np.inf) -> float:
        """RMS of the signal between two frequencies."""
        inside = (self.hz >= low_hz) & (self.hz < high_hz)
        return float(np.sqrt(self.mean[inside].sum() * self.step_hz))

    def where(self, kept: npt.NDArray[np.bool_]) -> Windows:
        """Some of the windows."""
        return Windows(self.hz, self.density[kept], self.at_s[kept], self.rate_hz)


def whole_stretches(time_s: FloatArray, *, longest_gap: float = 4.0, fewest: int = 16) -> list[slice]:
    """Stretches of a signal without a lost sample.

    `time_s`: (N,) rising.
    `longest_gap`: periods from sample to sample beyond which one is lost; a stretch ends there.
    `fewest`: samples of a stretch that is kept.
    """
    if len(time_s) < 2:
        return []
    period = float(np.median(np.diff(time_s)))
    cuts = np.flatnonzero(np.diff(time_s) > longest_gap * period) + 1
    parts = [slice(a, b) for a, b in pairwise([0, *cuts.tolist(), len(time_s)])]
    return [part for part in parts if part.stop - part.start >= fewest]


def windows_of(
    time_s: FloatArray,
    values: FloatArray,
    *,
    window_s: float = 1.0,
    fewest: int = 128,
    longest_gap: float = 4.0,
    uneven: float = 0.1,
) -> Windows:
    """The spectra of all windows of a signal.

    A window lies within a stretch without losses. Its frequencies are those of its own stamps. Where its
    stamps are not even, the values are taken at even times between them.

    `time_s`, `values`: (N,) s on the log's clock, and any unit.
    `window_s`, `fewest`: length of a window, and samples of it at least; less where the signal is short.
    `longest_gap`: see `whole_stretches`.
    `uneven`: share of a period by which stamps may differ from even ones.
    Raises DataError: no stretch is long enough.

    >>> t = np.arange(0.0, 10.0, 0.01)
    >>> found = windows_of(t, np.sin(2.0 * np.pi * 20.0 * t))
    >>> float(found.hz[found.mean.argmax()]), round(found.rms(15.0, 25.0), 2)
    (20.0, 0.71)
    """
    parts = whole_stretches(time_s, longest_gap=longest_gap)
    if not parts:
        raise DataError(
            "no stretch without losses is long enough for a spectrum",
            hint="log faster, or to a card that keeps up",
        )
    count = sum(part.stop - part.start - 1 for part in parts)
    rate = count / sum(float(time_s[part.stop - 1] - time_s[part.start]) for part in parts)
    width = _width(parts, max(fewest, round(window_s * rate)))
    taken, at = _taken(parts, width, time_s, values, uneven)
    middle = np.array([stamps[width // 2] for stamps in at])
    rates = np.array([(width - 1) / (stamps[-1] - stamps[0]) for stamps in at])
    hann = np.hanning(width + 1)[:-1]
    power = np.abs(np.fft.rfft((taken - taken.mean(axis=1, keepdims=True)) * hann)) ** 2
    inner = slice(1, (width + 1) // 2)
    density = 2.0 * power[:, inner] / (rates[:, None] * np.sum(hann**2))
    hz = np.arange(inner.start, inner.stop) * rate / width
    return Windows(hz, _on_one_axis(density, rates / rate), middle, rate)


def _width(parts: Sequence[slice], wanted: int) -> int:
    """Samples of a window: an even number, so that there are enough windows."""
    lengths = sorted((part.stop - part.start for part in parts), reverse=True)
    wanted = min(wanted, lengths[0])
    while wanted > 32 and sum(max(0, 2 * n // wanted - 1) for n in lengths) < ENOUGH_WINDOWS:
        wanted = wanted * 3 // 4
    return max(2, wanted - wanted % 2)


def _taken(
    parts: Sequence[slice], width: int, time_s: FloatArray, values: FloatArray, uneven: float
) -> tuple[FloatArray, FloatArray]:
    """(W, width) values at even times, and the stamps."""
    view = np.lib.stride_tricks.sliding_window_view
    half = width // 2
    fit = [part for part in parts if part.stop - part.start >= width]
    at = np.concatenate([view(time_s[part], width)[::half] for part in fit])
    taken = np.concatenate([view(values[part], width)[::half] for part in fit])
    even = at[:, :1] + (at[:, -1:] - at[:, :1]) * np.linspace(0.0, 1.0, width)
    off = np.abs(at - even).max(axis=1) > uneven * (at[:, -1] - at[:, 0]) / (width - 1)
    for row in np.flatnonzero(off):
        taken[row] = np.interp(even[row], at[row], taken[row])
    return taken, at


def _on_one_axis(density: FloatArray, faster: FloatArray) -> FloatArray:
    """Densities by the frequencies of the whole signal; those of windows that ran faster lie elsewhere."""
    count = density.shape[1]
    steps = np.arange(1, count + 1, dtype=np.float64)
    for row in np.flatnonzero(np.abs(faster - 1.0) * count > 0.5):
        density[row] = np.interp(steps, steps * faster[row], density[row])
    return density


@dataclass(frozen=True, eq=False)
class Spread:
    """A spectrum by another quantity, such as throttle or RPM.

    `hz`: (F,)
    `edges`: (B + 1,) of the quantity's bins.
    `density`: (B, F), NaN where no window is of a bin.
    `counts`: (B,) windows of each bin.
    """

    hz: FloatArray
    edges: FloatArray
    density: FloatArray
    counts: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def middles(self) -> FloatArray:
        """(B,) of the bins."""
        return np.asarray((self.edges[1:] + self.edges[:-1]) / 2.0)


def spread_over(windows: Windows, quantity: FloatArray, bins: int = 20) -> Spread:
    """The spectrum in bins of a quantity.

    `quantity`: (W,) during each window; a window where it is NaN counts nowhere.
    `bins`: between its least and its largest value.
    """
    known = np.isfinite(quantity)
    low, high = (float(quantity[known].min()), float(quantity[known].max())) if known.any() else (0.0, 1.0)
    edges = np.linspace(low, high if high > low else low + 1.0, bins + 1)
    place = np.clip(np.searchsorted(edges, quantity, side="right") - 1, 0, bins - 1)
    density = np.full((bins, len(windows.hz)), np.nan)
    counts = np.zeros(bins)
    for k in range(bins):
        rows = known & (place == k)
        counts[k] = rows.sum()
        if rows.any():
            density[k] = windows.density[rows].mean(axis=0)
    return Spread(windows.hz, edges, density, counts)
