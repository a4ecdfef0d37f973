"""Consequents of fixed memberships: global, local and mixed, and a ridge that the data choose."""

from __future__ import annotations

import numpy as np
import pytest

from bench.ts_intervals import experiment, known_model
from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.rules.consequents import Criterion, refit_consequents
from flysid.model.static_ts import FittedStaticTS, StaticTS


def curve(n: int = 600, noise: float = 0.0, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    u = rng.uniform(-2.0, 2.0, n)
    return u, np.sin(2.0 * u) + noise * rng.standard_normal(n)


def fitted(how: StaticTS, n: int = 600, noise: float = 0.0, seed: int = 0) -> FittedStaticTS:
    return how.fit(Dataset.from_arrays(*curve(n, noise, seed), 0.1))


def error(model: FittedStaticTS) -> float:
    u = np.linspace(-2.0, 2.0, 400)
    return float(np.sqrt(np.mean((model.simulate(u)[:, 0] - np.sin(2.0 * u)) ** 2)))


def test_local_ones_are_weighted_least_squares_of_every_rule() -> None:
    u, y = curve(noise=0.1)
    model = fitted(StaticTS(rules=5, consequents="local"), noise=0.1)
    X = np.c_[u, np.ones(len(u))]
    phi = model.firing(u, y)
    for r in range(5):
        expected = np.linalg.solve(X.T @ (phi[:, [r]] * X), X.T @ (phi[:, r] * y))
        assert model.consequents[r, 0] == pytest.approx(expected, rel=1e-8)


def test_mixed_ones_lower_the_mean_of_both_errors() -> None:
    u, y = curve(noise=0.1)
    X = np.c_[u, np.ones(len(u))]
    found: dict[str, float] = {}
    for criterion in ("global", "local", "mixed"):
        model = fitted(StaticTS(rules=5, consequents=criterion), noise=0.1)
        phi = model.firing(u, y)
        alone = X @ model.consequents[:, 0].T
        together = float(((y - (phi * alone).sum(axis=1)) ** 2).sum())
        apart = float((phi * (y[:, None] - alone) ** 2).sum())
        found |= {f"{criterion} together": together, f"{criterion} apart": apart}
        found[criterion] = together + apart
    assert found["global together"] < found["mixed together"] < found["local together"]
    assert found["local apart"] < found["mixed apart"] < found["global apart"]
    assert found["mixed"] < min(found["global"], found["local"])


def test_local_rules_follow_the_tangent_where_they_speak() -> None:
    """The slope of the curve at a rule's centre is what its consequent says; global ones may say anything."""
    local = fitted(StaticTS(rules=7, consequents="local"), noise=0.05)
    centre = local.partition.centre[1:-1, 0]
    value = local.consequents[1:-1, 0, 0] * centre + local.consequents[1:-1, 0, 1]
    assert value == pytest.approx(np.sin(2.0 * centre), abs=0.35)


@pytest.mark.parametrize("criterion", ["global", "local", "mixed"])
def test_a_ridge_goes_from_the_plain_fit_to_the_line(criterion: Criterion) -> None:
    u, y = curve(noise=0.1)
    line = np.polyfit(u, y, 1)
    none = fitted(StaticTS(rules=4, consequents=criterion), noise=0.1)
    little = fitted(StaticTS(rules=4, consequents=criterion, ridge=1e-13), noise=0.1)
    much = fitted(StaticTS(rules=4, consequents=criterion, ridge=1e9), noise=0.1)
    assert little.consequents == pytest.approx(none.consequents, rel=1e-4, abs=1e-4)
    assert much.consequents[:, 0] == pytest.approx(np.tile(line, (4, 1)), abs=1e-6)


def test_a_ridge_is_that_of_the_textbook() -> None:
    u, y = curve(200, 0.1)
    model = fitted(StaticTS(rules=3, ridge=0.01), 200, 0.1)
    ridge = 0.01
    X = np.c_[u, np.ones(len(u))]
    phi = model.firing(u, y)
    design = np.hstack([phi[:, [r]] * X for r in range(3)])
    weight = np.diag(np.tile(ridge * (X * X).sum(axis=0), 3))
    line = np.tile(np.linalg.lstsq(X, y, rcond=None)[0], 3)
    expected = line + np.linalg.solve(design.T @ design + weight, design.T @ (y - design @ line))
    assert model.consequents[:, 0].ravel() == pytest.approx(expected, rel=1e-8)


def test_the_ridge_from_the_data_is_small_where_rules_are_sure_and_helps_where_they_are_not() -> None:
    auto = StaticTS(rules=9, ridge="auto")
    plain = StaticTS(rules=9)
    assert error(fitted(auto)) < 1.2 * error(fitted(plain))
    errors = np.array([[error(fitted(how, 40, 0.5, seed)) for how in (auto, plain)] for seed in range(12)])
    assert errors[:, 0].mean() < 0.8 * errors[:, 1].mean()
    assert any("a ridge of" in note for note in fitted(auto, 40, 0.5).notes)


@pytest.mark.parametrize("ridge", ["auto", 0.0])
def test_consequents_of_a_dynamic_model_likewise(ridge: object) -> None:
    model = known_model()
    data = experiment(known_model(), 1)
    again = refit_consequents(model, data, criterion="local", ridge=ridge)  # type: ignore[arg-type]
    assert "local least squares" in again.notes[-1]
    assert again.parameters.theta.shape == model.parameters.theta.shape
    assert not np.array_equal(again.parameters.theta, refit_consequents(model, data).parameters.theta)


def test_settings_that_cannot_be() -> None:
    data = Dataset.from_arrays(*curve(60), 0.1)
    with pytest.raises(UsageError, match=r"ridge=-1.0"):
        StaticTS(rules=3, ridge=-1.0)
    with pytest.raises(DataError, match="31 rules of 2 numbers: more samples are needed than there are"):
        StaticTS(rules=31).fit(data)
