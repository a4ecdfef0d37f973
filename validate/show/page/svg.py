"""Inline SVG: axes, ticks, lines, bands. Colours come from CSS classes, so that light, dark and print differ.

Everything that is text passes `escape`; numbers pass `_n`; nothing else reaches the markup.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np
from markupsafe import Markup, escape

from flysid.dataset import FloatArray
from flysid.escaping import one_line

F = TypeVar("F", bound=Callable[..., Markup])
HALF = 470.0
THIRD = 310.0
"""Widths of pictures that stand two and three in a row."""
BASELINE = "arx"
CONTENDER = "ts"
"""CSS classes of the two models of the headline, whichever structures these are."""


class Mark(Markup):
    """Markup that keeps what it draws, so that others than a browser can (`flysid.validate.show.sheets`).

    `kind`: name of the function of this module that made it; "" of markup that no other renderer draws.
    `given`, `settings`: what the function was given.
    """

    kind = ""
    given: tuple[Any, ...] = ()
    settings: dict[str, Any]


def _kept(draw: F) -> F:
    """The function, whose markup is a `Mark`."""

    @wraps(draw)
    def drawing(*given: Any, **settings: Any) -> Mark:
        mark = Mark(draw(*given, **settings))
        mark.kind = draw.__name__
        mark.given = given
        mark.settings = settings
        return mark

    return cast("F", drawing)


@dataclass(frozen=True)
class Axes:
    """A rectangle of data coordinates inside a rectangle of pixels.

    `x`, `y`: (low, high) in data coordinates; y grows upwards.
    `left`, `top`, `width`, `height`: of the plot area, in pixels.
    `log_x`: the x axis is logarithmic.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    left: float = 44.0
    top: float = 22.0
    width: float = 340.0
    height: float = 120.0
    log_x: bool = False

    def px(self, x: FloatArray | float) -> FloatArray:
        """Places in pixels from the left of values of x."""
        low, high = self.x
        values = np.asarray(x, dtype=np.float64)
        if self.log_x:
            low = np.log10(low)
            high = np.log10(high)
            values = np.log10(np.maximum(values, 1e-300))
        return self.left + self.width * (values - low) / (high - low)

    def py(self, y: FloatArray | float) -> FloatArray:
        """Places in pixels from the top of values of y, held inside the axes."""
        low, high = self.y
        share = (np.asarray(y, dtype=np.float64) - low) / (high - low)
        return self.top + self.height * (1.0 - np.clip(share, 0.0, 1.0))

    @property
    def bottom(self) -> float:
        """In pixels from the top."""
        return self.top + self.height

    @property
    def right(self) -> float:
        """In pixels from the left."""
        return self.left + self.width


def span(*series: FloatArray, pad: float = 0.05, around: float | None = None) -> tuple[float, float]:
    """(low, high) of all finite values with a margin, never empty; holds `around` where given."""
    values = np.concatenate([np.ravel(s) for s in series]) if series else np.zeros(0)
    values = values[np.isfinite(values)]
    if around is not None:
        values = np.append(values, around)
    if not len(values):
        return -1.0, 1.0
    low = float(values.min())
    high = float(values.max())
    margin = pad * (high - low) or max(0.5 * abs(high), 0.5)
    return low - margin, high + margin


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About `count` round numbers (1, 2, 2.5 or 5 times a power of ten) between low and high."""
    raw = (high - low) / max(count, 1)
    if not np.isfinite(raw) or raw <= 0.0:
        return []
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= raw * 0.999), default=10.0)
    first = np.ceil(low / step - 1e-9)
    last = np.floor(high / step + 1e-9)
    return [float(i * step) for i in np.arange(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2, 5 times powers of ten, or powers alone over more than three decades."""
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    steps = (1.0, 2.0, 5.0) if np.log10(high / low) < 3.0 else (1.0,)
    found = [m * 10.0**d for d in decades for m in steps]
    return [t for t in found if low * 0.999 <= t <= high * 1.001]


def _n(value: float) -> str:
    text = f"{float(value):.1f}"
    return text[:-2] if text.endswith(".0") else text


def tick_text(value: float) -> str:
    """Six significant digits, true minus, no "-0"."""
    return f"{value + 0.0:.6g}".replace("-", "−")


@_kept
def text(x: float, y: float, content: str, *, css: str = "t", anchor: str = "start") -> Markup:
    """A line of text, escaped."""
    return Markup('<text x="{}" y="{}" class="{}" text-anchor="{}">{}</text>').format(
        _n(x), _n(y), css, anchor, one_line(content)
    )


@_kept
def frame(
    axes: Axes,
    title: str = "",
    x_label: str = "",
    *,
    x_ticks: bool = True,
    y_count: int = 4,
    whole: bool = False,
) -> Markup:
    """Grid, tick labels, the y title above the axis at left and the x title below it; `whole` counts in x."""
    parts: list[Markup] = []
    for value in ticks(*axes.y, count=y_count):
        y = float(axes.py(value))
        parts.append(segment(axes.left, y, axes.right, y, "grid"))
        parts.append(text(axes.left - 6, y + 3.5, tick_text(value), anchor="end"))
    at = log_ticks(*axes.x) if axes.log_x else _spaced_ticks(axes)
    for value in [v for v in at if v == round(v)] if whole else at:
        x = float(axes.px(value))
        parts.append(segment(x, axes.top, x, axes.bottom, "grid"))
        if x_ticks:
            parts.append(text(x, axes.bottom + 14, tick_text(value), anchor="middle"))
    if title:
        parts.append(text(axes.left, axes.top - 7, title))
    if x_label:
        parts.append(text(axes.left + axes.width / 2, axes.bottom + 29, x_label, anchor="middle"))
    return Markup("").join(parts)


