"""Pictures of the page, drawn by matplotlib: what `page.svg` draws for a browser, for paper.

A sheet has a method for every function of `page.svg` that draws; colours, widths and dashes are those of the
page's stylesheet where it is light.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from typing import Any

from markupsafe import Markup

from flysid.dataset import FloatArray
from flysid.escaping import picture_text
from flysid.validate.show.page.html import load_asset
from flysid.validate.show.page.svg import Axes, Mark, log_ticks, tick_text

POINTS = 72.0
POINTS_OF_PIXEL = 0.75
ANCHORS = {"start": "left", "middle": "center", "end": "right"}


@cache
def _stylesheet() -> tuple[tuple[frozenset[str], dict[str, str]], ...]:
    """The rules of lines and areas, in order: classes that they are for, and what they set."""
    text = load_asset("page.css")
    colours = dict(re.findall(r"(--[\w-]+):([^;}]+)", text[: text.index("}")]))
    rules = re.findall(r"(?:path|rect|text)?((?:\.[\w-]+)+)\{([^}]*)\}", text)
    resolved = (
        (names, re.sub(r"var\((--[\w-]+)\)", lambda found: colours[found[1]], own)) for names, own in rules
    )
    return tuple(
        (
            frozenset(names.split(".")[1:]),
            {key: value for key, _, value in (part.partition(":") for part in own.split(";"))},
        )
        for names, own in resolved
    )


def style_of(css: str) -> dict[str, str]:
    """What the stylesheet sets for a line or area of these classes.

    >>> style_of("measured")["stroke-width"]
    '1.3'
    """
    classes = set(css.split())
    found: dict[str, str] = {}
    for names, own in _stylesheet():
        if names <= classes:
            found |= own
    return found


def stroke_of(css: str, points: float = POINTS_OF_PIXEL) -> dict[str, Any]:
    """How matplotlib draws a line of these classes; `points` are what a pixel of the page becomes.

    >>> stroke_of("arx")["color"]
    '#c2570c'
    """
    style = style_of(css)
    dashes = [float(part) for part in style.get("stroke-dasharray", "none").split() if part != "none"]
    return {
        "color": style.get("stroke", "black"),
        "linewidth": float(style.get("stroke-width", 1.0)) * points,
        "linestyle": (0.0, tuple(dashes)) if dashes else "solid",
        "alpha": float(style.get("opacity", 1.0)),
    }


def fill_of(css: str) -> dict[str, Any]:
    """How matplotlib draws an area of these classes."""
    style = style_of(css)
    opacity = float(style.get("opacity", style.get("fill-opacity", 1.0)))
    return {"color": style.get("fill", style.get("stroke", "black")), "alpha": opacity, "linewidth": 0.0}


def height_of(picture: Markup) -> float:
    """Pixels of a picture; 0 of other markup."""
    return float(picture.given[1]) if isinstance(picture, Mark) else 0.0


class Sheet:
    """A matplotlib figure on which pictures lie, each where it is laid, in pixels of the page.

    `width`, `height`: of the sheet, in pixels.
    `width_in`: inches that the width becomes.
    """

    def __init__(self, width: float, height: float, width_in: float) -> None:
        from matplotlib.figure import Figure

        self.figure = Figure(figsize=(width_in, width_in * height / width))
        self._size = (width, height)
        self._points = POINTS * width_in / width
        self._corner = (0.0, 0.0)
        self._axes: dict[Axes, Any] = {}
        self._under = self._canvas(0)
        self._over = self._canvas(2)

    def _canvas(self, zorder: int) -> Any:
        """The whole sheet, in pixels."""
        width, height = self._size
        canvas = self.figure.add_axes((0.0, 0.0, 1.0, 1.0), zorder=zorder)
        canvas.set(xlim=(0.0, width), ylim=(height, 0.0))
        canvas.set_axis_off()
        return canvas

    def lay(self, picture: Markup, left: float, top: float) -> None:
        """Draw a picture with its upper left corner there; markup that keeps nothing is left out."""
        self._corner = (left, top)
        self._axes = {}
        self._draw([picture])

    def _draw(self, parts: Sequence[Markup]) -> None:
        for part in parts:
            if isinstance(part, Mark) and part.kind:
                getattr(self, part.kind)(*part.given, **part.settings)

    def _on(self, axes: Axes) -> Any:
        """The matplotlib axes of a rectangle of the picture, made at their first use."""
        if axes not in self._axes:
            width, height = self._size
            left = (self._corner[0] + axes.left) / width
            bottom = 1.0 - (self._corner[1] + axes.bottom) / height
            made = self.figure.add_axes((left, bottom, axes.width / width, axes.height / height), zorder=1)
            made.set(xlim=axes.x, ylim=axes.y, xscale="log" if axes.log_x else "linear")
            made.set_axis_off()
            made.patch.set_visible(False)
            self._axes[axes] = made
        return self._axes[axes]

    def picture(self, *given: Any) -> None:
        self._draw(given[2])

    def owned(self, _: str, parts: Sequence[Markup], *, shown: bool) -> None:
        if shown:
            self._draw(parts)

    def frame(self, axes: Axes, title: str = "", x_label: str = "", **how: Any) -> None:
        on = self._on(axes)
        on.set_axis_on()
        on.spines[:].set_visible(False)
        on.grid(color=style_of("grid")["stroke"], linewidth=self._points)
        on.set_axisbelow(True)
        on.tick_params(labelsize="small", length=0.0, labelbottom=how.get("x_ticks", True))
        on.tick_params(labelleft=how.get("y_count", 1) > 0)
        on.set_title(picture_text(title), loc="left", fontsize="small")
        on.set_xlabel(picture_text(x_label), fontsize="small", labelpad=1.0)
        if axes.log_x:
            at = log_ticks(*axes.x)
            on.set_xticks(at, [tick_text(value) for value in at])
            on.minorticks_off()

    def line(self, axes: Axes, x: FloatArray, y: FloatArray, css: str) -> None:
        self._on(axes).plot(x, y, **stroke_of(css, self._points))

    def area(self, axes: Axes, x: FloatArray, low: FloatArray, high: FloatArray, css: str) -> None:
        self._on(axes).fill_between(x, low, high, **fill_of(css))

    def whiskers(self, axes: Axes, x: FloatArray, low: FloatArray, high: FloatArray, css: str) -> None:
        self._on(axes).vlines(x, low, high, **stroke_of(css, self._points))

    def dots(self, axes: Axes, x: FloatArray, y: FloatArray, css: str) -> None:
        stroke = stroke_of(css, self._points)
        size = stroke["linewidth"]
        self._on(axes).plot(x, y, "o", color=stroke["color"], alpha=stroke["alpha"], markersize=size, mew=0.0)

    def segment(self, x1: float, y1: float, x2: float, y2: float, css: str) -> None:
        left, top = self._corner
        self._over.plot([left + x1, left + x2], [top + y1, top + y2], **stroke_of(css, self._points))

    def box(self, x: tuple[float, float], y: tuple[float, float], css: str) -> None:
        left, top = self._corner
        self._under.fill_between([left + x[0], left + x[1]], top + y[0], top + y[1], **fill_of(css))

    def text(self, x: float, y: float, content: str, *, css: str = "t", anchor: str = "start") -> None:
        left, top = self._corner
        self._over.text(
            left + x,
            top + y,
            picture_text(content),
            ha=ANCHORS[anchor],
            fontsize="small",
            color=style_of(css).get("fill", "black"),
        )

    def legend(self, items: Sequence[tuple[str, str]], x: float, y: float) -> None:
        for css, name in items:
            self.segment(x, y - 3.5, x + 16, y - 3.5, css)
            self.text(x + 20, y, name)
            x += 32 + 7.6 * len(name)
