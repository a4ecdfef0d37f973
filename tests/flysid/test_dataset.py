"""Dataset and Segment: the laws that every later stage relies on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import DataError, UsageError


def test_one_array_each_is_one_segment_with_columns() -> None:
    data = Dataset.from_arrays(np.arange(5.0), np.arange(5.0) * 2, 0.1)
    assert data.segments[0].u.shape == (5, 1)
    assert (data.inputs, data.outputs) == ((Signal("u"),), (Signal("y"),))
    assert len(data) == 5


def test_lists_of_arrays_are_segments() -> None:
    data = Dataset.from_arrays([np.zeros((4, 2)), np.ones((3, 2))], [np.zeros(4), np.ones(3)], 0.5)
    assert [len(s) for s in data.segments] == [4, 3]
    assert [s.name for s in data.inputs] == ["u1", "u2"]


def test_a_list_of_numbers_is_one_segment() -> None:
    assert len(Dataset.from_arrays([1.0, 2.0], [3.0, 4.0], 1.0).segments) == 1


def test_segments_cannot_be_changed_in_place() -> None:
    segment = Segment(np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="read-only"):
        segment.y[0] = 1.0


def test_making_a_segment_leaves_the_callers_array_writable_and_apart() -> None:
    y = np.zeros((3, 1))
    segment = Segment(np.zeros(3), y)
    y[0] = 7.0
    assert segment.y[0, 0] == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_and_located(bad: float) -> None:
    y = np.zeros(9)
    y[4] = bad
    with pytest.raises(DataError, match="sample 4"):
        Segment(np.zeros(9), y)


def test_lengths_must_agree() -> None:
    with pytest.raises(DataError, match="u has 3 samples and y has 4"):
        Segment(np.zeros(3), np.zeros(4))
    with pytest.raises(UsageError, match="2 segments and y has 1"):
        Dataset.from_arrays([np.zeros(3), np.zeros(3)], [np.zeros(3)], 1.0)


@pytest.mark.parametrize("dt_s", [0.0, -1.0, float("nan"), float("inf")])
def test_sample_time_is_positive(dt_s: float) -> None:
    with pytest.raises(DataError, match="sample time"):
        Dataset.from_arrays(np.zeros(3), np.zeros(3), dt_s)


@given(st.integers(0, 20), st.integers(0, 20))
def test_a_slice_knows_its_own_time(start: int, length: int) -> None:
    whole = Segment(np.arange(40.0), np.arange(40.0), t0_ns=5_000_000_000)
    part = whole.slice(start, start + length, 0.02)
    assert len(part) == length
    np.testing.assert_allclose(part.time_s(0.02), whole.time_s(0.02)[start : start + length], atol=1e-9)


def test_equal_content_equal_hash() -> None:
    a = Dataset.from_arrays(np.arange(5.0), np.arange(5.0), 0.1)
    b = Dataset.from_arrays(np.arange(5.0), np.arange(5.0), 0.1)
    c = Dataset.from_arrays(np.arange(5.0), np.arange(5.0) + 1e-12, 0.1)
    assert a.content_hash() == b.content_hash() != c.content_hash()
