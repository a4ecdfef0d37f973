"""What a card tells of a channel: the ten seconds in which the two models of the verdict differ most, and how
the output answers a small step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from flysid.dataset import FloatArray
from flysid.escaping import one_line
from flysid.model.base import Fitted, OperatingPoint
from flysid.model.capabilities import HasOperatingPoints
from flysid.model.rules.operating_words import after
from flysid.showing import clock
from flysid.validate.compare.comparison import Comparison, begin_s, segment_names
from flysid.validate.compare.trials import StructureTrial
from flysid.validate.diagnose.responses import answers
from flysid.validate.show.page.overlay import drawn
from flysid.validate.show.page.svg import Axes, line, picture, segment, span, text, tick_text, ticks

SECONDS = 10.0
WIDTH = 340.0
HEIGHT = 132.0


@dataclass(frozen=True, eq=False)
class ToldMoment:
    """Rows `first` to `last` of a trial."""

    trial: StructureTrial
    first: int
    last: int


def most_telling(comparison: Comparison, trials: Sequence[StructureTrial], output: int) -> ToldMoment:
    """The ten seconds over which the free runs of the models drawn lie farthest apart, in the mean square.

    Of one model, or two of the same free run: where its error is largest.
    """
    rows = max(2, round(SECONDS / comparison.dt_s))
    names = [name for name, _ in different(comparison, trials, output)]
    best = -1.0
    found = ToldMoment(trials[0], 0, min(rows, len(trials[0].y)))
    for trial in trials:
        runs = [trial.yh[name][:, output] for name in names]
        apart = np.nan_to_num((runs[0] - (runs[1] if len(runs) > 1 else trial.y[:, output])) ** 2)
        sums = np.concatenate([[0.0], np.cumsum(apart)])
        length = min(rows, len(apart))
        means = (sums[length:] - sums[:-length]) / length
        at = int(np.argmax(means))
        if means[at] > best:
            best = float(means[at])
            found = ToldMoment(trial, at, at + length)
    return found


def different(comparison: Comparison, trials: Sequence[StructureTrial], output: int) -> list[tuple[str, str]]:
    """(model, CSS class) of the models drawn; the first alone where both have one free run."""
    both = drawn(comparison)
    first = both[0][0]
    last = both[-1][0]
    if all(np.allclose(t.yh[first][:, output], t.yh[last][:, output], atol=0.0) for t in trials):
        return both[:1]
    return both


def telling(comparison: Comparison, trials: Sequence[StructureTrial], output: int) -> tuple[Markup, str]:
    """The picture, and the flight and time that it shows."""
    found = most_telling(comparison, trials, output)
    rows = slice(found.first, found.last)
    y = found.trial.y[rows, output]
    runs = [(css, found.trial.yh[name][rows, output]) for name, css in different(comparison, trials, output)]
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


def answer(comparison: Comparison, place: tuple[int, int]) -> str:
    """What a small lasting step of an input does, by the model to be used; "" where no final change is known.

    `place` is (output, input). Rules that answer differently give a range.
    """
    output, signal = place
    pair = comparison.verdict.get(comparison.test.outputs[output].name)
    name = comparison.contender if pair is not None and pair.earned else comparison.baseline
    model = comparison.fitted[name or comparison.baseline]
    found = list(_answers(model, output))
    gains = np.array([p.gain[signal] for p in found])
    seconds = np.array([p.reached_s[signal] for p in found])
    if not found or not np.isfinite([gains, seconds]).all() or abs(np.sign(gains).sum()) < len(gains):
        return ""
    y = comparison.test.outputs[output]
    u = comparison.test.inputs[signal]
    more = f"one more {u.unit} of {u.name}" if u.unit else f"one unit more of {u.name}"
    size = f"{_range(np.abs(gains))} {y.unit}".strip()
    effect = f"adds {size} to {y.name}" if gains[0] > 0 else f"takes {size} from {y.name}"
    time = after(seconds.tolist(), found, f"{_range(seconds)} s")
    return one_line(f"{more[0].upper()}{more[1:]} {effect}; 63 % of that {time}.")


def _answers(model: Fitted, output: int) -> Iterator[OperatingPoint]:
    """Wherever the model's behaviour is known."""
    known = model.operating_points if isinstance(model, HasOperatingPoints) else ()
    return (p for p in known or answers(model) if p.output == output)


def _range(values: FloatArray) -> str:
    low, high = (f"{v:.2g}" for v in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


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
