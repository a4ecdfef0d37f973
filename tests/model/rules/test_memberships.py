"""Memberships and firing strengths: eq. (2) and (7), and what happens where nothing fires."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.rules.memberships import Conjunction, Partition, Shape

SHAPES: tuple[Shape, ...] = ("gaussian", "triangle", "trapezoid")


def partition(
    shape: Shape = "gaussian", conjunction: Conjunction = "product", low: float = -1e9, high: float = 1e9
) -> Partition:
    centre = np.array([[-1.0, 0.0], [0.5, 0.2], [2.0, -0.3]])
    left = np.array([[0.5, 1.0], [0.3, 0.4], [1.0, 0.7]])
    right = np.array([[0.4, 1.0], [0.6, 0.4], [0.2, 0.9]])
    return Partition(centre, left, right, np.full(2, low), np.full(2, high), shape, conjunction)


def test_product_of_gaussians_is_equation_7_and_2() -> None:
    p = partition()
    z = np.array([[0.1, 0.1]])
    width = np.where(z - p.centre < 0, p.left, p.right)
    strength = np.exp(-0.5 * ((z - p.centre) / width) ** 2).prod(axis=1)
    assert np.allclose(p.firing(z)[0], strength / strength.sum(), rtol=1e-13)


def test_minimum_takes_the_weaker_membership() -> None:
    p = partition(conjunction="minimum")
    z = np.array([[0.1, 0.1]])
    grades = np.minimum(p.grades(0, z[:, 0]), p.grades(1, z[:, 1]))[0]
    assert np.allclose(p.firing(z)[0], grades / grades.sum(), rtol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_grade_is_one_at_the_centre_and_falls_on_both_sides(shape: Shape) -> None:
    p = partition(shape)
    x = np.linspace(-4, 4, 161)
    grades = p.grades(0, x)
    assert p.grades(0, np.array([0.5]))[0, 1] == 1.0
    assert (np.diff(grades[x <= 0.5, 1]) >= 0).all()
    assert (np.diff(grades[x >= 0.5, 1]) <= 0).all()
    assert grades[-1, 0] < 1e-10 if shape == "gaussian" else grades[-1, 0] == 0.0


@given(
    z=arrays(np.float64, (5, 2), elements=st.floats(-1e300, 1e300)),
    shape=st.sampled_from(SHAPES),
    conjunction=st.sampled_from(("product", "minimum")),
)
@settings(deadline=None, max_examples=80)
def test_firing_is_finite_and_sums_to_one_anywhere(
    z: FloatArray, shape: Shape, conjunction: Conjunction
) -> None:
    phi = partition(shape, conjunction, -1e308, 1e308).firing(z)
    assert np.isfinite(phi).all()
    assert (phi >= 0).all()
    assert np.allclose(phi.sum(axis=1), 1.0, atol=1e-12)


def test_where_nothing_fires_the_nearest_rule_speaks() -> None:
    far = np.array([[1e6, 0.0], [-1e6, 0.0]])
    for shape in ("triangle", "trapezoid"):
        phi = partition(shape).firing(far)
        assert set(phi.max(axis=1)) == {1.0}


def test_outside_the_training_range_the_nearest_end_is_read() -> None:
    p = partition(low=-1.0, high=2.0)
    assert np.array_equal(p.firing(np.array([[50.0, 0.0]])), p.firing(np.array([[2.0, 0.0]])))


def test_round_trip_and_bad_settings() -> None:
    p = partition("trapezoid", "minimum")
    again = Partition.from_dict(p.to_dict())
    z = np.random.default_rng(0).normal(size=(20, 2))
    assert np.array_equal(p.firing(z), again.firing(z))
    with pytest.raises(UsageError, match="shape"):
        partition("round")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="positive"):
        Partition(p.centre, 0 * p.left, p.right, p.low, p.high)


def test_a_variable_that_is_not_there_is_named() -> None:
    for j in (2, -1):
        with pytest.raises(UsageError, match="no antecedent variable"):
            partition().grades(j, np.zeros(3))
