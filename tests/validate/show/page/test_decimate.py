"""What is drawn of a curve, by hand: which samples are kept, and which of them have whiskers."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.validate.show.page import Sweep
from flysid.validate.show.page.decimate import decimate, extremes, round_for_json
from flysid.validate.show.page.figures import sweep_figure


def test_a_bucket_becomes_its_extremes_in_their_order() -> None:
    """11 samples for 6 points: buckets of 4, 4 and 3."""
    y = np.array([5.0, 9.0, 1.0, 4.0, 0.0, 3.0, 8.0, 2.0, 7.0, 7.5, 6.0])
    times, found = decimate(np.arange(11.0), {"y": y, "-y": -y}, 6)
    assert times.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert found["y"].tolist() == [9.0, 1.0, 0.0, 8.0, 7.5, 6.0]
    assert found["-y"].tolist() == [-9.0, -1.0, 0.0, -8.0, -7.5, -6.0]


def test_a_last_bucket_of_one_sample_is_left_out() -> None:
    times, found = decimate(np.arange(9.0), {"y": np.arange(9.0)}, 6)  # buckets of 3
    assert times.tolist() == [0.0, 1.0, 3.0, 4.0, 6.0, 7.0]
    assert found["y"].tolist() == [0.0, 2.0, 3.0, 5.0, 6.0, 8.0]
    times, found = decimate(np.arange(7.0), {"y": np.arange(7.0)}, 6)  # and of 3, 3, 1
    assert times.tolist() == [0.0, 1.0, 3.0, 4.0]
    assert found["y"].tolist() == [0.0, 2.0, 3.0, 5.0]
    same, few = decimate(np.arange(6.0), {"y": np.arange(6.0)}, 6)
    assert (len(same), len(few["y"])) == (6, 6)


@pytest.mark.parametrize(
    ("values", "rounded"),
    [
        ([0.0, 1234.5678, np.inf], [0.0, 1234.6, None]),  # 617 about their mean: a digit behind the point
        ([1e6, 1e6 + 0.12345678], [1e6, 1000000.12346]),
        ([0.000123456, 0.000123456], [0.0001235, 0.0001235]),  # of their size where they are alike
        ([123456.7, 123456.7], [123457.0, 123457.0]),
        ([0.0, 0.0], [0.0, 0.0]),
        ([np.nan, np.inf], [None, None]),
    ],
    ids=str,
)
def test_values_have_four_digits_of_their_range(values: list[float], rounded: list[float | None]) -> None:
    assert round_for_json(np.array(values)) == rounded


def test_extremes_of_every_few_values_and_all_nans_are_kept() -> None:
    values = np.array([3.0, 1.0, 2.0, np.nan, 5.0, 4.0, np.nan, np.nan, np.nan, 7.0])
    assert extremes(values, 3).tolist() == [0, 1, 3, 4, 5, 6, 7, 8, 9]
    assert extremes(values, 2).tolist() == list(range(10))
    assert extremes(np.arange(10.0), 5).tolist() == [0, 4, 5, 9]


def test_a_count_of_rules_has_a_whisker_where_its_error_has_a_spread() -> None:
    drawn = sweep_figure(Sweep((1, 2, 3), (0.4, 0.3, 0.35), (0.1, 0.0, 0.2), 2), "m/s")
    assert drawn.count('class="whisker"') == 2
