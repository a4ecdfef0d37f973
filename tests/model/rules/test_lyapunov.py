"""Common quadratic Lyapunov functions: found where one exists, proved, and refused where none can be."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.model.linear_matrix_inequalities import cheapest
from flysid.model.rules.lyapunov import MOST_STATES, certificate_of, common_lyapunov


def with_common_function(n: int, condition: float, rho: float, seed: int) -> list[FloatArray]:
    """Three rules that are rho times a rotation in common coordinates: there x'x shrinks by rho^2."""
    rng = np.random.default_rng(seed)

    def rotation() -> FloatArray:
        return np.asarray(np.linalg.qr(rng.standard_normal((n, n)))[0])

    T = rotation() * np.geomspace(1.0, np.sqrt(condition), n) @ rotation()
    return [np.asarray(rho * np.linalg.solve(T, rotation() @ T), dtype=np.float64) for _ in range(3)]


def companion(poles: FloatArray) -> FloatArray:
    A = np.zeros((len(poles), len(poles)))
    A[0], A[1:, :-1] = -np.poly(poles)[1:], np.eye(len(poles) - 1)
    return A


@pytest.mark.parametrize("n", [1, 2, 4, 6])
@pytest.mark.parametrize("condition", [10.0, 1e7])
@pytest.mark.parametrize("rho", [0.9, 0.999])
def test_one_that_exists_is_found_and_is_a_proof(n: int, condition: float, rho: float) -> None:
    rules = with_common_function(n, condition, rho, seed=round(condition) % 1009)
    found = common_lyapunov(rules)
    assert found is not None
    P, decay = found
    size = np.linalg.eigvalsh(P).max()
    assert np.linalg.eigvalsh(P).min() > 0.0
    for A in rules:
        assert np.linalg.eigvalsh(A.T @ P @ A - decay**2 * P).max() < 1e-9 * size
        assert np.linalg.eigvalsh(A.T @ P @ A - P).max() < 0.0
    assert decay < 0.2 + 0.8 * rho


def test_it_is_looked_for_up_to_the_most_states_and_not_beyond() -> None:
    for n, is_found in ((MOST_STATES, True), (MOST_STATES + 1, False)):
        found = common_lyapunov([0.5 * np.eye(n), 0.6 * np.eye(n)])
        assert (found is not None) == is_found
        assert certificate_of([0.5 * np.eye(n), 0.6 * np.eye(n)]).proved == is_found


def test_slow_rules_of_high_order_at_a_fast_clock() -> None:
    """Four poles of 0.1 to 0.5 s at 100 Hz, other ones in every rule: the lags are nearly equal."""
    rng = np.random.default_rng(0)
    slow = np.exp(-0.01 / np.array([0.5, 0.3, 0.2, 0.1]))
    for _ in range(5):
        found = certificate_of([companion(slow ** rng.uniform(0.5, 2.0, 4)) for _ in range(3)])
        assert found.proved
        assert found.decay < 1.0


def test_stable_rules_that_can_be_switched_to_run_away_have_none() -> None:
    """Each shrinks by itself; one after the other they grow, which no common function allows."""
    A = np.array([[0.5, 2.0], [0.0, 0.5]])
    assert np.abs(np.linalg.eigvals(A @ A.T)).max() > 1.0
    found = certificate_of([A, A.T])
    assert not found.proved
    assert found.decay >= 1.0
    assert "no common quadratic Lyapunov function was found" in found.reason


def test_the_length_that_is_told_is_not_rounded_in_our_favour() -> None:
    found = certificate_of([np.array([[0.9123451]]), np.array([[0.3]])])
    told = float(found.reason.split("falls to ")[1].split(" ")[0])
    assert found.decay <= told < found.decay + 1e-4
    assert found.decay >= 0.9123451


@pytest.mark.parametrize("unit", [1.0, 1e5, 1e-9])
def test_the_least_cost_is_found_in_whatever_units_the_unknowns_stand(unit: float) -> None:
    """x y > 1 at the least x + y: both are 1; rounding takes the small unknown's part in Newton's step."""
    units = np.array([unit, 1.0 / unit])
    F = np.zeros((2, 2, 2))
    F[0, 0, 0], F[1, 1, 1] = units
    ones = np.array([[0.0, 1.0], [1.0, 0.0]])
    found = cheapest([(ones, F)], units, np.array([2.0, 3.0]) / units, 0.01)
    assert 2.0 < units @ found < 2.02
