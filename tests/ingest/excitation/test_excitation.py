import numpy as np
import pytest

from flysid.dataset import Dataset, Signal
from flysid.ingest.excitation.excitation import excitation, spectrum

DT = 0.02


def data(u: np.ndarray, y: np.ndarray, unit: str = "deg", resolution: float = 0.0) -> Dataset:
    return Dataset.from_arrays(u, y, DT, inputs=[Signal("u", unit, resolution)])


def test_coherence_is_high_where_the_input_explains_the_output_and_low_elsewhere() -> None:
    from scipy.signal import butter, lfilter

    rng = np.random.default_rng(0)
    u = rng.normal(size=20_000)
    low = lfilter(*butter(4, 3.0, fs=1 / DT), u)
    noise = lfilter(*butter(4, 8.0, btype="high", fs=1 / DT), rng.normal(size=20_000))
    seen = spectrum(data(u, low + 0.5 * noise))
    assert seen.coherence[seen.frequency_hz < 2.0].min() > 0.95
    assert seen.coherence[seen.frequency_hz > 12.0].mean() < 0.2
    band = seen.band_hz()
    assert band is not None
    assert 2.5 < band[1] < 8.0
    assert seen.gain[seen.frequency_hz < 1.0].mean() == pytest.approx(1.0, abs=0.05)


def test_an_output_of_its_own_has_no_band() -> None:
    rng = np.random.default_rng(1)
    assert spectrum(data(rng.normal(size=20_000), rng.normal(size=20_000))).band_hz() is None


def test_a_single_window_proves_nothing() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=60)
    assert spectrum(data(x, x)).band_hz() is None


def test_excitation_tells_a_tone_from_noise() -> None:
    t = np.arange(5000) * DT
    tone = excitation(data(np.sin(2 * np.pi * 0.5 * t), t))
    noise = excitation(data(np.random.default_rng(2).normal(size=5000), t))
    assert tone.rms == pytest.approx(np.sqrt(0.5), rel=1e-2)
    assert tone.band_hz == pytest.approx(0.5, abs=0.05)
    assert noise.band_hz > 20.0


@pytest.mark.parametrize(
    ("rms", "resolution", "quiet"), [(1e-9, 0.0, True), (1.0, 0.0, False), (0.1, 1.0, True), (0.0, 0.0, True)]
)
def test_an_input_below_its_noise_or_resolution_is_quiet(rms: float, resolution: float, quiet: bool) -> None:
    u = rms * np.random.default_rng(3).normal(size=1000)
    assert excitation(data(u, u, resolution=resolution)).quiet is quiet
