"""Timelines as a picture (PNG, SVG, PDF; matplotlib) or as text for a terminal (plotext)."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flysid.errors import UsageError
from flysid.escaping import one_line, picture_text
from flysid.ingest.lake.timeline import Timeline, Trace
from flysid.pictures import check_picture, save_picture
from flysid.validate.show.page.decimate import extremes

INK = "#5b6275"
SHADE = "#efefec"


def draw_flights(timelines: Sequence[Timeline], path: str | Path, title: str = "") -> None:
    """One column of panels, flight below flight, into a PNG, SVG or PDF file.

    Raises UsageError: matplotlib is missing, or the file's ending is not known. Raises WriteError: the file
    cannot be written.
    """
    check_picture(path)
    from matplotlib.figure import Figure

    count = sum(len(timeline.panels) for timeline in timelines)
    figure = Figure(figsize=(11, 0.8 + 1.7 * count), layout="constrained")
    axes = iter(figure.subplots(count, 1, squeeze=False)[:, 0])
    for timeline in timelines:
        drawn = [next(axes) for _ in timeline.panels]
        for axis, panel in zip(drawn, timeline.panels, strict=True):
            axis.sharex(drawn[0])
            _draw_panel(axis, panel)
            _draw_modes(axis, timeline, named=axis is drawn[0])
        if len(timelines) > 1:
            drawn[0].set_title(picture_text(timeline.name), loc="left", fontsize=9)
        drawn[-1].set_xlabel("time, s", fontsize=8)
    if title:
        figure.suptitle(picture_text(title), fontsize=10)
    save_picture(figure, path)


def flights_as_text(timelines: Sequence[Timeline], width: int) -> str:
    """Every panel in characters, `width` columns wide. Raises UsageError: plotext is missing."""
    if importlib.util.find_spec("plotext") is None:
        raise UsageError("plotext is not installed", hint='pip install "flysid[plot]"')
    import plotext

    parts = []
    for timeline in timelines:
        parts.append(one_line(timeline.name))
        for panel in timeline.panels:
            plotext.clear_figure()
            plotext.theme("clear")
            plotext.plotsize(width, 14)
            for trace in panel:
                time_s, values = _thin(trace, 4 * width)
                shown = np.isfinite(values)
                plotext.plot(
                    time_s[shown].tolist(),
                    values[shown].tolist(),
                    label=one_line(_label(trace)),
                    marker="braille",
                )
            parts.append(plotext.build())
    return "\n".join(parts)


def _draw_panel(axis: Any, panel: Sequence[Trace], *, most_samples: int = 20_000) -> None:
    """`most_samples`: samples of a line: more than any page shows."""
    for trace in panel:
        time_s, values = _thin(trace, most_samples)
        axis.plot(time_s, values, linewidth=0.9, label=picture_text(_label(trace)))
    axis.legend(fontsize=7, loc="upper right", ncols=4)
    axis.tick_params(labelsize=7)
    axis.grid(linewidth=0.3)
    axis.margins(x=0.0)


def _draw_modes(axis: Any, timeline: Timeline, named: bool) -> None:
    for i, (start_s, end_s, name) in enumerate(timeline.modes):
        if i % 2 == 0:
            axis.axvspan(start_s, end_s, color=SHADE, linewidth=0, zorder=0)
        if named:
            axis.text(
                start_s,
                1.02,
                f" {picture_text(name)}",
                transform=axis.get_xaxis_transform(),
                fontsize=7,
                color=INK,
                clip_on=True,
            )
    for moment in timeline.moments:
        axis.axvline(moment.time_s, ymin=0.95, color=INK, linewidth=0.7)


def _thin(trace: Trace, most: int) -> tuple[Any, Any]:
    kept = extremes(trace.values, -(-2 * len(trace.values) // most))
    return trace.time_s[kept], trace.values[kept]


def _label(trace: Trace) -> str:
    return f"{trace.name}, {trace.unit}" if trace.unit else trace.name
