"""Figures for a paper, drawn by matplotlib as PDF, SVG or PNG; no window, no pyplot, no global state.

One file per channel and output: measured and simulated output, error, input; static map; frequency response;
memberships where the model has them. Sizes fit a double column (170 mm); fonts are embedded as text.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flysid.errors import UsageError, WriteError
from flysid.escaping import picture_text
from flysid.files import write_atomically
from flysid.model.capabilities import HasMemberships
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.trials import FREE_RUN, StructureTrial, run_trials
from flysid.validate.diagnose.context import ReportContext
from flysid.validate.diagnose.responses import responses, steady_outputs
from flysid.validate.show.page.overlay import drawn
from flysid.validate.show.page.rulefigures import antecedent_range
from flysid.validate.show.page.svg import BASELINE, CONTENDER

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

KINDS = ("pdf", "svg", "png")
WIDTH_IN = 6.7
HEIGHT_IN = 7.2
SETTINGS: dict[Any, Any] = {
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "flysid",
    "font.size": 8.0,
    "axes.linewidth": 0.6,
}
STYLES: dict[str, dict[str, Any]] = {
    BASELINE: {"color": "#c2570c", "linestyle": "--", "linewidth": 1.0},
    CONTENDER: {"color": "#1d5fd6", "linewidth": 1.0},
}

RULES = ("#5e2b97", "#0e8f85", "#6aa31b", "#dd9a10", "#c2334f", "#2d6cdf", "#8b5a2b", "#6b7280")
"""As on the page, where it is light; sets carry their names, because colour alone says nothing in print."""
BESIDE: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "va": "bottom"}


def figure_files(context: ReportContext, kind: str = "pdf") -> dict[str, bytes]:
    """Name -> content of one figure per channel and output; equal input gives equal bytes.

    Raises
    ------
    UsageError : an unknown kind, or matplotlib is not installed.
    """
    _refuse_unknown(kind)
    return {
        f"channel-{number + 1}-{j + 1}.{kind}": _render(partial(draw, context, name, j), kind)
        for number, (name, c) in enumerate(context.comparisons.items())
        for j in range(len(c.test.outputs))
    }


def write_figure(path: Path, drawing: Callable[[], Figure]) -> Path:
    """A figure as a file of the kind that its name ends with; equal input gives equal bytes.

    Raises
    ------
    UsageError : an unknown kind, or matplotlib is not installed; as `drawing`.
    WriteError : the file cannot be written.
    """
    kind = path.suffix.removeprefix(".")
    _refuse_unknown(kind)
    content = _render(drawing, kind)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content)
    except OSError as error:
        raise WriteError(f"the figure cannot be written: {error.strerror}", path=path) from error
    return path


def _refuse_unknown(kind: str) -> None:
    if kind not in KINDS:
        raise UsageError(f"figures of kind {kind!r} are not known", hint=f"use one of {', '.join(KINDS)}")


def require_matplotlib() -> None:
    """Raise UsageError where matplotlib is not installed, before any work is done."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise UsageError("matplotlib is not installed", hint="pip install 'flysid[plot]'") from error


def draw(context: ReportContext, channel: str, output: int = 0) -> Figure:
    """The figure of one channel and output, for a notebook; needs matplotlib."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    grid = figure.add_gridspec(4, 2, height_ratios=(3.0, 1.2, 1.0, 3.0))
    top = figure.add_subplot(grid[0, :])
    middle = figure.add_subplot(grid[1, :], sharex=top)
    low = figure.add_subplot(grid[2, :], sharex=top)
    _time_panels((top, middle, low), context, channel, output)
    _static_panel(figure.add_subplot(grid[3, 0]), context, channel, output)
    _last_panel(figure.add_subplot(grid[3, 1]), context, channel, output)
    return figure


def _render(drawing: Callable[[], Figure], kind: str) -> bytes:
    """The file's bytes; equal input gives equal bytes (no dates, no random ids)."""
    import io

    require_matplotlib()
    from matplotlib import rc_context

    metadata: dict[str, dict[str, Any]] = {
        "pdf": {"CreationDate": None, "Producer": None, "Creator": "flysid"},
        "svg": {"Date": None, "Creator": "flysid"},
        "png": {"Software": "flysid"},
    }
    buffer = io.BytesIO()
    with rc_context(SETTINGS):
        drawing().savefig(buffer, format=kind, metadata=metadata[kind], dpi=200)
    return buffer.getvalue()


def axis_label(name: str, unit: str = "") -> str:
    """ "v_x, m/s" for an axis, taken literally."""
    return picture_text(f"{name}, {unit}" if unit else name)


def _longest(trials: tuple[StructureTrial, ...]) -> StructureTrial:
    return max(trials, key=lambda t: len(t.y))


def plot_free_run(comparison: Comparison, output: str | None, ax: Any) -> Any:
    """The longest held-out segment, measured and in free run of the models of the headline; the axes.

    Raises
    ------
    UsageError : matplotlib is not installed; no such output.
    """
    require_matplotlib()
    import matplotlib.pyplot as plt

    names = [signal.name for signal in comparison.test.outputs]
    if output is not None and output not in names:
        raise UsageError(f"no output {output!r}", hint=f"one of {', '.join(names)}")
    j = 0 if output is None else names.index(output)
    axes = ax if ax is not None else plt.subplots()[1]
    _draw_free_run(
        axes, comparison, _longest(tuple(run_trials(comparison.fitted, comparison.test, FREE_RUN))), j
    )
    axes.set_xlabel("time, s")
    axes.legend()
    return axes


