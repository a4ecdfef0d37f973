"""Free runs: motors answer after their delay, and derivatives are those of the very steps."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.sixdof import layout
from flysid.sixdof.actuators import interval_means, shares
from flysid.sixdof.rigid_body import run, run_with_slopes

MOTORS = 6
DT = 0.01


@pytest.fixture(scope="module")
def theta() -> np.ndarray:
    rng = np.random.default_rng(3)
    found = rng.uniform(0.1, 0.5, layout.count(MOTORS))
    found[[layout.LAG, layout.DELAY, layout.CURVE, layout.POWER, layout.THRUST]] = 0.03, 0.0137, 0.6, 1.1, 4.0
    found[layout.INERTIA : layout.EFFECTS] = 1.1, 1.7, 0.02
    found[layout.EFFECTS :] = rng.normal(0.0, 20.0, 3 * MOTORS)
    return found


def flown(theta: np.ndarray, wind: np.ndarray, start: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(4)
    commands = rng.uniform(0.3, 0.7, (80, MOTORS))
    return run(start, shares(commands, 0.1 * rng.standard_normal(80), DT, theta)[0], DT, theta, wind)


def test_slopes_are_those_of_differences(theta: np.ndarray) -> None:
    rng = np.random.default_rng(4)
    commands = rng.uniform(0.3, 0.7, (80, MOTORS))
    halves, by = shares(commands, 0.1 * rng.standard_normal(80), DT, theta)
    start = np.concatenate([rng.normal(size=6), [1.0, 0.0, 0.0, 0.0], [0.3, -0.2, 0.5]])
    wind = np.array([1.0, -0.5, 0.2])
    _, slopes = run_with_slopes(start, np.eye(13), halves, by, DT, theta, wind)
    step = 1e-6
    everything = np.concatenate([theta, wind, start])
    count = len(theta)
    for i in [*range(count + 3 + 6), *range(count + 13, count + 16)]:
        ends = []
        for sign in (1.0, -1.0):
            moved = everything.copy()
            moved[i] += sign * step
            ends.append(flown(moved[:count], moved[count : count + 3], moved[count + 3 :]))
        by_difference = (ends[0] - ends[1]) / (2.0 * step)
        size = 1.0 + np.abs(by_difference).max()
        assert np.abs(by_difference - slopes[:, :, i]).max() < 1e-6 * size, i


@pytest.mark.parametrize("delay", [0.0, 0.005, 0.0131, 0.02, 0.0349])
def test_a_motor_answers_after_its_delay_and_as_a_lag_does(theta: np.ndarray, delay: float) -> None:
    own = theta.copy()
    own[layout.DELAY], own[layout.CURVE] = delay, 0.0
    commands = np.zeros((40, MOTORS))
    commands[10:] = 1.0
    x = shares(commands, np.zeros(40), DT, own)[0][:, 0]
    t = 0.5 * DT * np.arange(len(x)) - 10 * DT - delay
    expected = np.where(t > 0.0, 1.0 - np.exp(-np.maximum(t, 0.0) / own[layout.LAG]), 0.0)
    np.testing.assert_allclose(x, expected, atol=1e-12)


def test_means_of_intervals_are_those_of_the_curve() -> None:
    t = np.linspace(0.0, 10.0, 21)
    cubes = np.asarray(np.diff(t[::2] ** 3), dtype=np.float64)
    means = interval_means(np.asarray(t**2, dtype=np.float64)[:, None])[:, 0]
    assert np.abs(means - cubes / 3.0).max() < 1e-12


def test_without_motors_it_falls(theta: np.ndarray) -> None:
    own = np.zeros_like(theta)
    own[layout.LAG] = 0.03
    own[layout.INERTIA : layout.ARM] = 1.0, 2.0
    start = np.zeros(13)
    start[6] = 1.0
    states = run(start, np.zeros((201, MOTORS)), DT, own)
    assert states[-1, 2] == pytest.approx(-0.5 * 9.81, rel=1e-9)
