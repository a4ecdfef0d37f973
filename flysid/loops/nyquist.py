"""The loop in the complex plane: its distance from -1 is what the margins measure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from flysid.dataset import FloatArray
from flysid.escaping import picture_text
from flysid.loops.judged import Judged
from flysid.loops.margins import smooth
from flysid.loops.stick_response import ComplexArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Curve:
    """The open loop of one axis inside its band, as its margins are computed from it.

    `f`: (F,) Hz.
    `loop`: (F,) plant times controller.
    `radius`: (F,) distance from `loop` within which 95 % of the resampled loops lie.
    """

    f: FloatArray
    loop: ComplexArray
    radius: FloatArray


def curve_of(judged: Judged, *, level: float = 0.95) -> Curve | None:
    """The curve; None of an axis that was refused."""
    if judged.loop is None or judged.controller is None or judged.margins is None:
        return None
    low, high = judged.margins.band_hz
    at = (judged.loop.f >= low) & (judged.loop.f <= high)
    f = judged.loop.f[at]
    back = judged.controller.feedback(f)
    centre, draws = smooth(judged.loop, at)
    away = np.abs((draws - centre) * back)
    return Curve(f, centre * back, np.asarray(np.quantile(away, level, axis=0)))


def draw_nyquist(judged: Sequence[Judged]) -> Figure:
    """One curve per axis and set of gains, inside its band, in its 95 % region."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.subplots()
    turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 200))
    axes.plot(turn.real, turn.imag, color="0.8", linewidth=0.8)
    axes.plot((turn / 2.0 - 1.0).real, (turn / 2.0 - 1.0).imag, color="0.6", linewidth=0.8, linestyle="--")
    for j in judged:
        curve = curve_of(j)
        if curve is None:
            continue
        (line,) = axes.plot(curve.loop.real, curve.loop.imag, label=picture_text(j.lines()[0]), linewidth=1.5)
        round_it = curve.loop[:, None] + curve.radius[:, None] * turn
        axes.plot(round_it.real.T, round_it.imag.T, color=line.get_color(), alpha=0.15, linewidth=0.6)
    axes.plot([-1.0], [0.0], "k+", markersize=10)
    axes.set(xlim=(-3.0, 1.5), ylim=(-3.0, 1.5), xlabel="real", ylabel="imaginary", aspect="equal")
    axes.set_title("Open loop; discs: 95 % region; dashed: Ms = 2")
    axes.legend(fontsize=7, loc="lower right")
    return figure
