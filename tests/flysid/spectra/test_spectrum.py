"""Spectra, peaks and their causes, on signals of which all is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.reviews.logged import Column
from flysid.spectra.causes import Source, name_causes, power_of
from flysid.spectra.peaks import fold, peaks_of
from flysid.spectra.spectrum import spread_over, whole_stretches, windows_of
from tests.flysid.spectra.gyro_logs import shaken


def test_a_spectrum_is_welchs() -> None:
    t, x = shaken(20.0, 500.0, [(80.0, 3.0)], 1.0, 1)
    found = windows_of(t, x)
    hz, density = signal.welch(x, 500.0, nperseg=500, detrend="constant")
    np.testing.assert_allclose(found.mean, density[1:250], rtol=1e-9)
    np.testing.assert_allclose(found.hz, hz[1:250])


def test_lost_rows_neither_move_a_tone_nor_the_rate() -> None:
    t, x = shaken(60.0, 400.0, [(92.0, 4.0)], 1.0, 2)
    lost = np.zeros(len(t), dtype=bool)
    for begin in np.random.default_rng(3).integers(0, len(t), 30):
        lost[begin : begin + 40] = True
    found = windows_of(t[~lost], x[~lost])
    assert found.rate_hz == pytest.approx(400.0, rel=1e-3)
    assert peaks_of(found, lowest_hz=10.0)[0].hz == pytest.approx(92.0, abs=0.3)


def test_a_clock_that_runs_slower_in_flight_keeps_the_tone_where_it_is() -> None:
    rng = np.random.default_rng(4)
    steps = np.where(np.arange(40_000) < 20_000, 0.001, 0.00125) + rng.normal(0.0, 2e-5, 40_000)
    t = np.asarray(np.cumsum(steps), dtype=np.float64)
    x = np.sin(2.0 * np.pi * 120.0 * t) + rng.normal(0.0, 0.3, len(t))
    assert peaks_of(windows_of(t, x))[0].hz == pytest.approx(120.0, abs=0.5)


def test_intervals_hold_the_true_frequency_in_most_records() -> None:
    held = 0
    for seed in range(40):
        hz = 60.0 + 40.0 * np.random.default_rng(seed).uniform()
        t, x = shaken(20.0, 400.0, [(hz, 1.0)], 2.0, seed)
        (first, *_) = peaks_of(windows_of(t, x), lowest_hz=10.0)
        held += first.interval[0] <= hz <= first.interval[1]
    assert held >= 36


def test_noise_has_no_peaks() -> None:
    found = 0
    for seed in range(60):
        t, x = shaken(20.0, 250.0, [], 2.0, 100 + seed)
        found += len(peaks_of(windows_of(t, x), lowest_hz=10.0))
    assert found <= 1


def test_a_slow_stream_names_what_a_tone_may_have_been() -> None:
    """15.05 Hz in 25 samples a second shows at 9.95 Hz."""
    t = np.asarray(np.arange(0.0, 45.0, 0.04), dtype=np.float64)
    x = 90.0 * np.sin(2.0 * np.pi * 15.05 * t) + np.random.default_rng(1).normal(0.0, 2.0, len(t))
    (peak, *_) = peaks_of(windows_of(t, x))
    assert peak.hz == pytest.approx(9.95, abs=0.15)
    assert peak.nyquist_hz == pytest.approx(12.5, rel=1e-3)
    assert min(abs(hz - 15.05) for hz in peak.folded(60.0)) < 0.15
    assert fold(np.array([15.05]), 25.0)[0] == pytest.approx(9.95)


def test_too_little_is_refused() -> None:
    with pytest.raises(DataError, match="long enough"):
        windows_of(np.linspace(0.0, 0.04, 5), np.zeros(5))
    assert whole_stretches(np.zeros(1)) == []


def moving(values: FloatArray, t: FloatArray) -> Column:
    return Column("test", "Hz", t, values)


def flown(seed: int, swing: float = 0.2) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, throttle, turns a second of a motor that follows it."""
    rng = np.random.default_rng(seed)
    t = np.arange(60_000) / 1000.0
    throttle = np.clip(0.45 + swing * np.sin(2.0 * np.pi * t / 13.0 + rng.uniform(0.0, 6.0)), 0.05, 1.0)
    return t, throttle, 160.0 * np.sqrt(throttle)


