"""Measured against simulated over every held-out segment: data for the script, and a still picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from flysid.dataset import FloatArray
from flysid.escaping import one_line
from flysid.extras import Extra, extra
from flysid.model.start import drifting_of
from flysid.showing import number
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.trials import FREE_RUN, StructureTrial
from flysid.validate.diagnose.bands import free_run_band
from flysid.validate.show.page.channel_data import Source
from flysid.validate.show.page.decimate import decimate, round_for_json
from flysid.validate.show.page.rulefigures import firing_along, strongest_runs
from flysid.validate.show.page.svg import BASELINE, CONTENDER, Axes, area, box, frame, line, picture, span

WIDE = 960.0
MOST_SEGMENTS = 60
WORST_DRAWN = 20
MOST_BANDED = 24
THIN = 4
"""Bands are smooth: every fourth sample drawn will do."""


@dataclass(frozen=True, eq=False)
class Strip:
    """One held-out segment, ready to draw; series are decimated.

    `trial`: place among the scored segments.
    `index`: segment in the test dataset.
    `t`: (P,) seconds from the segment's start.
    `y`, `u`: (P,) measured output, and the input drawn below.
    `models`: (name, CSS class, (P,) free run) of each model drawn.
    `runs`: (from, to, rule) of the strongest rule of the contender.
    `bands`: (CSS class, lower, upper), (P / THIN,) each, of the free runs that have one.
    `others`: (P,) each of `extras`: free runs of models, and predictions; NaN where there is none.
    """

    trial: int
    index: int
    t: FloatArray
    y: FloatArray
    u: FloatArray
    models: tuple[tuple[str, str, FloatArray], ...]
    errors: tuple[FloatArray, ...]
    runs: tuple[tuple[float, float, int], ...]
    bands: tuple[tuple[str, FloatArray, FloatArray], ...] = ()
    others: tuple[FloatArray, ...] = ()


def strips(source: Source, output: int, signal: int) -> list[Strip]:
    """A Strip for every trial that `worth_drawing` names, the first 24 of them with bands."""
    chosen = worth_drawing(source.comparison, source.diagnosis.free_runs, output)
    return [_strip(source, i, (output, signal), n < MOST_BANDED) for n, i in enumerate(chosen)]


def worth_drawing(comparison: Comparison, trials: Sequence[StructureTrial], output: int) -> list[int]:
    """Places of at most 60 trials: the 20 of the largest error of a model drawn, the others evenly spread."""
    if len(trials) <= MOST_SEGMENTS:
        return list(range(len(trials)))
    names = [name for name, _ in drawn(comparison)]
    worst = [max(float(np.mean((t.y - t.yh[n])[:, output] ** 2)) for n in names) for t in trials]
    chosen = set(np.argsort(worst)[-WORST_DRAWN:].tolist())
    others = [i for i in range(len(trials)) if i not in chosen]
    spread = np.linspace(0, len(others) - 1, MOST_SEGMENTS - WORST_DRAWN).round().astype(int)
    return sorted(chosen | {others[i] for i in spread})


def _strip(source: Source, at: int, place: tuple[int, int], banded: bool) -> Strip:
    """`at` is the place of the trial, `place` is (output, input)."""
    trial = source.diagnosis.free_runs[at]
    comparison = source.comparison
    (output, signal) = place
    segment = comparison.test.segments[trial.segment]
    t = comparison.dt_s * np.arange(trial.first, len(segment), dtype=np.float64)
    names = drawn(comparison)
    series = {"y": trial.y[:, output], "u": segment.u[trial.first :, signal]}
    for name, _ in names:
        series[f"m {name}"] = trial.yh[name][:, output]
        series[f"e {name}"] = trial.y[:, output] - trial.yh[name][:, output]
    others = _others(source, trial, output)
    series |= {f"o {i}": values for i, values in enumerate(others)}
    times, few = decimate(t, series, source.points)
    runs: list[tuple[float, float, int]] = []
    if comparison.contender:
        strength = firing_along(comparison.fitted[comparison.contender], segment)
        if strength is not None:
            runs = strongest_runs(strength[trial.first :], t, float(t[-1] - t[0]) / 150)
    return Strip(
        at,
        trial.segment,
        times,
        few["y"],
        few["u"],
        tuple((name, css, few[f"m {name}"]) for name, css in names),
        tuple(few[f"e {name}"] for name, _ in names),
        tuple(runs),
        tuple(_bands(source, trial, output, times) if banded else ()),
        tuple(few[f"o {i}"] for i in range(len(others))),
    )


def _others(source: Source, trial: StructureTrial, output: int) -> list[FloatArray]:
    """(M,) of each of `extras` along a trial."""
    runs = [trial.yh[name][:, output] for name in list_pickable(source.comparison)]
    k = steps_ahead(source)
    if k is None:
        return runs
    ahead = {t.segment: t for t in source.diagnosis.steps.get(k, ())}.get(trial.segment)
    for name, _ in drawn(source.comparison):
        values = np.full(len(trial.y), np.nan)
        if ahead is not None:
            own = ahead.yh[name][:, output]
            own = own[max(0, len(own) - len(values)) :]
            values[len(values) - len(own) :] = own
        runs.append(values)
    return runs


def _bands(
    source: Source, trial: StructureTrial, output: int, times: FloatArray
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Of every model drawn that offers one and did not diverge, at every fourth of `times`.

    Models of one free run, as a contender that took the baseline's parameters, share the first one's.
    """
    banded: list[FloatArray] = []
    segment = source.comparison.test.segments[trial.segment]
    rows = np.rint(times[::THIN] / source.comparison.dt_s).astype(np.int64) - trial.first
    for name, css in drawn(source.comparison):
        run = trial.yh[name][:, output]
        if name in trial.diverged_s or any(np.allclose(run, other, atol=0.0) for other in banded):
            continue
        model = source.comparison.fitted[name]
        drifting = drifting_of(source.comparison.fitted.values())
        make = partial(free_run_band, model, segment, trial.first, source.sure(name), drifting)
        band = extra(Extra.BANDS, make, None, f"{name} on {source.channel}")
        if band is not None:
            banded.append(run)
            yield css, band[0][rows, output], band[1][rows, output]


