"""Excitation signals: shapes, bands, peaks, seeds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.errors import UsageError
from flysid.ingest.synth import manoeuvres as ex

T = 0.02 * np.arange(3000)


def test_the_papers_signals() -> None:
    expected = sum(np.sin(w * T) for w in (0.1, 0.2, 0.3, 0.4))
    np.testing.assert_allclose(ex.paper_validation(T), expected, atol=1e-12)
    np.testing.assert_allclose(ex.paper_training(T), expected + np.sin(0.5 * T), atol=1e-12)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.floats(0.05, 0.5), st.floats(0.6, 5.0), st.floats(0.1, 20))
def test_a_random_phase_multisine_keeps_to_band_and_peak(
    seed: int, low: float, high: float, peak: float
) -> None:
    u = ex.random_phase_multisine(T, (low, high), peak, np.random.default_rng(seed))
    power = np.abs(np.fft.rfft(u)) ** 2
    hz = np.fft.rfftfreq(len(T), 0.02)
    inside = (hz >= low - 1e-9) & (hz <= high + 1e-9)
    assert power[~inside].sum() < 1e-18 * power.sum()
    assert power[inside].min() > 0.5 * power[inside].max()
    assert np.abs(u).max() == pytest.approx(peak)
    assert ex.crest_factor(u) < 2.1


def test_a_band_between_two_harmonics_is_refused() -> None:
    with pytest.raises(UsageError, match="no harmonic"):
        ex.random_phase_multisine(T[:100], (0.6, 0.9), 1.0, np.random.default_rng(0))


def test_pulses_last_as_long_as_they_say() -> None:
    u = ex.three_two_one_one(T, 1.0, 0.5, 2.0)
    edges = np.flatnonzero(np.diff(u)) + 1
    np.testing.assert_array_equal(edges, [50, 125, 175, 200, 225])
    assert [u[i] for i in (50, 125, 175, 200, 225)] == [2.0, -2.0, 2.0, -2.0, 0.0]
    d = ex.doublet(T, 0.2, 0.3, 1.5)
    assert (np.sum(d == 1.5), np.sum(d == -1.5), np.sum(d != 0)) == (15, 15, 30)


def test_a_chirp_sweeps_from_one_edge_to_the_other() -> None:
    u = ex.chirp(T, (0.1, 4.0), 3.0)
    crossings = T[np.flatnonzero(np.diff(np.sign(u)))]
    halves = np.diff(crossings)
    assert 0.5 / halves[0] == pytest.approx(0.1, rel=0.4)
    assert 0.5 / halves[-1] == pytest.approx(4.0, rel=0.15)
    assert np.abs(u).max() <= 3.0


def test_two_level_and_many_level_sequences_hold() -> None:
    rng = np.random.default_rng(1)
    binary = ex.prbs(T, 0.4, 2.0, rng)
    assert set(np.unique(binary)) == {-2.0, 2.0}
    assert set((np.flatnonzero(np.diff(binary)) + 1) % 20) == {0}
    levels = ex.amplitude_steps(T, 0.4, 2.0, rng)
    assert len(np.unique(levels)) == 150
    assert np.abs(levels).max() <= 2.0


def test_the_amplitude_sweep_grows() -> None:
    u = ex.amplitude_sweep(T, 1.0, 4.0)
    peaks = [np.abs(part).max() for part in np.array_split(u, 6)]
    assert peaks == sorted(peaks)
    assert peaks[-1] == pytest.approx(4.0, rel=0.02)


def test_the_pilot_is_smooth_bounded_and_seeded() -> None:
    u = ex.pilot(T, 5.0, np.random.default_rng(4))
    np.testing.assert_array_equal(u, ex.pilot(T, 5.0, np.random.default_rng(4)))
    assert np.abs(u).max() <= 5.0
    assert np.abs(np.diff(u)).max() < 5.0 * 2 * 0.02 / 0.15
    assert np.std(u) > 0.5


def test_crest_factors_of_sine_and_square() -> None:
    assert ex.crest_factor(np.sin(2 * np.pi * T)) == pytest.approx(np.sqrt(2), rel=3e-3)
    assert ex.crest_factor(np.sign(np.sin(2 * np.pi * T) + 1e-9)) == pytest.approx(1.0)
