"""The band in which a fleet's flights determine a frequency response: output and input are coherent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray, Segment
from flysid.errors import DataError
from flysid.model.frequency.response import GOOD_COHERENCE

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class Band:
    """Frequencies in rad/s, and the coherence at each of the spectra's frequencies.

    `low`, `high`: its ends.
    `omega`, `coherence`: (F,) of the spectra.
    """

    low: float
    high: float
    omega: FloatArray
    coherence: FloatArray

    @property
    def frequencies(self) -> FloatArray:
        """(3,) its ends and its middle, rad/s: gain, corner and lag show there; (1,) where it is a point."""
        if self.high < 1.5 * self.low:
            return np.array([np.sqrt(self.low * self.high)])
        return np.array([self.low, np.sqrt(self.low * self.high), self.high])


def coherence_of(spectra: ComplexArray, source: int, target: int) -> FloatArray:
    """(F,) ordinary coherence of two of the signals."""
    power = (spectra[:, source, source] * spectra[:, target, target]).real
    cross = np.abs(spectra[:, source, target]) ** 2
    return np.asarray(np.divide(cross, power, out=np.zeros_like(cross), where=power > 0.0))


def band_of(
    spectra: ComplexArray, omega: FloatArray, source: int, target: int, channel: str, *, least_cycles: int = 2
) -> Band:
    """The widest run of frequencies (in octaves) that are coherent.

    `least_cycles`: in a window: a lower frequency looks like a drift.

    Raises DataError: there is none.
    """
    coherence = coherence_of(spectra, source, target)
    good = coherence >= GOOD_COHERENCE
    good[:least_cycles] = False
    runs: list[tuple[float, float]] = []
    start: int | None = None
    for i, ok in enumerate([*good.tolist(), False]):
        if ok and start is None:
            start = i
        if not ok and start is not None:
            runs.append((float(omega[start]), float(omega[i - 1])))
            start = None
    if not runs:
        best = float(coherence[least_cycles:].max(initial=0.0))
        raise DataError(
            f"channel {channel!r}: the coherence of output and input reaches {GOOD_COHERENCE:g} nowhere; "
            f"{best:.2f} at best",
            hint="fly more manoeuvres on this axis, or choose another channel",
        )
    low, high = max(runs, key=lambda run: run[1] / run[0])
    return Band(low, high, omega, coherence)


def spectra_of(segments: Sequence[Segment], window: int) -> tuple[ComplexArray, int]:
    """((F, s, s) conj(X_i) X_j summed over Hann windows that overlap by half, each less its mean; how many).

    Of (inputs, outputs), at the frequencies of `np.fft.rfftfreq(window)`.
    """
    signals = segments[0].u.shape[1] + segments[0].y.shape[1] if segments else 0
    total = np.zeros((window // 2 + 1, signals, signals), dtype=np.complex128)
    count = 0
    hann = np.hanning(window + 1)[:-1, None]
    for segment in segments:
        x = np.column_stack([segment.u, segment.y])
        for start in range(0, len(x) - window + 1, window // 2):
            piece = x[start : start + window]
            f = np.fft.rfft(hann * (piece - piece.mean(axis=0)), axis=0)
            total += np.conj(f)[:, :, None] * f[:, None, :]
            count += 1
    return total, count


def frequencies_of(window: int, dt_s: float) -> FloatArray:
    """(F,) of the spectra, rad/s."""
    return np.asarray(2.0 * np.pi * np.fft.rfftfreq(window, dt_s), dtype=np.float64)
