"""Clustering: known groups are found, whatever the scale of the columns."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.rules.clustering import Method, cluster, project

METHODS: tuple[Method, ...] = ("gustafson-kessel", "fuzzy-c-means", "subtractive")
TRUTH = np.array([[-3.0, 0.0], [0.0, 4.0], [4.0, -2.0]])


def groups(scale: float = 1.0) -> FloatArray:
    rng = np.random.default_rng(3)
    X = np.vstack([c + 0.3 * rng.normal(size=(200, 2)) for c in TRUTH])
    return np.asarray(X * [1.0, scale])


@pytest.mark.parametrize("method", METHODS)
def test_known_groups_are_found(method: Method) -> None:
    found = cluster(groups(), 3, method)
    centre = found.centre[np.argsort(found.centre[:, 0])]
    assert np.abs(centre - TRUTH).max() < (0.5 if method == "subtractive" else 0.15)
    assert np.allclose(found.grade.sum(axis=1), 1.0)


@pytest.mark.parametrize("method", METHODS)
def test_units_of_the_columns_do_not_matter(method: Method) -> None:
    one = cluster(groups(), 3, method)
    other = cluster(groups(1e6), 3, method)
    assert np.allclose(one.centre * [1.0, 1e6], other.centre, rtol=1e-6)


def test_same_seed_same_clusters() -> None:
    assert np.array_equal(cluster(groups(), 4, seed=5).centre, cluster(groups(), 4, seed=5).centre)


def test_gustafson_kessel_learns_the_shape_of_a_flat_group() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-4, 4, 400)
    flat = np.c_[x, 0.5 * x + 0.05 * rng.normal(size=400)]
    ball = [1.0, 2.5] + 0.4 * rng.normal(size=(400, 2))
    found = cluster(np.vstack([flat, ball]), 2, "gustafson-kessel")
    first = found.grade[:400].argmax(axis=1)
    second = found.grade[400:].argmax(axis=1)
    assert max((first == 0).mean(), (first == 1).mean()) > 0.95
    assert max((second == 0).mean(), (second == 1).mean()) > 0.95
    assert round(first.mean()) != round(second.mean())


def test_projection_has_positive_widths_on_both_sides() -> None:
    found = cluster(groups(), 3)
    centre, left, right = project(found, 1, two_sided=True)
    assert (np.diff(centre[:, 0]) > 0).all()
    assert (left > 0).all()
    assert (right > 0).all()
    _, both_left, both_right = project(found, 1, two_sided=False)
    assert np.array_equal(both_left, both_right)


def test_more_rules_than_samples_is_named() -> None:
    with pytest.raises(DataError, match="distinct"):
        cluster(np.ones((50, 2)), 2)
    with pytest.raises(UsageError, match="at least one"):
        cluster(groups(), 0)
    with pytest.raises(UsageError, match="unknown clustering"):
        cluster(groups(), 2, "magic")  # type: ignore[arg-type]
