"""Pictures of a review as inline SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from flysid.dataset import FloatArray
from flysid.reviews.fact import HeatMap, MotorPlan, Picture, PictureLine, TopView
from flysid.validate.show.page.decimate import extremes
from flysid.validate.show.page.svg import Axes, box, frame, legend, line, picture, segment, span, text

WIDTH = 470.0
HEIGHT = 210.0
FROM_ABOVE = 240.0
"""Width and height of motors from above."""
LEVELS = 8
"""Shades of a heat map: an eye separates no more."""
CELLS = 72
"""Of a heat map along an axis: more are narrower than an eye tells apart, and weigh on the page."""


def draw_picture(drawn: Picture) -> Markup:
    """Lines on two axes, with marks, and a veil over what the log cannot show."""
    lines = [_thinned(one) for one in drawn.lines]
    xs = [one.x for one in lines]
    ys = [one.y for one in lines]
    x_range = _limits(xs)
    if drawn.hidden_from is not None:
        x_range = (x_range[0], max(x_range[1], 1.05 * drawn.hidden_from))
    y_range = span(*ys) if ys else (0.0, 1.0)
    axes = Axes(x_range, y_range, left=52.0, top=24.0, width=WIDTH - 66.0, height=HEIGHT - 74.0)
    parts = [frame(axes, drawn.y_label, drawn.x_label)]
    if drawn.hidden_from is not None:
        start = float(axes.px(drawn.hidden_from))
        parts += [
            box((start, axes.right), (axes.top, axes.bottom), "outside"),
            text(axes.right, axes.bottom - 6, "not logged", anchor="end"),
        ]
    parts += [line(axes, one.x, y, f"line {one.style}") for one, y in zip(lines, ys, strict=True)]
    for row, (x, words) in enumerate(sorted(drawn.marks.items())):
        at = float(axes.px(x))
        is_right = at > axes.left + axes.width / 2.0
        place = (at - 3, "end") if is_right else (at + 3, "start")
        parts.append(segment(at, axes.top, at, axes.bottom, "mark"))
        parts.append(text(place[0], axes.top + 12 * (1 + row % 3), words, anchor=place[1]))
    if len(drawn.lines) > 1:
        parts.append(legend([(f"line {one.style}", one.name) for one in drawn.lines], axes.left, HEIGHT - 4))
    return picture(WIDTH, HEIGHT, parts, f"{drawn.title}: {drawn.y_label} over {drawn.x_label}")


def draw_heat_map(drawn: HeatMap) -> Markup:
    """A quantity over two axes in shades, the darkest is the highest."""
    axes = Axes(
        (float(drawn.x[0]), float(drawn.x[-1])),
        (float(drawn.y[0]), float(drawn.y[-1])),
        left=52.0,
        top=24.0,
        width=WIDTH - 66.0,
        height=HEIGHT - 64.0,
    )
    x, values = _coarse(drawn.x, drawn.values.T)
    y, values = _coarse(drawn.y, values.T)
    shades = _shades(values)
    x_edges = axes.px(_edges(x))
    y_edges = axes.py(_edges(y))
    parts = []
    for row in range(shades.shape[0]):
        for first, end, shade in _runs(shades[row]):
            if shade > 0:
                rows = (float(y_edges[row]), float(y_edges[row + 1]))
                parts.append(box((float(x_edges[first]), float(x_edges[end])), rows, f"heat h{shade}"))
    parts.append(frame(axes, drawn.y_label, drawn.x_label))
    return picture(WIDTH, HEIGHT, parts, f"{drawn.title}: {drawn.y_label} over {drawn.x_label}")


def draw_motors(drawn: MotorPlan) -> Markup:
    """Motors from above, front up, each with its share of the range in percent."""
    mean = float(np.mean(drawn.shares)) if drawn.shares else 0.0
    spots = _spots(drawn.places)
    parts = _arms(spots)
    for (x, y), share, name in zip(spots, drawn.shares, drawn.names, strict=True):
        heavy = share > 1.1 * mean
        parts.append(_disc(x, y, 20.0 + 14.0 * share, "motor heavy" if heavy else "motor"))
        parts += [
            text(x, y + 5, f"{100.0 * share:.0f} %", css="t big", anchor="middle"),
            text(x, y + 19, name, anchor="middle"),
        ]
    return picture(
        FROM_ABOVE, FROM_ABOVE, parts, f"{drawn.title}: motors from above, mean share of their range"
    )


def draw_top_view(drawn: TopView) -> Markup:
    """Motors from above, front up, an arrow the way each rotor turns; dashed where a place is not known."""
    radius = 19.0
    spots = _spots(drawn.places)
    parts = _arms(spots)
    described = []
    rows = zip(spots, drawn.names, drawn.spins, drawn.is_known, strict=True)
    for (x, y), name, spin, known in rows:
        parts.append(_disc(x, y, radius, "motor" if known else "motor unsure"))
        parts.append(text(x, y + 5, name, css="t big", anchor="middle"))
        if spin:
            parts.append(_spin(x, y, radius + 6.0, spin))
        way = {1: ", turns clockwise", -1: ", turns counter-clockwise"}.get(spin, "")
        described.append(f"motor {name}{way}{'' if known else ', place not determined'}")
    return picture(FROM_ABOVE, FROM_ABOVE, parts, f"{drawn.title}, from above: {'; '.join(described)}")


def _spots(places: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Pixels of places forward and right of the middle."""
    middle = FROM_ABOVE / 2.0
    reach = 78.0
    return [(middle + reach * right, middle - reach * forward) for forward, right in places]


