"""A plant that integrates keeps its pole at one; a state space is the same model as a difference equation."""

from __future__ import annotations

import numpy as np

from flysid.dataset import Dataset
from flysid.model.rules.judging import INTEGRATES
from flysid.model.rules.linear_starts import as_difference
from flysid.model.statespace import StateSpace
from flysid.model.ts import TS, over_lags
from flysid.model.ts_state_space import TSStateSpace


def axis(n: int, seed: int, noise: float) -> Dataset:
    """Force to position with viscous friction: (1 - q^-1)(1 - 0.95 q^-1) y = 0.01 u(k-1)."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=n // 20 + 1), 20)[:n]
    y = lfilter([0.0, 0.01], np.convolve([1.0, -1.0], [1.0, -0.95]), u)
    return Dataset.from_arrays(u, y + noise * rng.normal(size=n), 0.02)


def test_the_pole_of_a_plant_that_integrates_is_one_and_its_free_run_does_not_drift() -> None:
    model = over_lags(TS(rules=1, na=2, nb=1, nk=1), axis(600, 1, 0.02))
    lags = model.parameters.theta[0, 0, :2]
    assert abs(lags.sum() - 1.0) < 1e-12
    assert INTEGRATES in model.notes
    assert "unstable" not in str(model)
    fresh = axis(3000, 2, 0.0).segments[0]
    gap = model.simulate(fresh.u, fresh.y[: model.n_init]) - fresh.y
    assert np.sqrt((gap * gap).mean()) < 0.05 * fresh.y.std()


def test_rules_over_hidden_states_say_that_the_process_integrates() -> None:
    model = TSStateSpace(rules=2, states=2).fit(axis(600, 1, 0.02))
    assert INTEGRATES in model.notes
    assert INTEGRATES not in TSStateSpace(rules=1, states=2).fit(lag(600)).notes


def lag(n: int) -> Dataset:
    """y(k) = 0.95 y(k-1) + 0.05 u(k-1), with noise."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.normal(size=n // 20 + 1), 20)[:n]
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 0.95 * y[k - 1] + 0.05 * u[k - 1]
    return Dataset.from_arrays(u, y + 0.01 * rng.normal(size=n), 0.02)


def test_a_state_space_as_a_difference_equation_runs_alike() -> None:
    data = axis(400, 3, 0.01)
    model = StateSpace(order=2, refine=False, nk=1).fit(data)
    system = as_difference(model)
    u = data.segments[0].u
    rest = model.simulate(u)
    y = rest.copy()
    for k in range(2, len(u)):
        terms = [system.b[lag] @ (u[k - lag] - model.u_origin) for lag in range(len(system.b))]
        terms += [-system.a[lag] @ (y[k - lag] - model.y_origin) for lag in (1, 2)]
        y[k] = model.y_origin + system.c + sum(terms)
    inside = np.cumprod((np.abs(rest) < 0.99 * np.abs(model.output_limits).min()).all(axis=1)).astype(bool)
    assert inside.sum() > 50
    assert np.allclose(y[inside], rest[inside], atol=1e-6)
