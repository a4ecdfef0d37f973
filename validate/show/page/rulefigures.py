"""Pictures of rules: membership functions, degree of fulfilment, outputs of individual rules.

A model takes part in as many of them as it offers methods: `firing` belongs to the protocol; `antecedents`,
`memberships(variable, x)` and `rule_outputs(u, y)` are optional.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.escaping import one_line
from flysid.model.base import Fitted
from flysid.model.capabilities import HasMemberships, HasTrainedRange
from flysid.model.start import as_modelled
from flysid.validate.show.page.decimate import decimate
from flysid.validate.show.page.svg import HALF, THIRD, Axes, area, frame, line, picture, span, text

SHOWN_FROM = 0.25
"""Normalised weight from which on a rule's own output is drawn."""
_LAG = re.compile(r"\(k(?:-(\d+))?\)")


def _trained_range(model: object, variable: int) -> tuple[float, float] | None:
    if not isinstance(model, HasTrainedRange):
        return None
    low, high = (float(v) for v in model.trained_range[:, variable])
    return (low, high) if low < high else None


def antecedent_range(name: str, data: Dataset) -> tuple[float, float] | None:
    """(low, high) of an antecedent variable along `data`; None where its name is not understood."""
    signals = [*data.outputs, *data.inputs]
    terms = _terms(name, signals)
    if not terms:
        return None
    low = np.inf
    high = -np.inf
    for segment in data.segments:
        columns = np.hstack([segment.y, segment.u])
        deepest = max(lag for _, lag, _ in terms)
        if len(segment) <= deepest:
            continue
        total = sum(sign * columns[deepest - lag : len(columns) - lag, i] for i, lag, sign in terms)
        low = min(low, float(np.min(total)))
        high = max(high, float(np.max(total)))
    return (low, high) if low < high else None


def _terms(name: str, signals: Sequence[Signal]) -> list[tuple[int, int, float]]:
    """(column, lag, sign) of every "w(k-2)" in `name`; empty where a part of it is something else.

    A signal's own name may begin with a sign: between terms the first sign is the operator, at the start it
    is one only where no signal is called so.
    """
    names = [_plain(s.name) for s in signals]
    found: list[tuple[int, int, float]] = []
    rest = _plain(name)
    while rest:
        term = None if found else _term(rest, names)
        sign = -1.0 if term is None and rest[0] == "-" else 1.0
        if term is None and rest[0] in "+-":
            term = _term(rest[1:], names)
        if term is None:
            return []
        column, lag, rest = term
        found.append((column, lag, sign))
    return found


def _term(text: str, names: Sequence[str]) -> tuple[int, int, str] | None:
    """(column, lag, what follows) of the "w(k-2)" that a text begins with, by the longest name that fits."""
    for column in sorted(range(len(names)), key=lambda i: -len(names[i])):
        lag = _LAG.match(text, len(names[column])) if text.startswith(names[column]) else None
        if lag:
            return column, int(lag[1] or 0), text[lag.end() :]
    return None


def _plain(name: str) -> str:
    return name.replace(" ", "").replace("−", "-")


def membership_figures(model: HasMemberships, data: Dataset, unit_of: dict[str, str]) -> list[Markup]:
    """One picture per antecedent variable over the range seen in `data`."""
    figures = []
    for i, name in enumerate(model.antecedents):
        limits = antecedent_range(name, data) or _trained_range(model, i)
        if limits is None:
            continue
        x = np.linspace(*limits, 120)
        grades = np.asarray(model.memberships(i, x))
        axes = Axes(limits, (0.0, 1.08), left=30, top=18, width=THIRD - 42, height=86)
        unit = unit_of.get(name.split("(")[0], "")
        parts = [frame(axes, "", f"{one_line(name)}{', ' + one_line(unit) if unit else ''}", y_count=2)]
        parts += [line(axes, x, grades[:, r], f"rule r{r % 8 + 1}") for r in range(grades.shape[1])]
        peaks = [float(axes.px(x[int(np.argmax(grades[:, r]))])) for r in range(grades.shape[1])]
        for r, at in enumerate(_spread(peaks, 17.0, axes.right)):
            parts.append(text(at, axes.top - 5, f"A{r + 1}", css=f"t r{r % 8 + 1}t", anchor="middle"))
        figures.append(picture(THIRD, 142, parts, f"Membership functions over {name}"))
    return figures


