"""Spectra as a picture: lines by field, and a map of the first one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from flysid.dataset import FloatArray
from flysid.escaping import picture_text
from flysid.pictures import save_picture
from flysid.reviews.field_spectra import FieldSpectrum
from flysid.reviews.gyro import throttle_of
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.spectrum_pictures import decibels, heat_map
from flysid.spectra.spectrum import spread_over


def draw_spectra(
    flight: LoggedFlight,
    spectra: Sequence[FieldSpectrum],
    quantity: FloatArray | None,
    over: str | None,
    path: Path,
) -> None:
    """Draw them into a file.

    `quantity`, `over`: what the map is over, and its name; None: the throttle where it moves, else time.
    Raises WriteError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    above, below = figure.subplots(2, 1)
    for spectrum in spectra:
        (line,) = above.plot(spectrum.windows.hz, decibels(spectrum.windows.mean), linewidth=1.0)
        line.set_label(picture_text(spectrum.name))
        for peak in spectrum.peaks[:3]:
            level = float(np.interp(peak.hz, spectrum.windows.hz, decibels(spectrum.windows.mean)))
            above.annotate(f"{peak.hz:.0f} Hz", (peak.hz, level), fontsize=8, ha="center", va="bottom")
    first = spectra[0]
    unit = first.column.unit or "1"
    above.set(xlabel="Hz", ylabel=picture_text(f"dB over 1 ({unit})2/Hz"), title=picture_text(flight.name))
    above.set_xlim(0.0, first.windows.nyquist_hz)
    above.legend()
    if quantity is not None and over:
        spread = spread_over(first.windows, quantity, 30)
        hz, y, values, label = spread.hz, spread.middles, decibels(spread.density), over
    else:
        drawn = heat_map(first.name, first.windows, throttle_of(flight))
        hz, y, values, label = drawn.x, drawn.y, drawn.values, drawn.y_label
    mesh = below.pcolormesh(hz, y, values, shading="nearest", rasterized=True)
    figure.colorbar(mesh, ax=below, label="dB")
    below.set(xlabel="Hz", ylabel=picture_text(label), title=picture_text(first.name))
    save_picture(figure, path)