def test_a_motors_harmonic_is_named_and_so_is_its_alias() -> None:
    t, _, turns = flown(1)
    rng = np.random.default_rng(2)
    x = 3.0 * np.sin(4.0 * np.pi * np.cumsum(turns) / 1000.0) + rng.normal(0.0, 1.0, len(t))
    sources = [
        Source("motor 1", moving(np.full(len(t), 333.0), t)),
        Source("motor 2", moving(turns, t)),
    ]
    windows = windows_of(t, x)
    (peak, *_) = name_causes(windows, peaks_of(windows, lowest_hz=20.0), sources)
    assert peak.cause.startswith("motor 2, 2nd harmonic")


def test_a_harmonic_beyond_half_the_rate_is_named_as_folded() -> None:
    """202 to 226 Hz show at 24 to 48 Hz in 250 samples a second."""
    t, _, turns = flown(9, swing=0.05)
    x = 3.0 * np.sin(4.0 * np.pi * np.cumsum(turns) / 1000.0) + np.random.default_rng(10).normal(
        0.0, 1.0, len(t)
    )
    sources = [Source("motor 2", moving(turns, t))]
    slow = windows_of(t[::4], x[::4])
    named = name_causes(slow, peaks_of(slow, lowest_hz=20.0), sources)
    (folded,) = [p for p in named if p.cause.startswith("motor 2, 2nd harmonic, folded")]
    assert folded.true_hz == pytest.approx(float(np.median(2.0 * turns)), rel=0.02)


def test_what_stays_and_what_moves_with_the_throttle() -> None:
    t, throttle, turns = flown(3)
    rng = np.random.default_rng(4)
    x = 3.0 * np.sin(2.0 * np.pi * np.cumsum(turns) / 1000.0) + 3.0 * np.sin(2.0 * np.pi * 240.0 * t)
    windows = windows_of(t, x + rng.normal(0.0, 1.0, len(t)))
    found = {
        round(p.hz): p
        for p in name_causes(windows, peaks_of(windows, lowest_hz=20.0), [], moving(throttle, t))
    }
    assert found[240].cause.startswith("stays while the throttle moves")
    rest = [p for hz, p in found.items() if hz != 240]
    assert rest
    assert all(p.cause.startswith("moves with the throttle") for p in rest)
    power = power_of(windows, rest[0], throttle[np.searchsorted(t, windows.at_s)])
    assert power is not None
    assert power[0] < 0.5 < power[1] + 0.1


def test_a_throttle_that_hardly_moves_shows_no_cause() -> None:
    t, _, _ = flown(5)
    x = 3.0 * np.sin(2.0 * np.pi * 110.0 * t) + np.random.default_rng(6).normal(0.0, 1.0, len(t))
    windows = windows_of(t, x)
    still = moving(0.5 + 0.002 * np.sin(t), t)
    (peak, *_) = name_causes(windows, peaks_of(windows, lowest_hz=20.0), [], still)
    assert peak.cause == ""


def test_a_spectrum_over_the_throttle_puts_every_window_where_it_was_flown() -> None:
    t, throttle, turns = flown(7)
    x = np.sin(2.0 * np.pi * np.cumsum(turns) / 1000.0) + np.random.default_rng(8).normal(0.0, 0.1, len(t))
    windows = windows_of(t, x)
    spread = spread_over(windows, np.interp(windows.at_s, t, throttle), bins=8)
    tops = [spread.hz[np.nanargmax(row)] for row, n in zip(spread.density, spread.counts, strict=True) if n]
    middles = spread.middles[spread.counts > 0]
    np.testing.assert_allclose(tops, 160.0 * np.sqrt(middles), rtol=0.06)
    assert spread.counts.sum() == len(windows.at_s)


def test_motors_that_turn_alike_are_named_together() -> None:
    t, _, turns = flown(11)
    rng = np.random.default_rng(12)
    x = 3.0 * np.sin(2.0 * np.pi * np.cumsum(turns) / 1000.0) + rng.normal(0.0, 1.0, len(t))
    alike = [Source(f"motor {k}", moving(turns * (1.0 + 0.001 * k), t)) for k in (1, 2)]
    other = Source("motor 3", moving(turns[::-1].copy(), t))
    windows = windows_of(t, x)
    (peak, *_) = name_causes(windows, peaks_of(windows, lowest_hz=20.0), [*alike, other])
    assert peak.cause == "one of motor 1, motor 2"
