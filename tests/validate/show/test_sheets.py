"""A picture of the page is drawn by matplotlib as well: what was given once is what both show."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.validate.show.page import svg
from flysid.validate.show.page.svg import (
    Axes,
    Mark,
    area,
    box,
    dots,
    frame,
    legend,
    line,
    owned,
    picture,
    segment,
    text,
    whiskers,
)
from flysid.validate.show.sheets import Sheet, style_of

pytest.importorskip("matplotlib", reason="pip install matplotlib")

X = np.array([1.0, 2.0, 4.0])
Y = np.array([0.5, 1.5, 1.0])
AXES = Axes((1.0, 4.0), (0.0, 2.0), log_x=True)


def test_lines_areas_and_labels_are_those_of_the_page() -> None:
    parts = [
        frame(AXES, "gain, dB", "frequency, Hz"),
        area(AXES, X, Y - 0.1, Y + 0.1, "sure ts"),
        owned("ts", [line(AXES, X, Y, "ts")], shown=True),
        owned("oe", [line(AXES, X, 2.0 * Y, "other r8")], shown=False),
        whiskers(AXES, X, Y - 0.2, Y + 0.2, "whisker thin"),
        dots(AXES, X, Y, "dot"),
        box((50.0, 60.0), (20.0, 30.0), "stack r1"),
        segment(44.0, 22.0, 384.0, 22.0, "axis"),
        text(50.0, 12.0, "a $name"),
        legend([("ts", "TS")], 44.0, 180.0),
    ]
    drawn = picture(400.0, 200.0, parts, "Gain")
    assert drawn.count("<path") > 5
    sheet = Sheet(400.0, 200.0, 4.0)
    sheet.lay(drawn, 0.0, 0.0)
    _, over, axes = sheet.figure.axes
    assert (axes.get_xlim(), axes.get_ylim(), axes.get_xscale()) == (AXES.x, AXES.y, "log")
    assert (axes.get_title(loc="left"), axes.get_xlabel()) == ("gain, dB", "frequency, Hz")
    shown, points = axes.lines
    assert np.array_equal(shown.get_xydata(), np.column_stack([X, Y]))
    assert shown.get_color() == style_of("ts")["stroke"]
    assert np.array_equal(points.get_ydata(), Y)
    assert len(axes.collections) == 2
    assert [found.get_text() for found in over.texts] == ["a \\$name", "TS"]


def test_every_function_that_draws_for_the_page_draws_on_a_sheet() -> None:
    kept = {name for name in svg.__all__ if hasattr(getattr(svg, name), "__wrapped__")}
    assert kept >= {"line", "area", "dots", "frame", "picture"}
    assert {name for name in kept if not hasattr(Sheet, name)} == set()


def test_markup_that_keeps_nothing_is_left_out() -> None:
    sheet = Sheet(100.0, 100.0, 1.0)
    sheet.lay(picture(100.0, 100.0, [Mark("<circle/>")], "A circle"), 0.0, 0.0)
    assert len(sheet.figure.axes) == 2