def _spaced_ticks(axes: Axes) -> list[float]:
    """As many ticks of the x axis as their labels leave room for."""
    for count in range(max(2, int(axes.width / 50)), 1, -1):
        found = ticks(*axes.x, count=count)
        longest = max((len(tick_text(t)) for t in found), default=1)
        if len(found) * (6.5 * longest + 12) <= axes.width:
            return found
    return found[:1]


@_kept
def segment(x1: float, y1: float, x2: float, y2: float, css: str) -> Markup:
    """A straight line in pixels."""
    return Markup('<path d="M{} {}L{} {}" class="{}"/>').format(_n(x1), _n(y1), _n(x2), _n(y2), css)


@_kept
def line(axes: Axes, x: FloatArray, y: FloatArray, css: str) -> Markup:
    """A polyline in data coordinates, broken where a value is not finite or outside the axes."""
    margin = 0.02 * (axes.y[1] - axes.y[0])
    y = np.where((y >= axes.y[0] - margin) & (y <= axes.y[1] + margin), y, np.nan)
    return Markup('<path d="{}" class="{}"/>').format(_path(axes.px(x), axes.py(y)), css)


def _path(px: FloatArray, py: FloatArray) -> str:
    parts: list[str] = []
    pen = "M"
    for x, y in zip(px, py, strict=True):
        if not (np.isfinite(x) and np.isfinite(y)):
            pen = "M"
            continue
        parts.append(f"{pen}{_n(x)} {_n(y)}")
        pen = "L"
    return "".join(parts)


@_kept
def area(axes: Axes, x: FloatArray, low: FloatArray, high: FloatArray, css: str) -> Markup:
    """The area between two curves."""
    forth = _path(axes.px(x), axes.py(high))
    back = _path(axes.px(x[::-1]), axes.py(low[::-1]))
    return Markup('<path d="{}L{}Z" class="{}"/>').format(forth, back[1:], css)


@_kept
def box(x: tuple[float, float], y: tuple[float, float], css: str) -> Markup:
    """A rectangle in pixels; nothing where it has no area."""
    width = abs(x[1] - x[0])
    height = abs(y[1] - y[0])
    if width <= 0.0 or height <= 0.0:
        return Markup("")
    return Markup('<rect x="{}" y="{}" width="{}" height="{}" class="{}"/>').format(
        _n(min(x)), _n(min(y)), _n(width), _n(height), css
    )


@_kept
def whiskers(axes: Axes, x: FloatArray, low: FloatArray, high: FloatArray, css: str) -> Markup:
    """Vertical lines from low to high, drawn as one path."""
    ends = zip(axes.px(x), axes.py(low), axes.py(high), strict=True)
    d = "".join(f"M{_n(at)} {_n(bottom)}V{_n(top)}" for at, bottom, top in ends if abs(bottom - top) > 1.0)
    return Markup('<path d="{}" class="{}"/>').format(d, css)


@_kept
def dots(axes: Axes, x: FloatArray, y: FloatArray, css: str) -> Markup:
    """Small squares drawn as one path: hundreds of points in little markup."""
    keep = np.isfinite(x) & np.isfinite(y)
    d = "".join(f"M{_n(a)} {_n(b)}h0" for a, b in zip(axes.px(x[keep]), axes.py(y[keep]), strict=True))
    return Markup('<path d="{}" class="{}"/>').format(d, css)


@_kept
def picture(width: float, height: float, parts: Sequence[Markup], label: str, css: str = "") -> Markup:
    """An <svg> that a screen reader announces as one image with `label`."""
    return Markup('<svg viewBox="0 0 {} {}" role="img" aria-label="{}" class="{}">{}</svg>').format(
        _n(width), _n(height), one_line(label), css, Markup("").join(parts)
    )


@_kept
def owned(model: str, parts: Sequence[Markup], *, shown: bool) -> Markup:
    """What a picture has of one model; the page's buttons show and hide it."""
    return Markup('<g data-model="{}"{}>{}</g>').format(
        one_line(model), Markup("" if shown else " hidden"), Markup("").join(parts)
    )


@_kept
def legend(items: Sequence[tuple[str, str]], x: float, y: float) -> Markup:
    """Short lines with names, (css class, name), from x to the right."""
    parts: list[Markup] = []
    for css, name in items:
        parts.append(segment(x, y - 3.5, x + 16, y - 3.5, css))
        parts.append(text(x + 20, y, name))
        x += 32 + 6.2 * len(one_line(name))
    return Markup("").join(parts)


__all__ = [
    "BASELINE", "CONTENDER", "HALF", "THIRD", "Axes", "Mark", "area", "box", "dots", "escape", "frame",
    "legend", "line", "log_ticks", "owned", "picture", "segment", "span", "text", "tick_text", "ticks",
    "whiskers",
]  # fmt: skip
