"""Instruments: rates, latency, noise, bias, steps and losses are what they say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.errors import UsageError
from flysid.ingest.synth.sensors import SENSORS, Sensor, observe, sample_times_ns
from flysid.ingest.synth.telemetry import Telemetry

TIME_NS = 12_000_000_000 + 5_000_000 * np.arange(4001, dtype=np.int64)
RAMP = Telemetry(TIME_NS, {"vx": (TIME_NS - TIME_NS[0]) * 1e-9, "z": np.zeros(4001)})


def plain(rate_hz: float = 50.0, **changes: float) -> Sensor:
    return Sensor(rate_hz, {}, {}, {}, **changes)


def test_a_perfect_sensor_tells_the_truth_bit_for_bit() -> None:
    seen = observe(RAMP, plain(200.0), np.random.default_rng(0))
    np.testing.assert_array_equal(seen.time_ns, RAMP.time_ns)
    np.testing.assert_array_equal(seen["vx"], RAMP["vx"])


@settings(max_examples=30, deadline=None)
@given(st.floats(0.5, 1000.0))
def test_times_are_whole_milliseconds_at_the_stated_rate(rate_hz: float) -> None:
    times = sample_times_ns(12_000_000_000, 32_000_000_000, rate_hz)
    assert (times % 1_000_000 == 0).all()
    assert (np.diff(times) > 0).all()
    assert len(times) == pytest.approx(20 * rate_hz + 1, abs=1)


def test_motion_capture_keeps_its_own_clock_and_is_late() -> None:
    seen = observe(RAMP, SENSORS["motion-capture"], np.random.default_rng(0))
    gaps = np.diff(seen.time_ns)
    assert set(gaps.tolist()) == {8_000_000, 9_000_000}
    expected = (seen.time_ns - TIME_NS[0]) * 1e-9 - 0.008
    np.testing.assert_allclose(seen["vx"][5:], expected[5:], atol=1e-9)


def test_noise_bias_and_steps_have_the_stated_size() -> None:
    sensor = Sensor(200.0, {"z": 0.1}, {"vx": 0.5}, {"z": 0.01})
    biases = []
    for seed in range(40):
        seen = observe(RAMP, sensor, np.random.default_rng(seed))
        biases.append(seen["vx"][0] - RAMP["vx"][0])
        np.testing.assert_allclose(seen["vx"] - RAMP["vx"], biases[-1])
    assert np.std(biases) == pytest.approx(0.5, rel=0.35)
    assert np.std(seen["z"]) == pytest.approx(0.1, rel=0.05)
    np.testing.assert_allclose(seen["z"] / 0.01, np.round(seen["z"] / 0.01), atol=1e-9)


def test_losses_leave_gaps_and_nothing_is_made_up() -> None:
    seen = observe(RAMP, plain(50.0, loss=0.2), np.random.default_rng(3))
    assert len(seen) == pytest.approx(0.8 * 1001, rel=0.06)
    assert set((np.diff(seen.time_ns) % 20_000_000).tolist()) == {0}


@pytest.mark.parametrize("changes", [{"rate_hz": 0.0}, {"loss": 1.0}, {"latency_s": -1.0}])
def test_impossible_sensors_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="no sensor"):
        plain(**changes)
