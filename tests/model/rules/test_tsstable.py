"""Rules made stable on request: as little as is needed, with a proof where one is asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.stabilise import with_stable_rules
from flysid.model.ts import TS, over_lags

DT = 0.05


def flight(n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Near zero the plant is unstable by itself; farther out it is driven back."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, n // 10 + 1), 10)[:n]
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 1.15 * y[k - 1] - 0.3 * y[k - 1] ** 3 + 0.25 * u[k - 1]
    return u, y


@pytest.fixture(scope="module")
def data() -> Dataset:
    return Dataset.from_arrays(*flight(1500, 1), DT)


@pytest.fixture(scope="module")
def model(data: Dataset) -> FittedTS:
    return over_lags(TS(rules=3, na=1, nb=1, nk=1, antecedents=["y(k-1)"]), data)


def free_run_error(m: FittedTS) -> float:
    u, y = flight(800, 9)
    return float(np.sqrt(np.mean((m.simulate(u, y[: m.n_init])[:, 0] - y) ** 2)))


def test_the_plant_is_what_it_should_be(model: FittedTS) -> None:
    assert max(rule.pole_radius for rule in model.rules()) > 1.0
    assert free_run_error(model) < 0.05


@pytest.mark.parametrize("certified", [False, True])
def test_poles_come_inside_and_the_rest_makes_up_for_it(
    model: FittedTS, data: Dataset, certified: bool
) -> None:
    stable = with_stable_rules(model, data, largest=0.99, certified=certified)
    assert max(rule.pole_radius for rule in stable.rules()) <= 0.99 + 1e-9
    assert len(stable.rules()) == 3
    assert "the largest pole radius of a rule was 1.0" in stable.notes[-1]
    assert free_run_error(stable) < 0.15
    if certified:
        found = stable.certificate()
        assert found.proved
        for corner in stable.polytope():
            A = corner.A[:1, :1]
            assert np.linalg.eigvalsh(A.T @ found.P @ A - found.P).max() < 0.0


def test_only_what_is_beyond_is_drawn(model: FittedTS, data: Dataset) -> None:
    before = [rule.pole_radius for rule in model.rules()]
    after = [rule.pole_radius for rule in with_stable_rules(model, data).rules()]
    for old, new in zip(before, after, strict=True):
        assert new == pytest.approx(min(old, 0.999), abs=2e-3)


def test_rules_that_need_a_common_function_are_drawn_together(data: Dataset) -> None:
    """Two stable rules of second order that can be switched to run away."""
    truth = over_lags(TS(rules=2, na=2, nb=1, nk=1, antecedents=["u(k-1)"], iterations=5), data)
    theta = truth.parameters.theta.copy()
    theta[0, 0, :2] = (1.9, -0.96)
    theta[1, 0, :2] = (0.2, -0.96)
    wild = replace(truth, parameters=truth.parameters._replace(theta=theta))
    assert not wild.certificate().proved
    assert max(rule.pole_radius for rule in wild.rules()) < 0.99
    assert with_stable_rules(wild, data) is wild
    assert with_stable_rules(wild, data, certified=True).certificate().proved


def test_stable_rules_stay_as_they_are(model: FittedTS, data: Dataset) -> None:
    stable = with_stable_rules(model, data)
    assert with_stable_rules(stable, data) is stable


def test_on_request_of_the_estimator(data: Dataset) -> None:
    fitted = over_lags(TS(rules=3, na=1, nb=1, nk=1, antecedents=["y(k-1)"], stable=True), data)
    assert max(rule.pole_radius for rule in fitted.rules()) <= 0.999 + 1e-9
    assert any("Made stable" in note for note in fitted.notes)


def test_what_cannot_be_is_named(model: FittedTS, data: Dataset) -> None:
    with pytest.raises(UsageError, match="largest=1"):
        with_stable_rules(model, data, largest=1.0)
    with pytest.raises(DataError, match="no segment"):
        with_stable_rules(model, data.with_segments([data.segments[0].slice(0, 1, DT)]))
    with pytest.raises(DataError, match="too few"):
        with_stable_rules(model, data.with_segments([data.segments[0].slice(0, 8, DT)]))
    with pytest.raises(UsageError, match="the model knows"):
        with_stable_rules(model, Dataset.from_arrays(np.zeros((50, 2)), np.zeros(50), DT))
    theta = model.parameters.theta.copy()
    theta[:, 0, 0] = 1.2
    wild = replace(model, parameters=model.parameters._replace(theta=theta))
    with pytest.raises(FitError, match="mean of all rules"):
        with_stable_rules(wild, data)
    theta = theta.copy()
    theta[:, 0, 0] = 1.0
    integrating = replace(model, parameters=model.parameters._replace(theta=theta))
    with pytest.raises(UsageError, match="integrates"):
        with_stable_rules(integrating, data)
