"""Lagged regressors: every entry is the sample its lag says; segments are never joined."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import Dataset, Signal
from flysid.errors import DataError, UsageError
from flysid.model.regressors import LagTerms, chunks, regressors

lag_lists = st.lists(st.integers(1, 6), max_size=4).map(tuple)
input_lags = st.lists(st.integers(0, 6), max_size=4).map(tuple)


@settings(deadline=None, max_examples=50)
@given(y=st.lists(lag_lists, min_size=1, max_size=2), u=st.lists(input_lags, min_size=1, max_size=2))
def test_every_entry_is_the_sample_its_lag_says(y: list[tuple[int, ...]], u: list[tuple[int, ...]]) -> None:
    lags = LagTerms(tuple(y), tuple(u))
    n = 20
    us = np.arange(n * len(u), dtype=float).reshape(n, len(u))
    ys = 1000 + np.arange(n * len(y), dtype=float).reshape(n, len(y))
    phi = regressors(us, ys, lags)
    assert phi.shape == (n - lags.depth, lags.count)
    for row in range(len(phi)):
        k = row + lags.depth
        expected = [ys[k - i, j] for j, own in enumerate(y) for i in own]
        expected += [us[k - i, j] for j, own in enumerate(u) for i in own]
        assert phi[row].tolist() == expected


def test_pieces_are_the_whole_and_segments_are_not_joined() -> None:
    rng = np.random.default_rng(0)
    u = [rng.standard_normal((n, 2)) for n in (50, 3, 71)]
    y = [rng.standard_normal((n, 1)) for n in (50, 3, 71)]
    data = Dataset.from_arrays(u, y, 0.1)
    lags = LagTerms.arx((3,), (2, 1), (1, 4))
    usable = [data.segments[0], data.segments[2]]
    phi = np.concatenate([regressors(s.u, s.y, lags, 4) for s in usable])
    target = np.concatenate([s.y[4:] for s in usable])
    pieces = list(chunks(data, lags, rows=16))
    assert max(len(p) for p, _ in pieces) == 16
    assert np.array_equal(np.concatenate([p for p, _ in pieces]), phi)
    assert np.array_equal(np.concatenate([t for _, t in pieces]), target)
    assert np.array_equal(target[:46], y[0][4:])


def test_names_are_as_people_write_them() -> None:
    lags = LagTerms.arx((2,), (1,), (0,))
    assert lags.names([Signal("v_x")], [Signal("theta")]) == ("v_x(k-1)", "v_x(k-2)", "theta(k)")


def test_lags_that_would_know_the_future() -> None:
    with pytest.raises(UsageError, match="an output's lag must"):
        LagTerms(y=((0,),), u=((1,),))
    with pytest.raises(UsageError, match="lag must"):
        LagTerms(y=((1,),), u=((-1,),))


def test_segments_shorter_than_the_depth() -> None:
    data = Dataset.from_arrays([np.ones(4), np.ones(3)], [np.ones(4), np.ones(3)], 1.0)
    with pytest.raises(DataError, match="longest has 4"):
        next(iter(chunks(data, LagTerms.arx((4,), (1,), (1,)), rows=16)))
