"""Levenberg-Marquardt: known minima, divergent trial points, both forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.model.refine import levenberg_marquardt


def rosenbrock(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    x, y = theta
    return np.array([10 * (y - x * x), 1 - x]), np.array([[-20 * x, 10.0], [-1.0, 0.0]])


def as_normal(theta: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    r, j = rosenbrock(theta)
    return float(r @ r), j.T @ j, j.T @ r


def exponential(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals of a growing exponential that overflows for large theta."""
    t = np.linspace(0, 100, 101)
    y = np.exp(-0.05 * t)
    with np.errstate(over="ignore", invalid="ignore"):
        model = np.exp(theta[0] * t)
        return model - y, (t * model)[:, None]


def test_finds_the_minimum_of_rosenbrock_in_both_forms() -> None:
    for evaluate in (rosenbrock, as_normal):
        found = levenberg_marquardt(evaluate, np.array([-1.2, 1.0]), tolerance=1e-14)
        assert found.theta == pytest.approx([1.0, 1.0], abs=1e-9)
        assert found.reason == "converged"


def test_divergent_trial_points_are_rejected() -> None:
    found = levenberg_marquardt(exponential, np.array([0.06]), max_iterations=200)
    assert found.theta == pytest.approx([-0.05], abs=1e-8)


def test_a_cheap_cost_gives_the_same_path_as_the_full_evaluation() -> None:
    calls = []

    def cost(theta: FloatArray) -> float:
        calls.append(1)
        return float(np.sum(rosenbrock(theta)[0] ** 2))

    plain = levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]))
    cheap = levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]), cost=cost)
    assert calls
    assert (cheap.theta == plain.theta).all()


@pytest.mark.parametrize("iterations", [1, 4, 50])
def test_the_last_point_is_not_differentiated(iterations: int) -> None:
    differentiated = []

    def evaluate(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        differentiated.append(theta)
        return rosenbrock(theta)

    def cost(theta: FloatArray) -> float:
        return float(np.sum(rosenbrock(theta)[0] ** 2))

    start = np.array([-1.2, 1.0])
    found = levenberg_marquardt(evaluate, start, cost=cost, max_iterations=iterations)
    assert found.cost < cost(start)
    assert not any((theta == found.theta).all() for theta in differentiated)


def test_a_divergent_start_is_an_error() -> None:
    with pytest.raises(FitError, match="start"):
        levenberg_marquardt(exponential, np.array([100.0]))


@pytest.mark.parametrize("shape", [(3, 5), (40, 4)])
def test_linear_problems_are_solved_even_when_columns_are_dependent(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    a = rng.standard_normal(shape)
    a[:, -1] = a[:, 0]
    b = rng.standard_normal(shape[0])
    found = levenberg_marquardt(lambda x: (a @ x - b, a), np.zeros(shape[1]), tolerance=1e-14)
    best = a @ np.linalg.lstsq(a, b, rcond=None)[0] - b
    assert found.cost == pytest.approx(float(best @ best), rel=1e-8, abs=1e-18)


def test_bad_condition_costs_no_accuracy_in_residual_form() -> None:
    rng = np.random.default_rng(2)
    q, _ = np.linalg.qr(rng.standard_normal((200, 5)))
    a = q * np.logspace(0, -9, 5)
    a = a @ np.linalg.qr(rng.standard_normal((5, 5)))[0]
    truth = rng.standard_normal(5)
    found = levenberg_marquardt(lambda x: (a @ (x - truth), a), np.zeros(5), tolerance=0, max_iterations=200)
    assert np.abs(found.theta - truth).max() < 1e-5


@settings(deadline=None, max_examples=40)
@given(st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 30))
def test_the_cost_never_rises(x: float, y: float, iterations: int) -> None:
    start = np.array([x, y])
    found = levenberg_marquardt(as_normal, start, max_iterations=iterations)
    assert found.cost <= as_normal(start)[0]
    assert found.cost == as_normal(found.theta)[0]
