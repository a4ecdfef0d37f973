"""Responses to the setpoint and steps, under the present settings and under others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from flysid.escaping import picture_text
from flysid.loops.forecast import STEP_RATE_HZ, Forecast

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_forecasts(found: Sequence[Forecast]) -> Figure:
    """A row of two pictures for every axis: gain over frequency in its 95 % region, and the step."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.2 * len(found)), layout="constrained")
    rows = figure.subplots(len(found), 2, squeeze=False)
    for one, (gain, step) in zip(found, rows, strict=True):
        for side, words, color in ((one.before, "as flown", "0.45"), (one.after, "predicted", "C0")):
            gain.semilogx(one.f, 20.0 * np.log10(np.abs(side.response)), color=color, label=words)
            gain.fill_between(one.f, *side.db, color=color, alpha=0.2, linewidth=0.0)
            time = np.arange(len(side.answer)) / STEP_RATE_HZ
            step.plot(time, side.answer, color=color, label=words)
        gain.set(xlabel="Hz", ylabel="dB", title=picture_text(f"{one.axis}: setpoint to rate"))
        step.set(xlabel="s", title="step of the setpoint")
        step.legend(fontsize=8)
    return figure
