"""The most telling ten seconds of a channel: where the two models of the verdict differ most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from flysid.validate.comparison import Comparison
from flysid.validate.report.overlay import drawn
from flysid.validate.report.svg import Axes, line, picture, segment, span, text, tick_text, ticks
from flysid.validate.segmentnames import begin_s, clock, segment_names
from flysid.validate.trials import Trial
from flysid.validate.words import one_line

SECONDS = 10.0
WIDTH = 340.0
HEIGHT = 132.0


@dataclass(frozen=True, eq=False)
class Moment:
    """Rows `first` to `last` of a trial."""

    trial: Trial
    first: int
    last: int


def most_telling(comparison: Comparison, trials: Sequence[Trial], output: int) -> Moment:
    """The ten seconds over which the free runs of the models drawn lie farthest apart, in the mean square.

    Of one model: where it errs most.
    """
    rows = max(2, round(SECONDS / comparison.dt_s))
    names = [name for name, _ in drawn(comparison)]
    best = -1.0
    found = Moment(trials[0], 0, min(rows, len(trials[0].y)))
    for trial in trials:
        runs = [trial.yh[name][:, output] for name in names]
        apart = np.nan_to_num((runs[0] - (runs[1] if len(runs) > 1 else trial.y[:, output])) ** 2)
        sums = np.concatenate([[0.0], np.cumsum(apart)])
        length = min(rows, len(apart))
        means = (sums[length:] - sums[:-length]) / length
        at = int(np.argmax(means))
        if means[at] > best:
            best = float(means[at])
            found = Moment(trial, at, at + length)
    return found


def telling(comparison: Comparison, trials: Sequence[Trial], output: int) -> tuple[Markup, str]:
    """The picture, and the flight and time that it shows."""
    found = most_telling(comparison, trials, output)
    rows = slice(found.first, found.last)
    y = found.trial.y[rows, output]
    runs = [(css, found.trial.yh[name][rows, output]) for name, css in drawn(comparison)]
    whole = comparison.test.segments[found.trial.segment]
    start = whole.t0_ns * 1e-9 - begin_s(whole, comparison.test)
    start += (found.trial.first + found.first) * comparison.dt_s
    t = start + comparison.dt_s * np.arange(len(y), dtype=np.float64)
    low, high = span(y)
    reach = high - low
    all_low, all_high = span(y, *(values for _, values in runs))
    limits = max(all_low, low - 0.5 * reach), min(all_high, high + 0.5 * reach)
    axes = Axes((float(t[0]), float(t[-1])), limits, left=40.0, top=6.0, width=WIDTH - 48, height=HEIGHT - 28)
    parts = [_scale(axes)]
    parts += [line(axes, t, values, css) for css, values in runs]
    parts.append(line(axes, t, y, "measured"))
    name = comparison.test.outputs[output]
    label = f"Measured and simulated {one_line(name.name)}, {one_line(name.unit)}"
    where = segment_names(comparison.test)[found.trial.segment]
    return picture(WIDTH, HEIGHT, parts, label, "telling"), one_line(where)


def _scale(axes: Axes) -> Markup:
    parts = []
    for value in ticks(*axes.y, count=3):
        y = float(axes.py(value))
        parts.append(segment(axes.left, y, axes.right, y, "grid"))
        parts.append(text(axes.left - 6, y + 3.5, tick_text(value), anchor="end"))
    low, high = axes.x
    for place, anchor in ((low, "start"), ((low + high) / 2, "middle"), (high, "end")):
        parts.append(text(float(axes.px(place)), axes.bottom + 15, clock(place), anchor=anchor))
    return Markup("").join(parts)