def drawn(comparison: Comparison) -> list[tuple[str, str]]:
    """(model, CSS class) of the models drawn: the baseline and the contender."""
    found = [(comparison.baseline, BASELINE)]
    if comparison.contender:
        found.append((comparison.contender, CONTENDER))
    return found


def list_pickable(comparison: Comparison) -> list[str]:
    """The models that a reader may add to the pictures: all that are not drawn, references last."""
    shown = {name for name, _ in drawn(comparison)}
    others = [name for name in comparison.fitted if name not in shown]
    return sorted(others, key=lambda name: comparison.models[name].reference)


@dataclass(frozen=True)
class Role:
    """One model of the page's pictures: its name, its CSS class, and whether it is shown from the start."""

    model: str
    css: str
    shown: bool


def roles(comparison: Comparison) -> list[Role]:
    """Every model but the references, those of the headline first."""
    first = [Role(name, css, shown=True) for name, css in drawn(comparison)]
    more = [
        Role(name, f"other {other_colour(i)}", shown=False)
        for i, name in enumerate(list_pickable(comparison))
    ]
    return [*first, *(role for role in more if not comparison.models[role.model].reference)]


def other_colour(i: int) -> str:
    """Of the i-th model picked: from the end of the palette whose beginning belongs to the rules."""
    return f"r{8 - i % 8}"


def steps_ahead(source: Source) -> str | None:
    """The farthest horizon of the comparison in steps, which the models of the headline are drawn at, too."""
    counts = [int(h) for h in source.comparison.horizons if h != FREE_RUN]
    return str(max(counts)) if counts else None


def extras(source: Source) -> list[str]:
    """What a reader may add to the interactive plot: other models, and those drawn, some steps ahead."""
    k = steps_ahead(source)
    names = [name.upper() for name, _ in drawn(source.comparison)] if k else []
    words = f"{k} step{'s' if k != '1' else ''} ahead"
    return [
        *(one_line(m).upper() for m in list_pickable(source.comparison)),
        *(f"{one_line(n)} {words}" for n in names),
    ]


