"""Rules in words: labels a pilot understands, equations that read well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flysid.errors import StoreError
from flysid.model.base import write_document
from flysid.model.fuzzy.memberships import Partition
from flysid.model.fuzzy.words import condition_in_words, equation, labels, number


def test_speeds_are_told_by_size_and_direction() -> None:
    said = labels(np.array([-2.0, -0.6, 0.02, 0.7, 2.1]), "v_x(k-1)", "m/s", 4.1)
    assert said == ["fast backward", "slow backward", "hovering", "slow forward", "fast forward"]
    assert labels(np.array([-1.0, 1.0]), "v_z(k-1)", "m/s", 2.2) == ["fast down", "fast up"]


def test_other_quantities_are_low_middle_high() -> None:
    assert labels(np.array([3.0, 1.0, 2.0]), "theta(k)", "deg", 2.0) == ["high", "low", "middle"]
    assert labels(np.array([1.0, 1.001]), "u", "", 2.0) == ["", ""]
    assert len(set(labels(np.arange(9.0), "u", "", 9.0))) == 9


def test_only_one_speed_is_hovering() -> None:
    said = labels(np.array([-0.1, 0.05, 1.0]), "v_x(k-1)", "m/s", 4.0)
    assert said == ["slow backward", "hovering", "slow forward"]
    assert labels(np.array([0.1, 0.3]), "v_x(k-1)", "m/s", 4.0) == ["hovering", "slow forward"]


def test_changes_rise_and_fall() -> None:
    said = labels(np.array([-0.2, 0.0, 0.05, 0.3]), "v_x(k-1)-v_x(k-2)", "m/s", 0.6)
    assert said == ["falling slowly", "steady", "rising slowly", "rising quickly"]


def test_sets_at_one_place_are_told_by_their_widths() -> None:
    centre = np.array([[0.5], [0.501], [0.499]])
    width = np.array([[0.2], [2.0], [0.25]])
    p = Partition(centre, width, width, np.array([-1.0]), np.array([1.0]))
    said = [condition_in_words(p, r, ["y(k-1)"], ["m"]) for r in range(3)]
    assert "'near 0.5 m'" in said[0]
    assert "'away from 0.5 m'" in said[1]


@given(
    values=st.lists(st.floats(-1, 1), min_size=2, max_size=9),
    name=st.sampled_from(["v_x(k-1)", "u(k)", "v_y(k-1)-v_y(k-2)"]),
    unit=st.sampled_from(["m/s", "", "deg"]),
)
def test_different_places_have_different_words(values: list[float], name: str, unit: str) -> None:
    said = labels(np.array(values), name, unit, 2.0)
    for value, word in zip(values, said, strict=True):
        for other, other_word in zip(values, said, strict=True):
            if abs(value - other) > 0.08:
                assert word != other_word
                assert word


def test_equations_read_well() -> None:
    text = equation("y(k)", np.array([1.95828, -0.95898, 0.0]), ["y(k-1)", "y(k-2)", "u(k)"], -0.01)
    assert text == "y(k) = 1.95828 y(k-1) - 0.95898 y(k-2) - 0.01"
    assert equation("y(k)", np.array([0.0]), ["u(k)"], 0.0) == "y(k) = 0"
    assert number(0.0) == "0"
    assert number(1234567.0) == "1.23e+06"


def test_conditions_name_variable_label_place_and_unit() -> None:
    one = np.array([[0.3], [0.3]])
    p = Partition(np.array([[-1.0], [1.0]]), one, one, np.array([-2.0]), np.array([2.0]))
    said = condition_in_words(p, 1, ["v_x(k-1)"], ["m/s"])
    assert said == "v_x(k-1) is A2 'slow forward' (about 1 +- 0.3 m/s)"
    alone = Partition(p.centre[:1], one[:1], one[:1], p.low, p.high)
    assert condition_in_words(alone, 0, ["v_x(k-1)"], ["m/s"]) == "always"


def test_a_variable_that_covers_everything_is_left_out() -> None:
    width = np.array([[0.3, 50.0], [0.3, 50.0]])
    centre = np.array([[-1.0, 0.0], [1.0, 0.0]])
    p = Partition(centre, width, width, np.array([-2.0, -1.0]), np.array([2.0, 1.0]))
    assert "u(k)" not in condition_in_words(p, 0, ["y(k-1)", "u(k)"], ["", ""])


def test_write_says_where_it_failed(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="nowhere"):
        write_document({}, tmp_path / "nowhere" / "m.json")
    write_document({"a": 1.5}, tmp_path / "m.json")
    assert [p.name for p in tmp_path.iterdir()] == ["m.json"]
