"""How well the input moves, and in which band the output follows it: excitation and coherence.

Spectra are averaged over all segments (Welch 1967: Hann windows, half overlap). The coherence tells, per
frequency, which share of the output's power a linear model of the input can explain at best (Bendat and
Piersol 2010, Random Data, section 6.1.1); where it is low, no model fitted to these data can be trusted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset
from flysid.stretch import FloatArray

GOOD_COHERENCE = 0.6
QUIET = {
    "deg": 0.05,
    "rad": 1e-3,
    "m/s": 0.01,
    "deg/s": 0.2,
    "rad/s": 4e-3,
    "m": 0.01,
}  # RMS; below: sensor noise


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Pooled spectra of one input and one output.

    `frequency_hz`: (F,) without 0.
    `coherence`: (F,) in [0, 1]; biased upwards by about 1 / averages.
    `gain`: (F,) magnitude of the frequency response S_uy / S_uu.
    `phase_rad`: (F,) its phase.
    `output_power`: (F,) S_yy, in no particular scale.
    `averages`: number of windows, overlapping ones counted as independent ones are: 0.6 of them.
    """

    frequency_hz: FloatArray
    coherence: FloatArray
    gain: FloatArray
    phase_rad: FloatArray
    output_power: FloatArray
    averages: float

    @property
    def threshold(self) -> float:
        """The coherence that counts: worth a model, and above chance at 5 % over all frequencies."""
        level = 0.05 / max(len(self.coherence), 1)
        chance = float(1.0 - level ** (1.0 / max(self.averages - 1.0, 0.1)))
        return max(GOOD_COHERENCE, chance)

    def band_hz(self) -> tuple[float, float] | None:
        """The run of frequencies whose coherence counts that explains most output power, None without one."""
        good = self.coherence > self.threshold
        edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]])))
        runs = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        if not runs:
            return None
        explained = self.coherence * self.output_power
        start, stop = max(runs, key=lambda run: float(explained[run[0] : run[1]].sum()))
        return float(self.frequency_hz[start]), float(self.frequency_hz[stop - 1])


@dataclass(frozen=True)
class Excitation:
    """How an input moves, in its unit.

    `rms`: about the mean of each segment.
    `span`: largest minus smallest value.
    `band_hz`: the frequency below which 95 % of its power lies.
    `quiet`: it moves less than sensors of its unit are noisy, or less than its own resolution.
    """

    rms: float
    span: float
    band_hz: float
    quiet: bool


def excitation(data: Dataset, column: int = 0) -> Excitation:
    """How input `column` of a dataset moves."""
    parts = [s.u[:, column] - s.u[:, column].mean() for s in data.segments]
    joined = np.concatenate(parts)
    rms = float(np.sqrt(np.mean(joined**2)))
    low = min(float(s.u[:, column].min()) for s in data.segments)
    high = max(float(s.u[:, column].max()) for s in data.segments)
    signal = data.inputs[column]
    return Excitation(
        rms=rms,
        span=high - low,
        band_hz=_power_band(parts, data.dt_s),
        quiet=rms < max(QUIET.get(signal.unit, 0.0), 0.5 * signal.resolution) or rms == 0.0,
    )


def spectrum(data: Dataset, column: int = 0, output: int = 0, window_s: float | None = None) -> Spectrum:
    """Coherence and frequency response from input `column` to output `output`.

    Parameters
    ----------
    window_s : length of a window; default: such that about sixteen fit, between 1 and 20 s.
    """
    length = _window_length(data, window_s)
    taper = np.hanning(length + 2)[1:-1]
    bins = length // 2 + 1
    s_uu = np.zeros(bins)
    s_yy = np.zeros(bins)
    s_uy = np.zeros(bins, dtype=complex)
    count = 0
    for segment in data.segments:
        for start in range(0, len(segment) - length + 1, max(1, length // 2)):
            u = _transform(segment.u[start : start + length, column], taper)
            y = _transform(segment.y[start : start + length, output], taper)
            s_uu += np.abs(u) ** 2
            s_yy += np.abs(y) ** 2
            s_uy += np.conj(u) * y
            count += 1
    with np.errstate(invalid="ignore", divide="ignore"):
        coherence = np.where(s_uu * s_yy > 0, np.abs(s_uy) ** 2 / (s_uu * s_yy), 0.0)
        response = np.where(s_uu > 0, s_uy / s_uu, 0.0)
    frequency = np.asarray(np.fft.rfftfreq(length, data.dt_s), dtype=np.float64)
    return Spectrum(
        frequency_hz=frequency[1:],
        coherence=np.clip(coherence[1:], 0.0, 1.0) if count > 1 else np.zeros(bins - 1),
        gain=np.abs(response[1:]),
        phase_rad=np.unwrap(np.angle(response[1:])),
        output_power=s_yy[1:],
        averages=max(1.0, 0.6 * count),
    )


def is_narrow(band_hz: tuple[float, float]) -> bool:
    """Less than an octave: a single oscillation, not a response."""
    return band_hz[1] < 2.0 * band_hz[0]


def _window_length(data: Dataset, window_s: float | None) -> int:
    longest = max(len(s) for s in data.segments)
    if window_s is None:
        window_s = float(np.clip(len(data) * data.dt_s / 8.0, 1.0, 20.0))
    return int(np.clip(round(window_s / data.dt_s), 8, longest))


def _transform(x: FloatArray, taper: FloatArray) -> npt.NDArray[np.complex128]:
    return np.asarray(np.fft.rfft((x - x.mean()) * taper))


def _power_band(parts: Sequence[FloatArray], dt_s: float) -> float:
    """Frequency below which 95 % of the power of the longest part lies."""
    longest = max(parts, key=len)
    power = np.abs(np.fft.rfft(longest * np.hanning(len(longest)))) ** 2
    total = float(power.sum())
    if total == 0.0:
        return 0.0
    index = int(np.searchsorted(np.cumsum(power), 0.95 * total))
    return float(np.fft.rfftfreq(len(longest), dt_s)[min(index, len(power) - 1)])
