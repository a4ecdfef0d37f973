"""Correlations and spectra of errors, sample by sample and window by window."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import csd, lfilter
from scipy.stats import norm

from flysid.dataset import FloatArray
from flysid.validate.diagnose.residuals import (
    Correlation,
    ResidualSpectrum,
    autocorrelation,
    cross_correlation,
    spectrum,
)

Z = norm.ppf(0.995)


def pooled(a: list[FloatArray], b: list[FloatArray], lag: int) -> float:
    """sum a(k) b(k - lag) over segments, over the norms."""
    total = 0.0
    for x, z in zip(a, b, strict=True):
        total += sum(x[k] * z[k - lag] for k in range(len(x)) if 0 <= k - lag < len(x))
    return float(total / np.sqrt(sum(x @ x for x in a) * sum(z @ z for z in b)))


def test_correlations_pool_segments_and_never_pair_samples_across() -> None:
    rng = np.random.default_rng(5)
    e = [5.0 + lfilter([1.0], [1.0, -0.8], rng.normal(size=n)) for n in (40, 5, 1)]
    u = [lfilter([1.0], [1.0, -0.6], rng.normal(size=n)) for n in (40, 5, 1)]
    lags = 7
    own = autocorrelation(e, lags)
    e = [x - np.mean(np.concatenate(e)) for x in e]
    assert own.lags.tolist() == list(range(1, 8))
    assert own.rho == pytest.approx([pooled(e, e, k) for k in range(1, 8)])
    assert own.band == pytest.approx(Z / np.sqrt(46))
    assert own.tested == 7
    found = cross_correlation(e, u, lags)
    u = [x - np.mean(np.concatenate(u)) for x in u]
    assert found.lags.tolist() == list(range(-7, 8))
    assert found.rho == pytest.approx([pooled(e, u, k) for k in range(-7, 8)])
    assert found.tested == 8  # the input leads, or is of the same sample
    both = 1.0 + 2.0 * sum((1.0 - k / 40.0) * pooled(e, e, k) * pooled(u, u, k) for k in range(1, 40))
    assert found.band == pytest.approx(Z * np.sqrt(max(both, 1.0) / 46))


def correlation(rho: list[float], band: float = 0.1) -> Correlation:
    count = len(rho)
    return Correlation(
        np.arange(-1.0, count - 1.0), np.array(rho), band, (np.arange(count) > 0).astype(float)
    )


def test_a_test_fails_beyond_what_chance_explains() -> None:
    """Of 10 lags two outside, or one beyond 3.29 / 2.576 of the band; of 200 two and 3 x 1.41 make 6."""
    assert not correlation([0.9] + [0.0] * 9 + [0.11]).fails  # what is not causal does not count
    assert correlation([0.0] * 9 + [0.11, -0.11]).fails
    together = norm.isf(0.0005) / Z
    assert not correlation([0.0] * 10 + [-0.0999 * together]).fails
    assert correlation([0.0] * 10 + [-0.1001 * together]).fails
    assert not correlation([0.0] * 195 + [0.11] * 6).fails
    assert correlation([0.0] * 194 + [0.11] * 7).fails
    found = correlation([0.9, 0.0, 0.2, -0.3, 0.1])
    assert found.peak == (2, -0.3)
    assert (found.tested, found.outside) == (4, 2)
    assert not found.blind
    assert correlation([0.1, 0.1], band=0.51).blind
    assert not correlation([0.1, 0.1], band=0.5).blind
    assert correlation([0.0, 0.0]).blind


def test_a_spectrum_is_welch_s() -> None:
    """1,000 samples: windows of 64, half over each other, the lines of zero and of Nyquist left out."""
    rng = np.random.default_rng(6)
    u = rng.normal(size=1000)
    y = 50.0 * lfilter([0.0, 0.3], [1.0, -0.7], u) + rng.normal(size=1000)
    found = spectrum([u], [y], 0.02)
    assert found is not None
    window = np.hanning(64)
    kinds = {"fs": 50.0, "window": window, "noverlap": 32, "nperseg": 64, "detrend": "constant"}
    hz, uy = csd(u, y, **kinds)
    uu, yy = (csd(x, x, **kinds)[1].real for x in (u, y))
    assert found.hz == pytest.approx(hz[1:-1])
    assert found.response == pytest.approx((uy / uu)[1:-1], rel=1e-6)
    coherence = (np.abs(uy) ** 2 / (uu * yy))[1:-1]
    assert found.coherence == pytest.approx(coherence, rel=1e-6)
    assert found.averages == pytest.approx(30 / (1.0 + 2.0 / 36.0))
    assert found.relative_error == pytest.approx(
        np.sqrt((1.0 - coherence) / (2.0 * coherence * found.averages)), rel=1e-6
    )


def test_windows_lie_within_segments_and_three_are_needed() -> None:
    rng = np.random.default_rng(7)
    u = [rng.normal(size=n) for n in (40, 36, 20, 64)]  # 160 in all: windows of 16
    found = spectrum(u, u, 0.02)
    assert found is not None
    assert found.averages == pytest.approx((4 + 3 + 1 + 7) / (1.0 + 2.0 / 36.0))
    assert len(found.hz) == 7
    assert np.abs(found.response - 1.0).max() < 1e-9
    assert spectrum([u[0][:16]] * 7, [u[0][:16]] * 7, 0.02) is None  # 112 samples: windows of 8
    assert spectrum([rng.normal(size=32)], [rng.normal(size=32)], 0.02) is None


def test_the_input_explains_as_far_as_three_neighbours_say() -> None:
    hz = np.arange(1.0, 8.0)
    none = np.zeros(7, dtype=np.complex128)
    found = ResidualSpectrum(hz, none, np.array([0.0, 0.6, 0.6, 0.6, 0.1, 0.95, 0.1]))
    assert found.largest == pytest.approx(0.6)
    assert found.explained_to_hz == 5.0  # (0.6 + 0.1 + 0.95) / 3 there
    assert ResidualSpectrum(hz, none, np.full(7, 0.49)).explained_to_hz is None
