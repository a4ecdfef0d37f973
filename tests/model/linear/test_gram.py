"""Streaming least squares: the numbers of an ordinary solver, by either way, at any condition."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.lagged import lagged_gram
from flysid.model.gram import lagged_triangle, reduce_data, solve
from flysid.model.stream import Block, windows


def in_blocks(records: list[FloatArray], size: int) -> Iterator[Block]:
    for number, x in enumerate(records):
        for start in range(0, x.shape[1], size):
            yield number, x[:, start : start + size]


def pieces(phi: FloatArray, y: FloatArray, size: int = 37) -> Iterator[tuple[FloatArray, FloatArray]]:
    for start in range(0, len(y), size):
        yield phi[start : start + size], y[start : start + size]


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**31), rows=st.integers(1, 200), columns=st.integers(1, 6))
def test_any_subset_of_columns_solves_like_an_ordinary_solver(seed: int, rows: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal((rows, columns))
    y = rng.standard_normal((rows, 2))
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
@given(
    seed=st.integers(0, 2**31), depth=st.integers(0, 5), signals=st.integers(1, 3), size=st.integers(1, 50)
)
def test_the_gram_of_lags_is_the_plain_gram(seed: int, depth: int, signals: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    records = [rng.standard_normal((signals, int(n))) + 3.0 for n in rng.integers(1, 40, 3)]
    gram = lagged_gram(windows(in_blocks(records, size), depth), depth)
    rows = all_lags(records, depth)
    if len(rows):
        assert gram == pytest.approx(rows.T @ rows, rel=1e-9, abs=1e-9)


def all_lags(records: list[FloatArray], depth: int) -> FloatArray:
    rows = []
    for x in records:
        lags = [(a, p) for a in range(len(x)) for p in range(depth + 1)]
        rows += [np.append([x[a, k - p] for a, p in lags], 1.0) for k in range(depth, x.shape[1])]
    return np.array(rows)


@pytest.mark.parametrize(("spread", "method"), [(1.0, "gram"), (1e-9, "tsqr")])
def test_the_triangle_of_lags_is_that_of_the_plain_rows(spread: float, method: str) -> None:
    rng = np.random.default_rng(5)
    walks = [np.cumsum(spread * rng.standard_normal((2, n)), axis=1) for n in (90, 200, 3)]
    ramps = [x + np.arange(x.shape[1]) for x in walks] if method == "tsqr" else walks
    triangle = lagged_triangle(lambda: in_blocks(ramps, 17), 3, np.array([2.0, 4.0]))
    rows = all_lags(ramps, 3) / np.append(np.repeat([2.0, 4.0], 4), 1.0)
    assert triangle.method == method
    assert triangle.rows == len(rows)
    gram = rows.T @ rows
    assert np.abs(triangle.r.T @ triangle.r - gram).max() < 1e-9 * np.abs(gram).max()


def test_no_segment_long_enough_is_said() -> None:
    with pytest.raises(DataError, match="no segment is longer than the 5 samples"):
        lagged_triangle(lambda: [(0, np.ones((2, 5)))], 5, np.ones(2))
