"""Pictures of a gyro's spectrum: by axis, and over throttle or time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.reviews.fact import HeatMap, Picture, PictureLine, Shown
from flysid.reviews.logged import Column
from flysid.showing import significant
from flysid.spectra.peaks import Peak
from flysid.spectra.spectrum import Spread, Windows, spread_over

DENSITY = "dB over 1 (deg/s)2/Hz"


def pictures_of(
    windows: Mapping[str, Windows], peaks: Mapping[str, Sequence[Peak]], throttle: Column | None
) -> tuple[Shown, ...]:
    """Spectra of all axes in one picture, and a map of the axis that shakes most; () without any."""
    if not windows:
        return ()
    first = next(iter(windows.values()))
    lines = tuple(
        PictureLine(axis, w.hz, decibels(w.mean), style=f"r{k}")
        for k, (axis, w) in enumerate(windows.items(), 1)
    )
    strongest = {axis: found[0] for axis, found in peaks.items() if found}
    marks = {peak.hz: f"{peak.hz:.0f} Hz" for peak in strongest.values()}
    spectrum = Picture(
        "Vibration",
        "frequency (Hz)",
        f"gyro ({DENSITY})",
        lines,
        aside=f"gyro; logged at {significant(first.rate_hz)} Hz",
        marks=marks,
        hidden_from=first.nyquist_hz,
    )
    axis = max(windows, key=lambda name: strongest[name].rms if name in strongest else 0.0)
    return (spectrum, heat_map(axis, windows[axis], throttle))


def heat_map(axis: str, windows: Windows, throttle: Column | None, bins: int = 30) -> HeatMap:
    """A spectrum over the throttle where it moved by more than a tenth, else over time."""
    opened = throttle.held(windows.at_s) if throttle is not None else np.full(len(windows.at_s), np.nan)
    over_throttle = bool(np.nanmax(opened, initial=0.0) - np.nanmin(opened, initial=1.0) > 0.1)
    spread = spread_over(windows, opened if over_throttle else windows.at_s, bins)
    hz, values = _coarser(spread)
    label = "throttle" if over_throttle else "time (s)"
    return HeatMap(
        f"Vibration over {'throttle' if over_throttle else 'time'}",
        "frequency (Hz)",
        label,
        hz,
        spread.middles,
        decibels(values),
        aside=f"{axis}; {DENSITY}",
    )


def decibels(density: FloatArray) -> FloatArray:
    """10 log10; what is nothing becomes NaN."""
    return np.asarray(10.0 * np.log10(np.where(density > 0.0, density, np.nan)))


def _coarser(spread: Spread, most: int = 160) -> tuple[FloatArray, FloatArray]:
    """Frequencies and densities with so many columns at most, by their means."""
    every = -(-len(spread.hz) // most)
    count = len(spread.hz) // every * every
    hz = spread.hz[:count].reshape(-1, every).mean(axis=1)
    rows = spread.density[:, :count].reshape(len(spread.density), -1, every).mean(axis=2)
    return np.asarray(hz), np.asarray(rows)
