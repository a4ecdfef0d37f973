"""Residual tests on errors whose nature is known."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.validate.diagnose.residuals import autocorrelation, cross_correlation, spectrum
from tests.validate.compare.test_intervals import ar1


def test_white_errors_pass_and_red_ones_fail() -> None:
    rng = np.random.default_rng(0)
    white = autocorrelation([rng.normal(size=3000) for _ in range(3)], 40)
    assert white.tested == 40
    assert not white.fails
    red = autocorrelation([ar1(3000, 0.6, rng)], 40)
    assert red.fails
    assert red.rho[0] == pytest.approx(0.6, abs=0.05)


def test_autocorrelation_agrees_with_the_definition() -> None:
    rng = np.random.default_rng(1)
    a = rng.normal(size=50)
    b = rng.normal(size=31)
    mean = np.concatenate([a, b]).mean()
    a0 = a - mean
    b0 = b - mean
    expected = [(a0[k:] @ a0[:-k] + b0[k:] @ b0[:-k]) / (a0 @ a0 + b0 @ b0) for k in range(1, 6)]
    np.testing.assert_allclose(autocorrelation([a, b], 5).rho, expected, rtol=1e-10)


def test_a_missing_delayed_input_shows_at_its_lag() -> None:
    rng = np.random.default_rng(2)
    u = rng.normal(size=4000)
    e = 0.5 * np.concatenate([np.zeros(7), u[:-7]]) + rng.normal(size=4000)
    c = cross_correlation([e], [u], 20)
    assert c.fails
    assert c.peak[0] == 7


def test_bartletts_band_keeps_two_slow_independent_signals_apart() -> None:
    """With the white-noise band, slow signals that have nothing to do with each other look dependent."""
    rng = np.random.default_rng(3)
    wrong = right = 0
    for _ in range(40):
        e = ar1(3000, 0.97, rng)
        u = ar1(3000, 0.97, rng)
        c = cross_correlation([e], [u], 10)
        right += c.outside > 0
        wrong += bool((np.abs(c.rho) > 2.58 / np.sqrt(3000)).any())
    assert wrong > 25
    assert right < 8


def test_spectrum_of_a_first_order_system() -> None:
    rng = np.random.default_rng(5)
    n = 20000
    a = 0.9
    dt = 0.05
    u = rng.normal(size=n)
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = a * y[k - 1] + 0.1 * u[k - 1]
    s = spectrum([u], [y + 0.01 * rng.normal(size=n)], dt)
    assert s is not None
    z = np.exp(2j * np.pi * s.hz * dt)
    truth = 0.1 / (z - a)
    low = s.hz < 2.0
    np.testing.assert_allclose(np.abs(s.response[low]), np.abs(truth[low]), rtol=0.25)
    assert float(np.median(s.coherence[low])) > 0.9
    assert spectrum([np.zeros(500)], [np.zeros(500)], dt) is None
    assert spectrum([u[:10]], [y[:10]], dt) is None


def test_the_error_of_a_gain_is_as_large_as_it_scatters() -> None:
    """Over some 2,000 frequencies: windows that overlap are no more averages than they are."""
    rng = np.random.default_rng(8)
    u = rng.standard_normal(200_000)
    s = spectrum([u], [2.0 * u + 4.0 * rng.standard_normal(len(u))], 0.01)
    assert s is not None
    scatter = np.abs(s.response) / 2.0 - 1.0
    claimed = np.sqrt(np.mean(s.relative_error**2))
    assert 0.92 < scatter.std() / claimed < 1.08
