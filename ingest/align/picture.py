"""A quick picture of datasets: inputs and outputs over time, segments shaded, gaps left white.

matplotlib is imported only here, and only when a picture is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import UsageError, WriteError

SUFFIXES = (".png", ".svg", ".pdf")
INPUT, OUTPUT = "#cc6677", "#4477aa"
SHADES = ("#f1f1f1", "#e3e7ec")  # of segments in turn; white is no segment
MOST_NAMED = 60  # segments whose number and marks still fit
MAX_POINTS = 20_000  # per line; more are thinned, as no page shows them


def draw(datasets: Mapping[str, Dataset], path: str | Path, title: str = "") -> None:
    """One panel per channel and signal, inputs above outputs, into a PNG, SVG or PDF file.

    Raises
    ------
    UsageError : matplotlib is missing, there is nothing to draw, or the file's ending is not known.
    WriteError : the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"no picture format {path.suffix!r}", path=path, hint=", ".join(SUFFIXES))
    if not datasets:
        raise UsageError("there is nothing to draw", hint="choose a recipe whose streams the flight holds")
    figure_class = _figure_class()
    rows = [(name, data, kind) for name, data in datasets.items() for kind in ("u", "y")]
    figure = figure_class(figsize=(11, 0.6 + 1.5 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), 1, squeeze=False, sharex=True)[:, 0]
    start_s = min(s.t0_ns for data in datasets.values() for s in data.segments) * 1e-9
    for panel, (name, data, kind) in zip(panels, rows, strict=True):
        _panel(panel, data, kind, start_s)
        if kind == "u":
            panel.set_title(f"{name}: {_summary(data)}", loc="left", fontsize=9)
    panels[-1].set_xlabel("vehicle time since the first sample, s")
    if title:
        figure.suptitle(title, fontsize=10)
    try:
        figure.savefig(path, dpi=110)
    except OSError as error:
        raise WriteError(f"cannot be written: {error.strerror}", path=path) from error


def _figure_class() -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError("matplotlib is not installed", hint='pip install "flysid[plot]"') from error
    return Figure


def _panel(panel: Any, data: Dataset, kind: str, start_s: float) -> None:
    signals = data.inputs if kind == "u" else data.outputs
    for number, segment in enumerate(data.segments):
        time_s = segment.time_s(data.dt_s) - start_s
        panel.axvspan(time_s[0], time_s[-1], color=SHADES[number % len(SHADES)], linewidth=0, zorder=0)
        for i in range(len(signals)):
            _line(panel, time_s, segment, kind, i)
        if kind == "u" and len(data.segments) <= MOST_NAMED:
            words = f" {number + 1} {_marks(segment)}"
            panel.text(time_s[0], 0.96, words, transform=_top(panel), fontsize=6, va="top", clip_on=True)
    panel.set_ylabel(", ".join(_label(s) for s in signals), fontsize=8)
    panel.tick_params(labelsize=7)
    panel.margins(x=0.01)


def _marks(segment: Segment) -> str:
    """Mode, and the share of samples at a limit where that is worth saying."""
    mode, at_limit = str(segment.marks.get("mode", "")), float(segment.marks.get("saturated", 0.0))
    words = f"mode {mode}" if mode.isdigit() else mode
    return f"{words}, {at_limit:.0%} at a limit" if at_limit > 0.01 else words


def _line(panel: Any, time_s: Any, segment: Segment, kind: str, column: int) -> None:
    values = (segment.u if kind == "u" else segment.y)[:, column]
    step = max(1, len(values) // MAX_POINTS)
    style = "steps-post" if kind == "u" else "default"
    color = INPUT if kind == "u" else OUTPUT
    panel.plot(time_s[::step], np.asarray(values[::step]), drawstyle=style, color=color, linewidth=0.8)


def _top(panel: Any) -> Any:
    """x in data, y in shares of the panel."""
    return panel.get_xaxis_transform()


def _label(signal: Signal) -> str:
    return f"{signal.name} [{signal.unit}]" if signal.unit else signal.name


def _summary(data: Dataset) -> str:
    seconds = len(data) * data.dt_s
    count = f"{len(data.segments)} segment{'s' if len(data.segments) != 1 else ''}"
    return f"{count}, {seconds:.0f} s at {1 / data.dt_s:.4g} Hz"
