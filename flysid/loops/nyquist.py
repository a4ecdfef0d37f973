"""The loop in the complex plane: its distance from -1 is what the margins measure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from flysid.errors import UsageError
from flysid.loops.judged import Judged
from flysid.loops.stick_response import plant


def draw_nyquist(judged: Sequence[Judged], path: Path) -> None:
    """One curve per axis and set of gains, inside its band, with what resampling makes of it.

    Raises
    ------
    UsageError : matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError("a picture needs matplotlib", hint="pip install 'flysid[plot]'") from error
    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.subplots()
    turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 200))
    axes.plot(turn.real, turn.imag, color="0.8", linewidth=0.8)
    axes.plot((turn / 2.0 - 1.0).real, (turn / 2.0 - 1.0).imag, color="0.6", linewidth=0.8, linestyle="--")
    for j in judged:
        if j.loop is None or j.controller is None or j.margins is None:
            continue
        low, high = j.margins.band_hz
        at = (j.loop.f >= low) & (j.loop.f <= high)
        back = j.controller.feedback(j.loop.f[at])
        curve = plant(j.loop.mean)[at] * back
        (line,) = axes.plot(curve.real, curve.imag, label="\n".join(j.lines()[:1]), linewidth=1.5)
        cloud = plant(j.loop.draws)[:50, at] * back
        axes.plot(cloud.real.T, cloud.imag.T, color=line.get_color(), alpha=0.06, linewidth=0.8)
    axes.plot([-1.0], [0.0], "k+", markersize=10)
    axes.set(xlim=(-3.0, 1.5), ylim=(-3.0, 1.5), xlabel="real", ylabel="imaginary", aspect="equal")
    axes.set_title("Loop; dashed: Ms = 2")
    axes.legend(fontsize=7, loc="lower right")
    figure.savefig(path)
