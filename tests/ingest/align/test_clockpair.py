import numpy as np
import pytest

from flysid.errors import DataError
from flysid.ingest.align.clock_pair import ClockFit, fit_clock
from flysid.ingest.align.resample import RecordedSignal


def motion(duration_s: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A smooth random signal at 500 Hz with power up to about 1.5 Hz."""
    t = np.arange(0.0, duration_s, 0.002)
    rng = np.random.default_rng(seed)
    tones = rng.uniform(0.1, 1.5, size=40)
    x = sum(np.sin(2 * np.pi * f * t + p) for f, p in zip(tones, rng.uniform(0, 6.28, size=40), strict=True))
    return t, np.asarray(x)


def recordings(
    duration_s: float, offset_s: float, drift_ppm: float, noise: float = 0.3
) -> tuple[RecordedSignal, RecordedSignal]:
    """One motion, by a 198 Hz recorder with jitter and by a 120 Hz one whose clock is late and drifts."""
    rng = np.random.default_rng(1)
    t, x = motion(duration_s)
    t_a = np.sort(
        np.arange(0, duration_s, 1 / 198) + rng.normal(scale=5e-4, size=int(np.ceil(duration_s * 198)))
    )
    t_b = np.arange(2.0, duration_s - 2.0, 1 / 120)
    a = np.interp(t_a, t, x) + noise * rng.normal(size=len(t_a))
    b = -2.0 * np.interp(t_b, t, x) + 3.0 + noise * rng.normal(size=len(t_b))
    stamps = (t_b - offset_s) / (1 + 1e-6 * drift_ppm)
    return RecordedSignal(np.round(t_a * 1e9).astype(np.int64), a), RecordedSignal(
        np.round(stamps * 1e9).astype(np.int64), b
    )


def true_offset_s(fit: ClockFit, offset_s: float, drift_ppm: float) -> float:
    return offset_s + fit.at_ns * 1e-9 * drift_ppm * 1e-6


@pytest.mark.parametrize(("offset_s", "drift_ppm"), [(0.083, 200.0), (-1.7, -50.0), (0.0, 0.0)])
def test_offset_and_drift_are_found_within_what_is_promised(offset_s: float, drift_ppm: float) -> None:
    reference, other = recordings(300.0, offset_s, drift_ppm)
    fit = fit_clock(reference, other, 5.0)
    error_s = fit.offset_s - true_offset_s(fit, offset_s, drift_ppm)
    assert abs(error_s) < 2e-3
    assert abs(fit.drift_ppm - drift_ppm) < 10.0
    assert abs(error_s) < 5 * fit.offset_std_s + 2e-4
    assert fit.correlation < -0.95
    assert fit.gain == pytest.approx(-2.0, rel=0.05)


def test_times_land_on_the_reference_clock() -> None:
    reference, other = recordings(200.0, 0.083, 200.0)
    fit = fit_clock(reference, other)
    truth = np.arange(2.0, 198.0, 1 / 120)[: len(other.t_ns)]
    assert np.abs(fit.to_reference(other.t_ns) * 1e-9 - truth).max() < 3e-3


def test_a_drift_within_its_error_is_taken_as_none() -> None:
    reference, other = recordings(40.0, 0.05, 0.0)
    fit = fit_clock(reference, other)
    assert fit.drift_ppm == 0.0
    assert abs(fit.offset_s - 0.05) < 2e-3


def test_recordings_of_different_flights_are_refused() -> None:
    reference, _ = recordings(100.0, 0.0, 0.0)
    t, x = motion(100.0, seed=9)
    with pytest.raises(DataError, match="do not match"):
        fit_clock(reference, RecordedSignal(np.round(t * 1e9).astype(np.int64), x))


def test_too_few_samples_are_refused() -> None:
    few = RecordedSignal(np.arange(5, dtype=np.int64), np.zeros(5))
    with pytest.raises(DataError, match="too few"):
        fit_clock(few, few)
