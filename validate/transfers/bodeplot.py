"""Bode plots: the measured response with its intervals, the model with its band, the coherence below."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from flysid.pictures import check_picture, save_picture
from flysid.validate.diagnose.bands import BandCurve, ResponseBand
from flysid.validate.show.page.figures import Points, bode
from flysid.validate.show.page.overlay import Role
from flysid.validate.show.page.svg import CONTENDER, HALF, text
from flysid.validate.show.sheets import Sheet
from flysid.validate.transfers.identify import ChannelTransfers

HEIGHT = 456.0
COLUMN_IN = 4.2


def draw_bode(channels: Sequence[ChannelTransfers], path: str | Path) -> None:
    """One column per input and output, as on the page of a run, into a PNG, SVG or PDF file.

    Raises
    ------
    UsageError : matplotlib is missing, or the file's ending is not known.
    WriteError : the file cannot be written.
    """
    check_picture(path)
    places = [
        (c, i, j) for c in channels for i in range(len(c.data.outputs)) for j in range(len(c.data.inputs))
    ]
    sheet = Sheet(HALF * len(places), HEIGHT, COLUMN_IN * len(places))
    for column, (channel, i, j) in enumerate(places):
        names = f"{channel.name}: {channel.data.inputs[j].name} to {channel.data.outputs[i].name}"
        sheet.lay(text(44.0, 14.0, names), HALF * column, 0.0)
        sheet.lay(bode_picture(channel, i, j, names), HALF * column, 16.0)
    save_picture(sheet.figure, path)


def bode_picture(channel: ChannelTransfers, output: int, source: int, label: str) -> Markup:
    """Gain, phase and coherence from one input to one output, and where to trust them."""
    measured = channel.measured[output]
    points = None
    high = 0.95 * np.pi / channel.data.dt_s
    omega = np.geomspace(high / 1000.0, high, 300)
    if measured is not None:
        omega = np.geomspace(measured.omega[0], measured.omega[-1], 300)
        width = measured.half_width()[:, source]
        hz = measured.omega / (2.0 * np.pi)
        points = Points(hz, measured.response[:, source], measured.coherence[:, source], width)
    g, gain_db, phase_deg = channel.response(output, source, omega)
    factor = 10.0 ** (gain_db / 20.0)
    turn = np.radians(phase_deg)
    curve = BandCurve(g, ResponseBand(np.abs(g) / factor, np.abs(g) * factor, -turn, turn))
    trusted = channel.band(output, source)
    units = (channel.data.outputs[output].unit or "1", channel.data.inputs[source].unit or "1")
    return bode(
        points,
        {Role("tf", CONTENDER, shown=True): [curve]},
        omega / (2.0 * np.pi),
        " per ".join(units),
        label,
        None if trusted is None else (trusted[0] / (2.0 * np.pi), trusted[1] / (2.0 * np.pi)),
    )