def _arms(spots: Sequence[tuple[float, float]]) -> list[Markup]:
    """Which way is forward, and an arm to each motor."""
    middle = FROM_ABOVE / 2.0
    front = text(middle, 14, "front", anchor="middle")
    return [front, *(segment(middle, middle, x, y, "arm") for x, y in spots)]


def _spin(x: float, y: float, radius: float, way: int) -> Markup:
    """An arrow around a motor, open towards the bottom; `way` is 1 for clockwise."""
    end = np.radians(90.0 - 40.0 * way)
    tip_x = x + radius * np.cos(end)
    tip_y = y + radius * np.sin(end)
    sweep = 1 if way > 0 else 0
    arc = f"M{2.0 * x - tip_x:.1f} {tip_y:.1f}A{radius:g} {radius:g} 0 1 {sweep} {tip_x:.1f} {tip_y:.1f}"
    for turn in (-2.6, 2.6):
        side = end + way * np.pi / 2.0 + turn
        arc += f"M{tip_x:.1f} {tip_y:.1f}l{7.0 * np.cos(side):.1f} {7.0 * np.sin(side):.1f}"
    return Markup('<path d="{}" class="spin"/>').format(arc)


def _disc(x: float, y: float, radius: float, css: str) -> Markup:
    return Markup('<circle cx="{:.1f}" cy="{:.1f}" r="{:.1f}" class="{}"/>').format(x, y, radius, css)


def _thinned(drawn: PictureLine) -> PictureLine:
    """No more points than the picture is wide: the lowest and the highest of as many samples as it takes."""
    size = -(-len(drawn.x) // round(WIDTH))
    kept = extremes(drawn.y, size) if size > 1 else slice(None)
    return replace(drawn, x=drawn.x[kept], y=drawn.y[kept])


def _limits(xs: Sequence[FloatArray]) -> tuple[float, float]:
    """From the lowest finite value to the highest, without a margin."""
    every = np.concatenate([x[np.isfinite(x)] for x in xs]) if xs else np.zeros(0)
    if not len(every) or every.min() == every.max():
        return (0.0, 1.0)
    return float(every.min()), float(every.max())


def _coarse(centres: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """At most `CELLS` rows (rows, columns) and their centres: neighbours are one, as high as the highest."""
    size = -(-len(centres) // CELLS)
    if size == 1:
        return centres, values
    starts = np.arange(0, len(centres), size)
    middles = centres[np.minimum(starts + size // 2, len(centres) - 1)]
    return middles, np.fmax.reduceat(values, starts, axis=0)


def _shades(values: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.int_]]:
    """(rows, columns) 0 to `LEVELS`, from the median of what is finite to the highest."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.zeros(values.shape, dtype=int)
    low, high = float(np.median(known)), float(known.max())
    share = (np.nan_to_num(values, nan=low) - low) / max(high - low, np.finfo(float).tiny)
    return np.clip(np.ceil(LEVELS * share), 0, LEVELS).astype(int)


def _runs(row: np.ndarray[tuple[int, ...], np.dtype[np.int_]]) -> list[tuple[int, int, int]]:
    """(first, end, value) of equal neighbours."""
    edges = [0, *(np.flatnonzero(np.diff(row)) + 1).tolist(), len(row)]
    return [(a, b, int(row[a])) for a, b in pairwise(edges)]


def _edges(centres: FloatArray) -> FloatArray:
    """(N + 1,) edges of cells around (N,) centres, held inside the first and the last."""
    middles = (centres[:-1] + centres[1:]) / 2.0
    return np.concatenate([centres[:1], middles, centres[-1:]])
