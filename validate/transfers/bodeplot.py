"""Bode plots: the measured response with its intervals, the model with its band, the coherence below.

matplotlib is imported only here, and only when a picture is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.escaping import picture_text
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.polynomials import DB
from flysid.validate.show.pictures import check_picture, save_picture
from flysid.validate.transfers.identify import ChannelTransfers

MEASURED, MODEL, SHADE = "#222222", "#c2570c", "#e8f0e8"


def draw_bode(channels: Sequence[ChannelTransfers], path: str | Path) -> None:
    """One column per input and output: gain, phase, coherence, into a PNG, SVG or PDF file.

    Raises
    ------
    UsageError : matplotlib is missing, or the file's ending is not known.
    WriteError : the file cannot be written.
    """
    path = Path(path)
    check_picture(path)
    from matplotlib.figure import Figure

    places = [
        (c, i, j) for c in channels for i in range(len(c.data.outputs)) for j in range(len(c.data.inputs))
    ]
    figure = Figure(figsize=(max(4.2, 3.6 * len(places)), 6.5), layout="constrained")
    panels = figure.subplots(
        3, len(places), squeeze=False, sharex="col", gridspec_kw={"height_ratios": [3, 3, 1.2]}
    )
    for column, (channel, i, j) in enumerate(places):
        _column(panels[:, column], channel, i, j)
    panels[0, 0].set_ylabel("gain, dB")
    panels[1, 0].set_ylabel("phase, deg")
    panels[2, 0].set_ylabel("coherence")
    save_picture(figure, path)


def _column(panels: Any, channel: ChannelTransfers, output: int, source: int) -> None:
    measured = channel.measured[output]
    names = f"{channel.data.inputs[source].name} to {channel.data.outputs[output].name}"
    panels[0].set_title(picture_text(f"{channel.name}: {names}"), fontsize=9, loc="left")
    high = 0.95 * np.pi / channel.data.dt_s
    omega = np.geomspace(high / 1000.0, high, 200) if measured is None else _dense(measured.omega)
    g, gain_band, phase_band = channel.response(output, source, omega)
    gain = 20.0 * np.log10(np.maximum(np.abs(g), 1e-300))
    phase = np.degrees(np.unwrap(np.angle(g)))
    if measured is not None:
        shown, model = channel.phases(output, source, measured)
        _points(panels, measured, source, shown, channel.band(output, source))
        phase += 360.0 * np.round((model[0] - phase[0]) / 360.0)
    for panel, line, band in ((panels[0], gain, gain_band), (panels[1], phase, phase_band)):
        panel.semilogx(omega, line, color=MODEL, linewidth=1.2, label="model")
        panel.fill_between(omega, line - band, line + band, color=MODEL, alpha=0.25, linewidth=0)
        panel.grid(True, which="both", linewidth=0.3, alpha=0.6)
    span = np.ptp(gain)
    panels[0].set_ylim(gain.min() - 0.2 * span - 3.0, gain.max() + 0.2 * span + 3.0)
    panels[0].legend(fontsize=7)
    panels[2].set_ylim(0.0, 1.05)
    panels[2].set_xlabel("rad/s")


def _points(
    panels: Any,
    measured: MeasuredResponse,
    source: int,
    phase: FloatArray,
    band: tuple[float, float] | None,
    *,
    least_coherence: float = 0.3,
) -> None:
    """`least_coherence`: points of less coherence than this are left out of gain and phase."""
    width = measured.half_width()[:, source]
    told = measured.coherence[:, source] > least_coherence
    omega = measured.omega[told]
    errors = DB * width[told], np.degrees(width[told])
    values = measured.gain_db[told, source], phase[told]
    for panel, value, error in zip(panels, values, errors, strict=False):
        panel.errorbar(
            omega, value, error, fmt=".", color=MEASURED, markersize=3, linewidth=0.7, label="measured, 95 %"
        )
    panels[2].semilogx(measured.omega, measured.coherence[:, source], color=MEASURED, linewidth=0.9)
    panels[2].axhline(0.6, color=MODEL, linewidth=0.6, linestyle="--")
    if band is not None:
        for panel in panels:
            panel.axvspan(*band, color=SHADE, zorder=0, linewidth=0)
        panels[0].set_xlim(0.8 * measured.omega[0], min(5.0 * band[1], measured.omega[-1]))


def _dense(omega: FloatArray) -> FloatArray:
    return np.asarray(np.geomspace(omega[0], omega[-1], 300))
