"""The paper's figures 4 to 6 of a model of rules, panels a to h, by matplotlib; no window, no global state.

(a) membership functions, (b) the model's output beside the measured one, (c) its error, (d) input and output
over time, (e) the static characteristic over the data, (f) what every rule concludes where it speaks, (g) and
(h) the degree of fulfilment of the first and of the other rules.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from flysid.dataset import FloatArray, Segment
from flysid.errors import UsageError
from flysid.files import write_atomically, writing_to
from flysid.model.base import Fitted
from flysid.model.start import as_modelled, run_from_window, start_window
from flysid.pictures import check_picture, picture_bytes, require_matplotlib
from flysid.validate.diagnose.responses import steady_outputs
from flysid.validate.show.page.rulefigures import SHOWN_FROM
from flysid.validate.show.paperfigures import axis_label
from flysid.validate.show.sheets import stroke_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE_IN = (6.7, 8.6)


class OfRules(Fitted, Protocol):
    """A model that can be drawn: static rules, rules over lags, rules over hidden states."""

    @property
    def antecedents(self) -> tuple[str, ...]: ...
    @property
    def trained_range(self) -> FloatArray: ...
    def memberships(self, variable: int, x: FloatArray) -> FloatArray: ...
    def rule_outputs(self, u: FloatArray, y: FloatArray) -> FloatArray: ...


def draw_rules(model: OfRules, segment: Segment, output: int = 0, signal: int = 0) -> Figure:
    """The eight panels of one output and input along a segment, for a notebook or `savefig`.

    Raises
    ------
    UsageError : a model without rules of its own; no such output or input; matplotlib is not installed.

    Examples
    --------
    >>> model = flysid.StaticTS(rules=2).fit(train)  # train: see `flysid.Dataset`
    >>> figure = flysid.draw_rules(model, train.segments[0])
    >>> figure.axes[0].get_title(loc="left")
    '(a)'
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    if not (hasattr(model, "memberships") and hasattr(model, "rule_outputs")):
        raise UsageError(
            f"no rules to draw: the model is {model.structure!r}", hint="fit flysid.TS or flysid.StaticTS"
        )
    if not (0 <= output < len(model.outputs) and 0 <= signal < len(model.inputs)):
        raise UsageError(f"the model has no output {output} or no input {signal}", hint="they count from 0")
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    panels = figure.subplots(4, 2).ravel()
    for panel, letter in zip(panels, "abcdefgh", strict=True):
        panel.set_title(f"({letter})", loc="left")
    _sets(panels[0], model)
    _over_time(panels[1:4], model, segment, (output, signal))
    _characteristic(panels[4], model, segment, (output, signal))
    _rules(panels[5:], model, segment, output)
    return figure


def write_rules_figure(path: str | Path, model: OfRules, segment: Segment) -> Path:
    """The figure as a file, of the kind that its name ends with; equal input gives equal bytes.

    Raises UsageError: another kind than pdf, svg, png; as `draw_rules`. Raises WriteError: the file cannot be
    written.
    """
    path = Path(path)
    check_picture(path)
    content = picture_bytes(partial(draw_rules, model, segment), path.suffix)
    with writing_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content)
    return path


def _sets(panel: Axes, model: OfRules) -> None:
    if not model.antecedents:
        panel.set_xlabel("one rule, always")
        return
    low, high = model.trained_range[:, 0]
    x = np.linspace(low, high, 300)
    for r, grade in enumerate(model.memberships(0, x).T):
        panel.plot(x, grade, **_stroke(r), label=f"A{r + 1}")
    panel.set_xlabel(axis_label(model.antecedents[0]))
    panel.set_ylabel("membership")
    panel.legend(ncols=2, frameon=False, fontsize=6)


def _stroke(rule: int) -> dict[str, Any]:
    return stroke_of(f"rule r{rule % 8 + 1}")


def _over_time(panels: Any, model: OfRules, segment: Segment, at: tuple[int, int]) -> None:
    j, i = at
    t = model.dt_s * np.arange(len(segment))
    y = segment.y[:, j]
    run = run_from_window(model, segment, start_window(model.n_init, len(segment), model.dt_s))[:, j]
    name = axis_label(model.outputs[j].name, model.outputs[j].unit)
    panels[0].plot(t, y, color="black", linewidth=0.8, label="measured")
    panels[0].plot(t, run, color="#1d5fd6", linewidth=0.8, linestyle="--", label="model, free run")
    panels[1].plot(t, y - run, color="#1d5fd6", linewidth=0.8)
    panels[2].plot(t, segment.u[:, i], color="0.5", linewidth=0.8, label=axis_label(model.inputs[i].name))
    panels[2].plot(t, y, color="black", linewidth=0.8, label=axis_label(model.outputs[j].name))
    for panel, label in zip(panels, (name, f"error, {name}", "input and output"), strict=True):
        panel.set_xlabel("time, s")
        panel.set_ylabel(label)
    for panel in (panels[0], panels[2]):
        panel.legend(frameon=False, fontsize=6)


def _characteristic(
    panel: Axes, model: OfRules, segment: Segment, at: tuple[int, int], *, most_points: int = 2000
) -> None:
    j, i = at
    every = max(1, len(segment) // most_points)
    u = segment.u[:, i]
    panel.plot(u[::every], segment.y[::every, j], ".", color="0.7", markersize=2)
    levels = np.linspace(float(u.min()), float(u.max()), 40)
    panel.plot(levels, steady_outputs(model, levels, segment.u.mean(axis=0), j, i), color="#c2334f")
    panel.set_xlabel(axis_label(model.inputs[i].name, model.inputs[i].unit))
    panel.set_ylabel(axis_label(model.outputs[j].name, model.outputs[j].unit))


def _rules(panels: Any, model: OfRules, segment: Segment, j: int) -> None:
    """What every rule concludes where it speaks, then the degrees of fulfilment in two halves."""
    t = model.dt_s * np.arange(len(segment))
    y = as_modelled(model, segment).y
    strength = model.firing(segment.u, y)
    alone = model.rule_outputs(segment.u, y)[:, :, j]
    half = (strength.shape[1] + 1) // 2
    for r in range(strength.shape[1]):
        said = np.where(strength[:, r] >= SHOWN_FROM, alone[:, r], np.nan)
        panels[0].plot(t, said, **_stroke(r))
        panels[1 + (r >= half)].plot(t, strength[:, r], **_stroke(r), label=f"R{r + 1}")
    panels[0].set_ylabel("output of every rule")
    for panel in panels:
        panel.set_xlabel("time, s")
    for panel in panels[1:]:
        panel.set_ylabel("degree of fulfilment")
        panel.set_ylim(-0.02, 1.02)
        if panel.lines:
            panel.legend(ncols=2, frameon=False, fontsize=6)
