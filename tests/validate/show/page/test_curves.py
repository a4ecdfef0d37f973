"""Curves of a page in pixels, by hand."""

from __future__ import annotations

import re

import numpy as np

from flysid.validate.show.page.svg import Axes, line

AXES = Axes((0.0, 10.0), (0.0, 1.0), left=0.0, top=0.0, width=100.0, height=50.0)


def path(x: list[float], y: list[float]) -> str:
    (found,) = re.findall(' d="([^"]*)"', line(AXES, np.array(x), np.array(y), "c"))
    return " ".join(re.findall("[ML][^ML]*", found))


def test_a_curve_breaks_where_a_value_is_missing_or_beyond_the_axes() -> None:
    """Within a fiftieth of the axis beyond it a value is drawn at the edge."""
    assert path([0.0, 1.0, 2.0], [0.0, 0.5, 1.0]) == "M0 50 L10 25 L20 0"
    assert path([0.0, 1.0, 2.0, 3.0], [0.0, np.nan, 1.0, 0.5]) == "M0 50 M20 0 L30 25"
    assert path([0.0, np.inf, 2.0], [0.0, 0.5, 1.0]) == "M0 50 M20 0"
    assert path([0.0, 1.0, 2.0, 3.0], [1.019, 1.021, -0.019, -0.021]) == "M0 0 M20 50"
