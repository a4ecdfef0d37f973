"""Figures for a paper, as PDF, SVG or PNG.

One file per channel and output, of the page's own pictures: measured and simulated output, error, input;
static map; memberships where the model has rules, else the frequency response. A double column wide: 170 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from flysid.errors import UsageError
from flysid.escaping import picture_text
from flysid.pictures import check_picture, picture_bytes, require_matplotlib
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.trials import FREE_RUN, run_trials
from flysid.validate.show.page.describe import Page
from flysid.validate.show.page.figures import key
from flysid.validate.show.page.modelpanels import Panel
from flysid.validate.show.page.overlay import WIDE, drawn
from flysid.validate.show.page.sections import Section
from flysid.validate.show.page.svg import BASELINE, CONTENDER, HALF
from flysid.validate.show.sheets import Sheet, height_of, stroke_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN = 6.7


def figure_files(page: Page, kind: str = "pdf") -> dict[str, bytes]:
    """Name -> content of one figure per channel and output of a page; equal pages give equal bytes.

    Raises UsageError: an unknown kind, or matplotlib is not installed.
    """
    suffix = f".{kind}"
    check_picture(f"figures{suffix}")
    return {f"{_name(s)}{suffix}": picture_bytes(partial(draw_section, s), suffix) for s in page.sections}


def _name(section: Section) -> str:
    """ "channel-1-2" of the second output of the first channel."""
    return "-".join(["channel", *(str(int(number) + 1) for number in section.anchor[1:].split("-"))])


def draw_section(section: Section) -> Figure:
    """The free run with error and input; below it the static map, and fuzzy sets or a frequency response."""
    drawn = zip((BASELINE, CONTENDER), section.models, strict=False)
    names = key(
        [("measured", "measured"), *((css, f"{model}, free run") for css, model in drawn)], section.name
    )
    sets = _find(section.sets, "Membership functions") if section.key else Markup("")
    beside = sets or _find(section.dynamics, "Frequency response")
    static = _find(section.dynamics, "Static map")
    top = height_of(names)
    below = top + height_of(section.still)
    sheet = Sheet(WIDE, below + max(height_of(static), height_of(beside)) + top, WIDTH_IN)
    sheet.lay(names, 44.0, 0.0)
    sheet.lay(section.still, 0.0, top)
    sheet.lay(static, 0.0, below)
    sheet.lay(beside, WIDE - HALF, below)
    return sheet.figure


def _find(panels: Sequence[Panel], title: str) -> Markup:
    """The picture of the first panel whose title begins so; nothing where there is none."""
    return next((panel.picture for panel in panels if panel.title.startswith(title)), Markup(""))


def axis_label(name: str, unit: str = "") -> str:
    """ "v_x, m/s" for an axis, taken literally."""
    return picture_text(f"{name}, {unit}" if unit else name)


def plot_free_run(comparison: Comparison, output: str | None, ax: Any) -> Any:
    """The longest held-out segment, measured and in free run of the models of the headline; the axes.

    Raises UsageError: matplotlib is not installed; no such output.
    """
    require_matplotlib()
    import matplotlib.pyplot as plt

    names = [signal.name for signal in comparison.test.outputs]
    if output is not None and output not in names:
        raise UsageError(f"no output {output!r}", hint=f"one of {', '.join(names)}")
    j = 0 if output is None else names.index(output)
    axes = ax if ax is not None else plt.subplots()[1]
    c = comparison
    trial = max(run_trials(c.fitted, c.test, FREE_RUN), key=lambda t: len(t.y))
    t = c.dt_s * np.arange(trial.first, trial.first + len(trial.y))
    y = trial.y[:, j]
    reach = float(np.ptp(y)) or 1.0
    for name, css in drawn(c):
        axes.plot(t, trial.yh[name][:, j], label=f"{picture_text(name).upper()}, free run", **stroke_of(css))
    axes.plot(t, y, label="measured", **stroke_of("measured"))
    axes.set_ylim(float(y.min()) - 0.3 * reach, float(y.max()) + 0.3 * reach)
    axes.set_xlabel("time, s")
    axes.set_ylabel(axis_label(c.test.outputs[j].name, c.test.outputs[j].unit))
    axes.set_title(
        f"{picture_text(c.channel or c.test.outputs[j].name)}: {picture_text(c.segments[trial.segment])}"
    )
    axes.legend()
    return axes