def _draw_free_run(axes: Axes, c: Comparison, trial: StructureTrial, j: int) -> None:
    t = c.dt_s * np.arange(trial.first, trial.first + len(trial.y))
    y = trial.y[:, j]
    reach = float(np.ptp(y)) or 1.0
    for name, css in drawn(c):
        axes.plot(t, trial.yh[name][:, j], label=f"{picture_text(name).upper()}, free run", **STYLES[css])
    axes.plot(t, y, color="black", linewidth=0.8, label="measured")
    axes.set_ylim(float(y.min()) - 0.3 * reach, float(y.max()) + 0.3 * reach)
    axes.set_ylabel(axis_label(c.test.outputs[j].name, c.test.outputs[j].unit))
    axes.set_title(
        f"{picture_text(c.channel or c.test.outputs[j].name)}: {picture_text(c.segments[trial.segment])}"
    )


def _time_panels(panels: tuple[Axes, Axes, Axes], context: ReportContext, channel: str, j: int) -> None:
    c = context.comparisons[channel]
    trial = _longest(context.diagnoses[channel].free_runs)
    top, middle, low = panels
    t = c.dt_s * np.arange(trial.first, trial.first + len(trial.y))
    y = trial.y[:, j]
    _draw_free_run(top, c, trial, j)
    for name, css in drawn(c):
        middle.plot(t, y - trial.yh[name][:, j], **STYLES[css])
    segment = c.test.segments[trial.segment]
    signal = context.diagnoses[channel].outputs[j].main_input
    low.plot(t, segment.u[trial.first :, signal], color="0.35", linewidth=0.8)
    middle.set_ylabel(axis_label("error", c.test.outputs[j].unit))
    low.set_ylabel(axis_label(c.test.inputs[signal].name, c.test.inputs[signal].unit))
    low.set_xlabel("time, s")
    top.tick_params(labelbottom=False)
    middle.tick_params(labelbottom=False)
    top.legend(loc="upper right", ncols=3, frameon=False)


def _static_panel(panel: Axes, context: ReportContext, channel: str, j: int) -> None:
    c = context.comparisons[channel]
    data = context.train.get(channel, c.test)
    signal = context.diagnoses[channel].outputs[j].main_input
    u = np.concatenate([s.u for s in data.segments])
    y = np.concatenate([s.y[:, j] for s in data.segments])
    step = max(1, len(u) // 800)
    panel.plot(u[::step, signal], y[::step], ".", color="0.75", markersize=2)
    levels = np.linspace(float(u[:, signal].min()), float(u[:, signal].max()), 25)
    for name, css in drawn(c):
        panel.plot(levels, steady_outputs(c.fitted[name], levels, u.mean(axis=0), j, signal), **STYLES[css])
    panel.set_xlabel(axis_label(c.test.inputs[signal].name, c.test.inputs[signal].unit))
    panel.set_ylabel(axis_label(f"settled {c.test.outputs[j].name}", c.test.outputs[j].unit))
    panel.set_ylim(float(y.min()) - 0.3 * float(np.ptp(y)), float(y.max()) + 0.3 * float(np.ptp(y)) + 1e-12)


def _last_panel(panel: Axes, context: ReportContext, channel: str, j: int) -> None:
    """Memberships over the first antecedent where there are several rules; else the frequency response."""
    c = context.comparisons[channel]
    model = c.fitted[c.contender] if c.contender else None
    data = context.train.get(channel, c.test)
    if isinstance(model, HasMemberships) and c.contender and c.models[c.contender].n_rules > 1:
        name = model.antecedents[0]
        limits = antecedent_range(name, data)
        if limits is not None:
            x = np.linspace(*limits, 200)
            for r, grade in enumerate(model.memberships(0, x).T):
                colour = RULES[r % len(RULES)]
                panel.plot(x, grade, linewidth=1.0, color=colour)
                peak = int(np.argmax(grade))
                panel.annotate(f"A{r + 1}", (x[peak], grade[peak]), (0, 2), color=colour, **BESIDE)
            panel.margins(y=0.12)
            units = {s.name: s.unit for s in (*c.test.inputs, *c.test.outputs)}
            panel.set_xlabel(axis_label(name, units.get(name.split("(")[0], "")))
            panel.set_ylabel("membership")
            return
    signal = context.diagnoses[channel].outputs[j].main_input
    seconds = max(len(s) for s in c.test.segments) * c.dt_s
    hz = np.geomspace(2.0 / seconds, 0.5 / c.dt_s, 200)
    for name, css in drawn(c):
        for response in responses(c.fitted[name], hz, j, signal):
            panel.loglog(hz, np.abs(response), **STYLES[css])
    panel.set_xlabel("frequency, Hz")
    units = (c.test.outputs[j].unit or "1", c.test.inputs[signal].unit or "1")
    panel.set_ylabel(axis_label("gain", " per ".join(units)))