def _spread(places: Sequence[float], least: float, end: float) -> list[float]:
    """The same places, moved apart where labels would overlap, kept left of `end` where there is room."""
    order = np.argsort(places, kind="stable")
    moved = [0.0] * len(places)
    free = -np.inf
    for k, i in enumerate(order):
        room = end - least * (len(order) - 1 - k)
        moved[i] = max(free, min(places[i], room))
        free = moved[i] + least
    return moved


def fulfilment(firing: FloatArray, t: FloatArray, label: str) -> Markup:
    """Normalised firing strengths (N, R) stacked over time."""
    rules = firing.shape[1]
    names = [f"r{i}" for i in range(rules)]
    times, parts_of = _thin(t, dict(zip(names, firing.T, strict=True)), 240)
    stack = np.cumsum(np.column_stack([np.zeros(len(times)), *(parts_of[n] for n in names)]), axis=1)
    stack = stack / np.maximum(stack[:, -1:], 1e-12)
    axes = Axes((float(t[0]), float(t[-1])), (0.0, 1.0), top=8, width=HALF - 60, height=110)
    parts = [area(axes, times, stack[:, i], stack[:, i + 1], f"stack r{i % 8 + 1}") for i in range(rules)]
    parts.append(frame(axes, "", "time in segment, s", y_count=2))
    return picture(HALF, 154, parts, label)


def _thin(
    t: FloatArray, series: dict[str, FloatArray], points: int
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Every n-th sample: stacked shares must be taken at the same instant, extremes would not add up to 1."""
    step = max(1, len(t) // points)
    return t[::step], {name: values[::step] for name, values in series.items()}


def rule_output_figure(
    outputs: FloatArray, firing: FloatArray, y: FloatArray, t: FloatArray, words: tuple[str, str]
) -> Markup:
    """What every rule (N, R) says one step ahead, where it fires enough; measured y in grey."""
    shown = np.where(firing >= SHOWN_FROM, outputs, np.nan)
    step = max(1, len(t) // 240)
    times, measured = decimate(t, {"y": y}, 300)
    low, high = span(y)
    inside = shown[np.isfinite(shown) & (shown > low - (high - low)) & (shown < high + (high - low))]
    axes = Axes((float(t[0]), float(t[-1])), span(y, inside), top=22, width=HALF - 60, height=120)
    parts = [frame(axes, words[0], "time in segment, s"), line(axes, times, measured["y"], "measured faint")]
    parts += [line(axes, t[::step], shown[::step, r], f"rule r{r % 8 + 1}") for r in range(shown.shape[1])]
    return picture(HALF, 184, parts, words[1])


def strongest_runs(firing: FloatArray, t: FloatArray, shortest: float) -> list[tuple[float, float, int]]:
    """(from, to, rule) while one rule is the strongest; runs below `shortest` seconds join the one before."""
    winner = np.argmax(firing, axis=1)
    borders = np.flatnonzero(np.diff(winner)) + 1
    starts = np.concatenate([[0], borders])
    ends = np.concatenate([borders, [len(winner)]])
    last = float(t[-1])
    runs: list[tuple[float, float, int]] = []
    for start, end in zip(starts, ends, strict=True):
        begin = float(t[start])
        finish = float(t[end]) if end < len(t) else last
        rule = int(winner[start])
        if runs and (finish - begin < shortest or runs[-1][2] == rule):
            runs[-1] = (runs[-1][0], finish, runs[-1][2])
        else:
            runs.append((begin, finish, rule))
    return runs


def firing_along(model: Fitted, segment: Segment) -> FloatArray | None:
    """(N, R) firing strengths, or None for a model of one rule."""
    strengths = np.asarray(model.firing(segment.u, as_modelled(model, segment).y))
    return strengths if strengths.ndim == 2 and strengths.shape[1] > 1 else None
