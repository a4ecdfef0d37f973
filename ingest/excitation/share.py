"""Which share of an output's power follows an input, where the input has its power.

Over a few neighbouring bins of the spectrum of a whole segment, response and leakage are polynomials of the
frequency (the local polynomial method: Pintelon and Schoukens 2012, System Identification, chapter 7). What
is left beside both is noise; what is left beside leakage alone is noise and response. Both are counted by
their degrees of freedom, so that a short record, a dead time or a slow mode make no noise of their own, as
they do in Welch's coherence. Bins count by their power.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset, Segment
from flysid.ingest.excitation.excitation import Excitation
from flysid.stretch import FloatArray

ComplexArray = npt.NDArray[np.complex128]

COEFFICIENTS = 3
"""Of the parabolas that response and leakage are over neighbouring bins, each."""
BINS = 3 * COEFFICIENTS
"""Bins that are taken together: a third of what they hold is left to the noise."""
TAIL = 0.025
"""Chance of the truth to lie beyond either end of the interval."""


@dataclass(frozen=True)
class Share:
    """A share from 0 to 1 with its 95 % interval.

    >>> Share(0.5, 0.4, 0.6).words
    'at most 60 %'
    """

    value: float
    low: float
    high: float

    @property
    def words(self) -> str:
        """ "at most 60 %": what is known where a share is too small."""
        return f"at most {100.0 * self.high:.0f} %"


def share_explained(data: Dataset, moves: Excitation, column: int = 0, output: int = 0) -> Share:
    """The share of an output's power, in the band of an input, that a linear response to it explains.

    `moves`: `excitation` of that input. The interval is from 0 to 1 where all segments are too short.
    """
    found = [_powers(s, data.dt_s, moves.band_hz, (column, output)) for s in data.segments]
    noise, whole = np.concatenate(found, axis=1) if found else np.zeros((2, 0))
    if not whole.sum() > 0.0:
        return Share(0.0, 0.0, 1.0)
    left = float(noise.sum() / whole.sum())
    return Share(*(float(np.clip(1.0 - left * factor, 0.0, 1.0)) for factor in (1.0, *_spread(noise))))


def _powers(segment: Segment, dt_s: float, band_hz: float, pair: tuple[int, int]) -> FloatArray:
    """(2, B) noise, and noise with response, over B runs of bins from the lowest to the band's end."""
    u, y = (np.fft.rfft(x - x.mean()) for x in (segment.u[:, pair[0]], segment.y[:, pair[1]]))
    last = int(np.searchsorted(np.fft.rfftfreq(len(segment), dt_s), band_hz, side="right"))
    runs = (max(min(last, len(u)), BINS + 1) - 1) // BINS
    if len(u) < BINS + 1:
        return np.zeros((2, 0))
    u, y = (x[1 : 1 + runs * BINS].reshape(runs, BINS) for x in (u, y))
    parabola = np.linspace(-1.0, 1.0, BINS)[:, None] ** np.arange(COEFFICIENTS)
    leakage = np.broadcast_to(parabola, (runs, BINS, COEFFICIENTS)).astype(np.complex128)
    both = np.concatenate([leakage, u[:, :, None] * parabola], axis=2)
    return np.stack([_left(columns, y) for columns in (both, leakage)])


def _left(columns: ComplexArray, y: ComplexArray) -> FloatArray:
    """(B,) power of y (B, n) beside the columns (B, n, p), by degree of freedom."""
    q, _ = np.linalg.qr(columns)
    along = np.einsum("bnp,bn->bp", q.conj(), y)
    rest = np.sum(np.abs(y) ** 2, axis=1) - np.sum(np.abs(along) ** 2, axis=1)
    return np.asarray(np.maximum(rest, 0.0) / (columns.shape[1] - columns.shape[2]))


def _spread(noise: FloatArray) -> Iterator[float]:
    """By how much the noise may be larger, and smaller, than it was found (chi-squared)."""
    from scipy.special import chdtri

    alike = float(noise.sum()) ** 2 / max(float(noise @ noise), np.finfo(float).tiny)
    freedom = 2.0 * (BINS - 2 * COEFFICIENTS) * max(alike, 1.0)
    return (freedom / float(chdtri(freedom, tail)) for tail in (1.0 - TAIL, TAIL))
