"""Turbulence: intensities of MIL-F-8785C, spectra against theory, gusts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from flysid.errors import UsageError
from flysid.ingest.synth.dryden import Gust, Wind, gust_m_s, low_altitude, spectrum, turbulence, wind_field


def test_intensities_at_a_worked_height() -> None:
    """h = 100 ft, W20 = 10 m/s: by hand from the standard's formulas."""
    got = low_altitude(30.48, 10.0, 5.0)
    assert got.sigma[2] == pytest.approx(1.0)
    assert got.sigma[0] == pytest.approx(1.0 / 0.2593**0.4)
    assert got.tau_s[2] == pytest.approx(30.48 / 5.0)
    assert got.tau_s[0] == pytest.approx(30.48 / 0.2593**1.2 / 5.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_theoretical_spectrum_integrates_to_the_variance(axis: int) -> None:
    intensity = low_altitude(20.0, 6.0, 6.0)
    omega = np.concatenate([[0.0], np.geomspace(1e-4, 1e5, 200_001)])
    power = spectrum(intensity, axis, omega)
    total = np.sum((power[1:] + power[:-1]) / 2 * np.diff(omega))
    assert total == pytest.approx(intensity.sigma[axis] ** 2, rel=1e-3)


def test_spectra_of_long_records_are_the_theoretical_ones() -> None:
    from scipy.signal import welch

    intensity = low_altitude(20.0, 6.0, 6.0)
    dt_s = 0.1
    n = 80_000
    record = turbulence(intensity, n, dt_s, np.random.default_rng(11))
    for axis in range(3):
        hz, density = welch(record[:, axis], fs=1 / dt_s, nperseg=4096)
        omega = 2 * np.pi * hz
        # per octave from 0.05 to 5 rad/s, well below the Nyquist frequency of 31 rad/s
        edges = 0.05 * 2.0 ** np.arange(7.7)
        for low, high in itertools.pairwise(edges):
            band = (omega >= low) & (omega < high)
            ratio = np.mean(density[band]) / (2 * np.pi) / np.mean(spectrum(intensity, axis, omega[band]))
            assert ratio == pytest.approx(1.0, abs=0.25), (axis, low)
        assert np.std(record[:, axis]) == pytest.approx(intensity.sigma[axis], rel=0.06)


@pytest.mark.parametrize("dt_s", [0.01, 0.3, 3.0])
def test_the_record_is_stationary_from_its_first_sample_at_any_sample_time(dt_s: float) -> None:
    intensity = low_altitude(20.0, 6.0, 6.0)
    rng = np.random.default_rng(2)
    runs = np.array([turbulence(intensity, 6, dt_s, rng) for _ in range(3000)])
    for k in (0, 5):
        np.testing.assert_allclose(runs[:, k].std(axis=0), intensity.sigma, rtol=0.05)


def test_turbulence_is_seeded() -> None:
    intensity = low_altitude(20.0, 6.0, 6.0)
    first, again = (turbulence(intensity, 50, 0.02, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_a_gust_rises_to_its_peak_and_dies_away() -> None:
    t = 0.01 * np.arange(1000, dtype=np.float64)
    gust = gust_m_s([Gust(2.0, 1.5, (3.0, 0.0, -1.0))], t)
    assert gust[350, 0] == pytest.approx(3.0)
    assert gust[350, 2] == pytest.approx(-1.0)
    assert not gust[t < 2.0].any()
    assert not gust[t > 5.0].any()
    assert np.abs(np.diff(gust[:, 0])).max() < 0.05


def test_steady_wind_blows_where_it_is_told() -> None:
    rng = np.random.default_rng(1)
    air = wind_field(Wind(4.0, 90.0, turbulent=False), 10, 0.02, 20.0, rng)
    np.testing.assert_allclose(air, np.tile([0, 4.0, 0], (10, 1)), atol=1e-12)
    rough = wind_field(Wind(4.0, 90.0), 20_000, 0.5, 20.0, rng)
    np.testing.assert_allclose(rough.mean(axis=0), [0, 4.0, 0], atol=0.15)
    with pytest.raises(UsageError, match="wind of -1"):
        wind_field(Wind(-1.0), 10, 0.02, 20.0, rng)
