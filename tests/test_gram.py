"""Streaming least squares: the numbers of an ordinary solver, by either way, at any condition."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import FloatArray
from flysid.model.gram import lagged_gram, reduce_data, solve


def window(x: FloatArray, start: int, stop: int) -> FloatArray:
    return x[:, start:stop]


def pieces(phi: FloatArray, y: FloatArray, size: int = 37) -> Iterator[tuple[FloatArray, FloatArray]]:
    for start in range(0, len(y), size):
        yield phi[start : start + size], y[start : start + size]


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**31), rows=st.integers(1, 200), columns=st.integers(1, 6))
def test_any_subset_of_columns_solves_like_an_ordinary_solver(seed: int, rows: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    phi, y = rng.standard_normal((rows, columns)), rng.standard_normal((rows, 2))
    triangle = reduce_data(lambda: pieces(phi, y))
    subset = sorted(rng.permutation(columns)[: rng.integers(1, columns + 1)].tolist())
    matrix = np.column_stack([phi[:, subset], np.ones(rows)])
    for target in (0, 1):
        fit = solve(triangle, [*subset, triangle.constant], target)
        best, *_ = np.linalg.lstsq(matrix, y[:, target], rcond=None)
        residual = y[:, target] - matrix @ best
        assert fit.rss == pytest.approx(float(residual @ residual), rel=1e-8, abs=1e-12)
        assert matrix @ fit.theta == pytest.approx(matrix @ best, abs=1e-6)


def test_well_conditioned_data_take_the_gram_and_badly_conditioned_data_do_not() -> None:
    rng = np.random.default_rng(1)
    phi = rng.standard_normal((500, 4))
    y = (phi @ [1.0, 2.0, 3.0, 4.0])[:, None] + 0.1 * rng.standard_normal((500, 1))
    assert reduce_data(lambda: pieces(phi, y)).method == "gram"
    close = phi.copy()
    close[:, 1] = close[:, 0] + 1e-7 * rng.standard_normal(500)
    triangle = reduce_data(lambda: pieces(close, close @ np.array([[1.0], [2.0], [3.0], [4.0]])))
    assert triangle.method == "tsqr"
    fit = solve(triangle, range(4), 0)
    assert fit.rank == 4
    assert fit.condition > 1e6
    assert fit.theta == pytest.approx([1.0, 2.0, 3.0, 4.0], abs=1e-7)


def test_collinear_columns_are_noticed_and_predictions_stay_right() -> None:
    rng = np.random.default_rng(2)
    phi = rng.standard_normal((300, 3))
    phi[:, 2] = 2 * phi[:, 0]
    y = (phi @ [1.0, -1.0, 0.5])[:, None]
    fit = solve(reduce_data(lambda: pieces(phi, y)), range(3), 0, tolerance=1e-12)
    assert fit.rank == 2
    assert phi @ fit.theta == pytest.approx(y[:, 0], abs=1e-10)


def test_the_covariance_is_that_of_the_textbook() -> None:
    rng = np.random.default_rng(3)
    phi = rng.standard_normal((400, 3))
    y = (phi @ [1.0, 2.0, 3.0])[:, None] + 0.5 * rng.standard_normal((400, 1))
    fit = solve(reduce_data(lambda: pieces(phi, y)), range(3), 0)
    expected = np.linalg.inv(phi.T @ phi) * fit.rss / (400 - 3)
    assert fit.covariance == pytest.approx(expected, rel=1e-9)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**31), depth=st.integers(0, 5), signals=st.integers(1, 3))
def test_the_gram_of_lags_is_the_plain_gram(seed: int, depth: int, signals: int) -> None:
    rng = np.random.default_rng(seed)
    records = [rng.standard_normal((signals, int(n))) + 3.0 for n in rng.integers(1, 40, 3)]
    gram = lagged_gram([partial(window, x) for x in records], [x.shape[1] for x in records], depth)
    rows = []
    for x in records:
        lags = [(a, p) for a in range(signals) for p in range(depth + 1)]
        rows += [np.append([x[a, k - p] for a, p in lags], 1.0) for k in range(depth, x.shape[1])]
    if rows:
        assert gram == pytest.approx(np.array(rows).T @ np.array(rows), rel=1e-9, abs=1e-9)
