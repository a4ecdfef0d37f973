"""The common grid of a fleet's channel: chosen once from a few coherent flights, then kept.

The recipe's own rate is too fast for most channels: an ARX model at 50 Hz spends its lags on a fifth of a
second. So the grid is `RATE_OVER_BAND` times as fast as the highest frequency at which output and input are
coherent, and as fast as the recipe's where that is slower.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.fleet.models.band import band_of, frequencies_of, spectra_of
from flysid.ingest.align.resample import nice_period_ns

RATE_OVER_BAND = 10.0
"""Samples in a period of the highest coherent frequency (Astrom and Wittenmark, 1997, 2.9: 10 to 30)."""


class Sampling(msgspec.Struct, frozen=True):
    """How a channel's triangles are made.

    `dt_s`: sample time.
    `lags`: L, of inputs and outputs.
    `window`: of the spectra, samples.
    `inputs`, `outputs`: names of the signals.
    `units`: of inputs, then outputs.
    """

    dt_s: float
    lags: int
    window: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def regressors(self) -> int:
        """Columns of Phi: inputs at lags 0..L, outputs at lags 1..L."""
        return len(self.inputs) * (self.lags + 1) + len(self.outputs) * self.lags

    @property
    def columns(self) -> int:
        """Of the triangle: the constant, the regressors, the outputs."""
        return 1 + self.regressors + len(self.outputs)

    @property
    def omega(self) -> FloatArray:
        """(F,) frequencies of the spectra, rad/s."""
        return frequencies_of(self.window, self.dt_s)


def choose_sampling(data: Dataset, rate_hz: float | None = None, *, lags: int = 10) -> Sampling:
    """The grid for a fleet from a few of its flights on the recipe's grid.

    `rate_hz`: the user's choice; None: from the coherence.
    `lags`: so that the history is one such period.
    Raises DataError: nowhere are input and output coherent.
    """
    seconds = float(np.median([len(s) for s in data.segments])) * data.dt_s
    window = window_of(seconds, data.dt_s)
    if rate_hz is None:
        spectra, _ = spectra_of(data.segments, window)
        omega = frequencies_of(window, data.dt_s)
        edges = [band_of(spectra, omega, i, len(data.inputs) + j, data.name)
                 for i in range(len(data.inputs)) for j in range(len(data.outputs))]  # fmt: skip
        rate_hz = RATE_OVER_BAND * max(band.high for band in edges) / (2.0 * np.pi)
    dt_s = max(data.dt_s, nice_period_ns(1e9 / rate_hz) * 1e-9)
    return Sampling(
        dt_s=dt_s,
        lags=lags,
        window=window_of(seconds, dt_s),
        inputs=tuple(s.name for s in data.inputs),
        outputs=tuple(s.name for s in data.outputs),
        units=tuple(s.unit for s in (*data.inputs, *data.outputs)),
    )


def window_of(seconds: float, dt_s: float, *, share: float = 0.5) -> int:
    """Samples of a window for flights of that length: even, and not below 16.

    `share`: of a flight's length: two cycles of the lowest frequency fit half a flight.
    """
    return max(16, 2 * round(share * seconds / dt_s / 2.0))


def spread(names: Sequence[str], count: int) -> list[str]:
    """At most `count` of the names, evenly spread."""
    at = np.unique(np.linspace(0, len(names) - 1, min(count, len(names))).round().astype(int))
    return [names[i] for i in at]
