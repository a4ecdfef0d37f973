"""The compiled loops of a linear search against SciPy and against roots."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter, welch, windows

from flysid.dataset import FloatArray
from flysid.filters import apply_filter, power_density, tukey
from flysid.model.compiled_filters import differences, free_responses, is_stable


def signal(seed: int, rows: int = 200) -> FloatArray:
    return np.random.default_rng(seed).normal(size=rows)


@pytest.mark.parametrize(
    ("b", "a"), [([1.0], [1.0, -0.9]), ([0.0, 0.2, 0.1], [1.0]), ([1.0, 0.3], [1.0, -1.2, 0.5])]
)
def test_filters_are_scipys(b: list[float], a: list[float]) -> None:
    x = signal(0)
    x.flags.writeable = False  # as a dataset's arrays are
    assert np.allclose(apply_filter(np.array(b), np.array(a), x), lfilter(b, a, x), rtol=1e-13, atol=1e-15)
    both = np.stack([x, 2.0 * x], axis=1)
    expected = lfilter(b, a, both, axis=0)
    assert np.allclose(apply_filter(np.array(b), np.array(a), both), expected, rtol=1e-13, atol=1e-15)


def test_differences_are_those_of_the_formula() -> None:
    x = signal(1, 30)
    found = differences(x, 3, 2, slice(4, 30), monic=False)
    for column, (power, lag) in enumerate([(2, 2), (1, 3), (0, 4)]):
        b = np.zeros(8)
        b[lag : lag + power + 1] = np.poly(np.ones(power)) if power else 1.0
        assert np.allclose(found[:, column], lfilter(b, [1.0], x)[4:])
    monic = differences(x, 2, 0, slice(0, 30), monic=True)
    assert np.allclose(monic[:, 1], np.concatenate([[0.0, 0.0], x[:-2]]))
    assert np.allclose(monic[:, 0], lfilter([0.0, 1.0, -1.0], [1.0], x))


@pytest.mark.parametrize("roots", [[0.5], [0.99, 0.9], [0.8 + 0.3j, 0.8 - 0.3j], [1.02, 0.3]])
def test_free_responses_span_what_decays_from_any_state(roots: list[complex]) -> None:
    a = np.real(np.poly(roots))
    columns = free_responses(a, 120)
    assert np.allclose(np.linalg.norm(columns, axis=0), 1.0)
    state = lfilter([1.0], a, np.zeros(len(columns)), zi=np.array([1.0, -0.4])[: len(a) - 1])[0]
    left = state - columns @ np.linalg.lstsq(columns, state, rcond=None)[0]
    assert np.abs(left).max() < 1e-9 * np.abs(state).max()


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-1.3, 1.3), min_size=1, max_size=6), st.floats(0.5, 1.2))
def test_reflection_coefficients_say_what_roots_say(roots: list[float], radius: float) -> None:
    largest = max(abs(r) for r in roots)
    if abs(largest - radius) > 0.05:
        assert is_stable(np.asarray(np.poly(roots), dtype=np.float64), radius) is (largest < radius)
    assert not is_stable(np.array([1.0, np.nan]))


@pytest.mark.parametrize("rows", [201, 1000])
def test_the_density_is_welchs(rows: int) -> None:
    piece = signal(8, rows)
    hz, density = power_density([piece], 0.02)
    expected_hz, expected = welch(piece, 50.0, nperseg=min(256, rows))
    inner = slice(1, len(hz) + 1)
    np.testing.assert_allclose(hz, expected_hz[inner])
    np.testing.assert_allclose(density, expected[inner], rtol=1e-12)


@pytest.mark.parametrize("count", [7, 200, 1001])
def test_the_taper_is_tukeys(count: int) -> None:
    np.testing.assert_allclose(tukey(count, 0.2), windows.tukey(count, 0.2), atol=1e-12)