def buttons(comparison: Comparison, pieces: Sequence[Strip], output: int) -> tuple[tuple[str, str], ...]:
    """(label, "0.31 → 0.32") of each drawn segment."""
    c = comparison
    labels = [one_line(c.segments[p.index]) for p in pieces]
    if FREE_RUN not in c.horizons:
        return tuple((label, "") for label in labels)
    entry = c.entry(c.test.outputs[output].name, FREE_RUN)
    per_model = [entry.models[m].segments for m, _ in drawn(c)]
    return tuple(
        (label, " → ".join(number(segments[p.trial].scores.rmse) for segments in per_model))
        for p, label in zip(pieces, labels, strict=True)
    )


def left_out(every: int, shown: int) -> str:
    """Which segments are drawn, where that is not all of them."""
    if shown == every:
        return ""
    return (
        f"{shown} of {every} segments are drawn: the {WORST_DRAWN} of the largest error, and others "
        "evenly spread. Every number is of all of them."
    )


def vertical(strip: Strip) -> tuple[float, float]:
    """Range of the output axis: the measured one, and the models' as far as three times that."""
    low, high = span(strip.y)
    reach = high - low
    all_low, all_high = span(strip.y, *[values for _, _, values in strip.models])
    return max(all_low, low - reach), min(all_high, high + reach)


def error_range(strip: Strip) -> tuple[float, float]:
    """Range of the error axis, no wider than the measured output's."""
    low, high = span(*strip.errors, around=0.0)
    y_low, y_high = span(strip.y)
    reach = y_high - y_low
    return max(low, -reach), min(high, reach)


def still(strip: Strip, titles: tuple[str, str, str], label: str) -> Markup:
    """Three panels on one time axis: output, error, input."""
    x = (float(strip.t[0]), float(strip.t[-1]))
    width = WIDE - 60
    top = Axes(x, vertical(strip), width=width, height=210)
    middle = Axes(x, error_range(strip), top=288, width=width, height=76)
    low = Axes(x, span(strip.u), top=396, width=width, height=56)
    parts = [
        frame(top, titles[0], x_ticks=False),
        frame(middle, titles[1], x_ticks=False, y_count=3),
        frame(low, titles[2], "time, s", y_count=2),
        line(low, strip.t, strip.u, "input"),
    ]
    for css, lower, upper in strip.bands:
        low_edge = np.clip(lower, *top.y)
        high_edge = np.clip(upper, *top.y)
        parts.append(area(top, strip.t[::THIN], low_edge, high_edge, f"sure {css}"))
    for (_, css, values), error in zip(strip.models, strip.errors, strict=True):
        parts += [line(top, strip.t, values, css), line(middle, strip.t, error, css)]
    parts.append(line(top, strip.t, strip.y, "measured"))
    for begin, end, rule in strip.runs:
        ends = (float(top.px(begin)), float(top.px(end)))
        parts.append(box(ends, (top.bottom + 8, top.bottom + 18), f"stack r{rule % 8 + 1}"))
    return picture(WIDE, 492, parts, label, "still")


def as_json(strip: Strip, label: str) -> dict[str, Any]:
    """What the script draws; numbers rounded to what a screen can show."""
    return {
        "label": one_line(label),
        "t": round_for_json(strip.t),
        "y": round_for_json(strip.y),
        "u": round_for_json(strip.u),
        "models": [round_for_json(values) for _, _, values in strip.models],
        "errors": [round_for_json(error) for error in strip.errors],
        "others": [
            round_for_json(values if np.ptp(values) else values[:1]) for values in strip.others
        ],  # one: equal
        "range": list(vertical(strip)),
        "error_range": list(error_range(strip)),
        "input_range": list(span(strip.u, pad=0.1)),
        "bands": [[css, round_for_json(lower), round_for_json(upper)] for css, lower, upper in strip.bands],
        "runs": [[round(a, 3), round(b, 3), r] for a, b, r in strip.runs],
    }
