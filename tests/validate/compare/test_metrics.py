"""Metrics against an independent implementation, and their laws."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import FloatArray
from flysid.validate.compare.metrics import pool, resolution_of, root_mean_square, scores


def exact(y: FloatArray, yh: FloatArray) -> dict[str, float]:
    """The definitions, term by term, in rational arithmetic; only the roots are rounded."""
    ys = [Fraction(float(v)) for v in y]
    hs = [Fraction(float(v)) for v in yh]
    n = len(ys)
    e = [a - b for a, b in zip(ys, hs, strict=True)]
    mean_y = sum(ys, Fraction(0)) / n
    mean_e = sum(e, Fraction(0)) / n
    sse = sum(v * v for v in e)
    sst = sum((v - mean_y) ** 2 for v in ys)
    return {
        "rmse": math.sqrt(sse / n),
        "mae": float(sum(abs(v) for v in e) / n),
        "worst": float(max(abs(v) for v in e)),
        "bias": float(mean_e),
        "fit_pct": 100.0 * (1.0 - math.sqrt(sse / sst)),
        "vaf_pct": 100.0 * (1.0 - float(sum((v - mean_e) ** 2 for v in e) / sst)),
        "r2": 1.0 - float(sse / sst),
    }


@pytest.mark.parametrize("seed", range(20))
def test_agrees_with_exact_arithmetic(seed: int) -> None:
    rng = np.random.default_rng(seed)
    y = rng.normal(3.0, 2.0, 400)
    yh = y + rng.normal(0.3, 10.0 ** rng.uniform(-3, 1), 400)
    ours = scores(y, yh)
    truth = exact(y, yh)
    for name, value in truth.items():
        assert getattr(ours, name) == pytest.approx(value, rel=1e-12, abs=1e-12), name


def test_agrees_with_scikit_learn() -> None:
    sklearn = pytest.importorskip("sklearn.metrics")
    rng = np.random.default_rng(1)
    y = rng.normal(size=1000)
    yh = rng.normal(size=1000)
    ours = scores(y, yh)
    assert ours.rmse == pytest.approx(math.sqrt(sklearn.mean_squared_error(y, yh)), rel=1e-12)
    assert ours.mae == pytest.approx(sklearn.mean_absolute_error(y, yh), rel=1e-12)
    assert ours.r2 == pytest.approx(sklearn.r2_score(y, yh), rel=1e-12)
    assert ours.worst == pytest.approx(sklearn.max_error(y, yh), rel=1e-12)
    assert ours.vaf_pct == pytest.approx(100 * sklearn.explained_variance_score(y, yh), rel=1e-12)


def test_pooled_is_over_all_samples_and_fit_uses_their_common_mean() -> None:
    a = np.array([0.0, 0.0, 0.0])
    b = np.array([10.0, 10.0])
    s = pool([a, b], [a + 1.0, b])
    assert s.n == 5
    assert s.rmse == pytest.approx(math.sqrt(3 / 5))
    assert s.fit_pct == pytest.approx(100 * (1 - math.sqrt(3) / np.linalg.norm([-4, -4, -4, 6, 6])))


def test_vaf_is_blind_to_a_bias_and_fit_is_not() -> None:
    y = np.sin(np.arange(100.0))
    s = scores(y, y - 5.0)
    assert s.vaf_pct == pytest.approx(100.0)
    assert s.bias == pytest.approx(5.0)
    assert s.fit_pct is not None
    assert s.fit_pct < 0


def test_constant_output_has_no_percentages() -> None:
    s = scores(np.full(10, 7.3), np.zeros(10))
    assert (s.fit_pct, s.vaf_pct, s.r2) == (None, None, None)
    assert s.rmse == pytest.approx(7.3)


@settings(deadline=None, max_examples=50)
@given(st.floats(1e-150, 1e150), st.integers(0, 1000))
def test_scaling_the_output_scales_errors_and_keeps_percentages(scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    y = rng.normal(size=50)
    yh = rng.normal(size=50)
    one = scores(y, yh)
    many = scores(scale * y, scale * yh)
    assert many.rmse == pytest.approx(scale * one.rmse, rel=1e-9)
    assert many.fit_pct == pytest.approx(one.fit_pct, rel=1e-9, abs=1e-9)
    assert many.vaf_pct == pytest.approx(one.vaf_pct, rel=1e-9, abs=1e-9)


def test_root_mean_square_of_huge_and_zero_values() -> None:
    assert root_mean_square(np.array([3e200, 4e200])) == pytest.approx(math.sqrt(12.5) * 1e200)
    assert root_mean_square(np.zeros(3)) == 0.0


def test_resolution_is_seen_from_the_steps_or_taken_from_the_source() -> None:
    rng = np.random.default_rng(0)
    smooth = np.cumsum(rng.normal(size=2000)) * 0.05
    span = float(np.ptp(smooth))
    assert resolution_of([smooth]) == pytest.approx(1e-4 * span)
    stepped = np.round(smooth / 0.1) * 0.1
    assert resolution_of([stepped]) == pytest.approx(0.1 / math.sqrt(12))
    assert resolution_of([smooth], declared=0.5) == pytest.approx(0.5 / math.sqrt(12))
    assert resolution_of([np.ones(5)]) == 0.0
