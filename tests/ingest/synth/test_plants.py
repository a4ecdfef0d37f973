"""The plants (10) to (12): coefficients, exact responses, the paper's experiment."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.errors import UsageError
from flysid.ingest.synth.plants import LOOPS, Loop, fly, paper_experiment

NAMES = sorted(LOOPS)


@pytest.mark.parametrize(
    ("name", "frequency", "damping"),
    [("longitudinal", 2.67, 0.784), ("lateral", 0.549, 0.895), ("vertical", 4.54, 0.155)],
)
def test_poles_are_those_the_paper_prints(name: str, frequency: float, damping: float) -> None:
    poles = LOOPS[name].transfer_function().poles()
    slowest = poles[np.argmin(np.abs(poles))]
    assert abs(slowest) == pytest.approx(frequency, abs=0.01)
    assert -slowest.real / abs(slowest) == pytest.approx(damping, abs=0.01)


@pytest.mark.parametrize("name", NAMES)
def test_flying_agrees_with_python_control_held_between_samples(name: str) -> None:
    import control

    u = np.random.default_rng(3).standard_normal(500)
    discrete = control.sample_system(LOOPS[name].transfer_function(), 0.02, method="zoh")
    expected = control.forced_response(control.tf2ss(discrete), inputs=u).outputs
    np.testing.assert_allclose(fly(LOOPS[name], u, 0.02), expected, atol=1e-9)
    np.testing.assert_array_equal(fly(LOOPS[name].transfer_function(), u, 0.02), fly(LOOPS[name], u, 0.02))


@pytest.mark.parametrize("name", NAMES)
def test_a_first_order_hold_agrees_with_python_controls_forced_response(name: str) -> None:
    import control

    u = np.random.default_rng(4).standard_normal(500)
    expected = control.forced_response(
        control.tf2ss(LOOPS[name].transfer_function()), np.arange(500) * 0.02, u
    ).outputs
    np.testing.assert_allclose(fly(LOOPS[name], u, 0.02, hold="first"), expected, atol=1e-9)


def test_a_first_order_step_is_the_exponential() -> None:
    lag = Loop((2.0,), (0.5, 1.0), "u", "y", "")
    time_s = 0.1 * np.arange(50)
    np.testing.assert_allclose(fly(lag, np.ones(50), 0.1), 2 * (1 - np.exp(-2 * time_s)), atol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_a_step_settles_at_the_gain(name: str) -> None:
    assert fly(LOOPS[name], np.ones(6000), 0.01)[-1] == pytest.approx(LOOPS[name].gain, rel=1e-6)
    assert LOOPS[name].response(0.0) == pytest.approx(LOOPS[name].gain)


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(NAMES), st.floats(-5, 5), st.integers(1, 40))
def test_flying_is_linear_and_does_not_see_the_future(name: str, factor: float, at: int) -> None:
    u = np.random.default_rng(at).standard_normal(80)
    y = fly(LOOPS[name], u, 0.05)
    np.testing.assert_allclose(fly(LOOPS[name], factor * u, 0.05), factor * y, atol=1e-10)
    changed = u.copy()
    changed[at:] += 1.0
    np.testing.assert_array_equal(fly(LOOPS[name], changed, 0.05)[: at + 1], y[: at + 1])


@pytest.mark.parametrize("name", NAMES)
def test_a_linear_regression_of_the_plants_order_is_exact(name: str) -> None:
    """A hold makes the sampled plant an ARX model exactly: the claim `reproduce` rests on."""
    u, y, y_true = paper_experiment(name, duration_s=60.0)
    np.testing.assert_array_equal(y, y_true)
    n = len(LOOPS[name].denominator) - 1
    rows = np.arange(n, len(u))
    phi = np.column_stack([y[rows - i] for i in range(1, n + 1)] + [u[rows - i] for i in range(n + 1)])
    theta = np.linalg.lstsq(phi, y[n:], rcond=None)[0]
    assert np.abs(phi @ theta - y[n:]).max() < 1e-9


def test_the_paper_experiment_is_seeded_and_its_noise_has_the_stated_size() -> None:
    first = paper_experiment("lateral", "validation", noise=0.02, seed=5)
    again = paper_experiment("lateral", "validation", noise=0.02, seed=5)
    other = paper_experiment("lateral", "validation", noise=0.02, seed=6)
    assert len(first[0]) == 40_000
    np.testing.assert_array_equal(first[1], again[1])
    assert not np.array_equal(first[1], other[1])
    assert np.std(first[1] - first[2]) == pytest.approx(0.02, rel=0.02)
    assert first[0][1000] == pytest.approx(sum(np.sin(w * 10.0) for w in (0.1, 0.2, 0.3, 0.4)))


def test_what_cannot_be_flown_is_named() -> None:
    with pytest.raises(UsageError, match="no loop 'yaw'"):
        paper_experiment("yaw")
    with pytest.raises(UsageError, match="no signal 'test'"):
        paper_experiment("lateral", "test")
    with pytest.raises(UsageError, match="not proper"):
        fly(Loop((1.0, 0.0, 0.0), (1.0, 1.0), "u", "y", ""), np.ones(3), 0.1)
    with pytest.raises(UsageError, match="sample time"):
        fly(LOOPS["lateral"], np.ones(3), 0.0)
