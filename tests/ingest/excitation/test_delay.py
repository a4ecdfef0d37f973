import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.errors import DataError
from flysid.ingest.excitation.delay import cross_correlation, estimate_delay, impulse_response

DT = 0.02


def lagged(
    delay_s: float, noise: float = 0.02, gain: float = 1.0, tau_s: float = 0.3, seed: int = 0
) -> Dataset:
    """A first-order lag behind a dead time, simulated at a tenth of the sample time."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    fine, steps = DT / 10, 10
    u = np.repeat(rng.normal(size=240), 25 * steps)
    late = np.concatenate([np.zeros(round(delay_s / fine)), u])[: len(u)]
    pole = np.exp(-fine / tau_s)
    y = lfilter([0.0, gain * (1 - pole)], [1.0, -pole], late)[::steps]
    return Dataset.from_arrays(u[::steps], y + noise * rng.normal(size=len(y)), DT)


@pytest.mark.parametrize("delay_s", [0.0, 0.031, 0.08, 0.15])
def test_dead_time_is_found_within_a_sample_although_the_lag_is_longer(delay_s: float) -> None:
    found = estimate_delay(lagged(delay_s))
    assert abs(found.delay_s - delay_s) <= DT
    assert found.low_s <= delay_s + DT / 2
    assert found.high_s >= delay_s - DT / 2
    assert found.peak_s > delay_s + 0.05  # the peak of the correlation is not the dead time


def test_the_sign_of_the_relation_is_told() -> None:
    assert estimate_delay(lagged(0.08, gain=-3.0)).sign == -1
    assert estimate_delay(lagged(0.08, gain=2.0)).sign == 1


def test_cross_correlation_peaks_at_a_pure_delay() -> None:
    rng = np.random.default_rng(2)
    u = rng.normal(size=(2, 500))
    data = Dataset.from_arrays(list(u), [np.roll(x, 7) for x in u], DT)
    lag_s, r = cross_correlation(data, max_lag_s=0.5)
    assert lag_s[np.argmax(r)] == pytest.approx(7 * DT)
    assert r.max() > 0.95
    assert np.abs(r).max() <= 1.0 + 1e-12


def test_impulse_response_of_a_known_filter() -> None:
    rng = np.random.default_rng(3)
    u = rng.normal(size=4000)
    g = np.array([0.0, 0.0, 0.5, 0.3, -0.1])
    y = np.convolve(u, g)[:4000] + 0.05 * rng.normal(size=4000)
    found = impulse_response(Dataset.from_arrays(u, y, DT), length_s=0.2, before_s=0.1)
    truth = np.zeros(len(found.g))
    truth[5 : 5 + len(g)] = g
    assert found.lag_s[5] == pytest.approx(0.0)
    assert np.abs(found.g - truth).max() < 5 * found.std.max()


def test_feedback_shows_before_lag_zero() -> None:
    rng = np.random.default_rng(4)
    y = rng.normal(size=4000)
    u = np.concatenate([np.zeros(2), 0.8 * y[:-2]]) + 0.1 * rng.normal(size=4000)
    found = impulse_response(Dataset.from_arrays(u, y, DT), length_s=0.1, before_s=0.1)
    assert found.lag_s[np.argmax(np.abs(found.g))] == pytest.approx(-2 * DT)


def test_what_cannot_be_estimated_is_refused() -> None:
    with pytest.raises(DataError, match="too short"):
        estimate_delay(Dataset.from_arrays(np.ones(5), np.ones(5), DT))
    with pytest.raises(DataError, match="moving"):
        estimate_delay(Dataset.from_arrays(np.zeros(500), np.ones(500), DT))
    with pytest.raises(DataError, match="too short"):
        impulse_response(Dataset.from_arrays(np.ones(30), np.ones(30), DT))
