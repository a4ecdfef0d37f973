"""Two accounts of one motion whose differences are known."""

import numpy as np
import pytest

from flysid.ingest.kinematics.agreement import MotionRecord, agreement, late

DT_S = 0.01
HIGHEST_HZ = 10.0


def motion(rng: np.random.Generator, seconds: float = 60.0) -> np.ndarray:
    """(N,) a sum of tones up to 2 Hz, standard deviation 1."""
    time_s = np.arange(0.0, seconds, DT_S)
    tones = zip(rng.uniform(0.05, 2.0, 40), rng.uniform(0.0, 6.28, 40), strict=True)
    return np.asarray(sum(np.sin(2 * np.pi * f * time_s + p) for f, p in tones) / np.sqrt(20.0))


def record(
    rng: np.random.Generator, *, lag_s: float = 0.0, arm: float = 0.0, noise: float = 0.004
) -> MotionRecord:
    """One axis that reads 1.05 times too much and 0.2 more, late; what is implied is a noisy derivative."""
    exact = motion(rng) - 9.8
    other = motion(rng)
    reading = 1.05 * late(exact + arm * other, lag_s / DT_S) + 0.2
    implied = exact + np.gradient(noise * rng.standard_normal(len(exact)), DT_S)
    reading = reading + 0.1 * rng.standard_normal(len(exact))
    density = np.array([noise**2 * DT_S])
    return MotionRecord(DT_S, reading[:, None], implied[:, None], other[:, None, None], density, np.zeros(1))


def test_bias_scale_lag_and_arm_are_within_their_intervals() -> None:
    off = []
    for seed in range(8):
        found = agreement([record(np.random.default_rng(seed), lag_s=0.03, arm=0.5)], HIGHEST_HZ)
        off.append(
            [
                (found.scale[0] - 1.05) / found.scale_sd[0],
                (found.bias[0] - 0.2) / found.bias_sd[0],
                (found.lag_s - 0.03) / found.lag_sd,
                (found.arm[0] - 0.5) / found.arm_sd[0],
            ]
        )
    assert np.mean(np.abs(off) < 2.0) > 0.85
    assert np.abs(off).max() < 4.0


def test_the_noise_of_a_bias_is_not_taken_for_smaller_than_it_is() -> None:
    """A dozen slow lines tell it, and the fit has made their residuals smaller: intervals were too narrow."""
    noise = 0.005
    stated = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        exact = motion(rng)[:, None]
        implied = exact + np.gradient(0.01 * rng.standard_normal(exact.shape), DT_S, axis=0)
        reading = exact + noise * rng.standard_normal(exact.shape)
        density = np.array([0.01**2 * DT_S])
        made = MotionRecord(DT_S, reading, implied, np.empty((*exact.shape, 0)), density, np.zeros(1))
        stated.append(agreement([made], HIGHEST_HZ).bias_sd[0])
    assert np.mean(stated) > 1.02 * noise / np.sqrt(len(exact))


def test_noise_of_what_is_implied_does_not_shrink_the_scale() -> None:
    noisy = [record(np.random.default_rng(seed), noise=0.02) for seed in range(6)]
    scales = [agreement([r], HIGHEST_HZ).scale[0] for r in noisy]
    plain = [np.polyfit(r.implied[:, 0], r.measured[:, 0], 1)[0] for r in noisy]
    assert np.mean(plain) < 0.5  # least squares finds less than half of it
    assert np.mean(scales) == pytest.approx(1.05, abs=0.03)


def test_a_reading_of_the_other_sign_is_found() -> None:
    right = record(np.random.default_rng(3))
    wrong = MotionRecord(right.dt_s, -right.measured, right.implied, right.arm, right.noise, right.flat)
    assert agreement([wrong], HIGHEST_HZ).scale[0] == pytest.approx(-1.05, abs=0.05)


def test_two_records_tell_more_than_one() -> None:
    rng = np.random.default_rng(5)
    both = [record(rng), record(rng)]
    assert agreement(both, HIGHEST_HZ).scale_sd[0] < 0.9 * agreement(both[:1], HIGHEST_HZ).scale_sd[0]


def test_a_delay_of_steps_is_exact_for_a_line_and_a_tone() -> None:
    steps = np.arange(400.0)
    tone = np.sin(2 * np.pi * steps / 25.0)
    np.testing.assert_allclose(late(3.0 + 0.5 * steps, 2.5), 3.0 + 0.5 * (steps - 2.5), atol=1e-9)
    middle = slice(100, 300)
    expected = np.sin(2 * np.pi * (steps - 2.5) / 25.0)
    np.testing.assert_allclose(late(tone, 2.5)[middle], expected[middle], atol=2e-3)
