"""Several inputs: what one input cannot tell is not asked of it, and what only rules can use is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.search_settings import EFFORTS
from flysid.model.ts import TS, over_lags

pytestmark = pytest.mark.usefixtures("arx_alone")
DT = 0.05
QUICK = replace(EFFORTS["quick"], highest_order=2)  # no plant here is of a higher one


def held(n: int, rng: np.random.Generator, length: int = 15) -> FloatArray:
    return np.repeat(rng.uniform(-1, 1, n // length + 1), length)[:n]


def dataset(u: FloatArray, y: FloatArray, *names: str) -> Dataset:
    return Dataset(DT, tuple(Signal(n) for n in names), (Signal("y"),), (Segment(u, y[:, None]),))


def bent(n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """(n, 3) inputs of which only the first one acts, and the answer of a spring that hardens."""
    rng = np.random.default_rng(seed)
    u = np.stack([held(n, rng) for _ in range(3)], axis=1)
    y = np.zeros(n)
    for k in range(2, n):
        y[k] = 1.6 * y[k - 1] - 0.7 * y[k - 2] + 0.1 * u[k - 1, 0] - 0.1 * y[k - 1] ** 3
    return u, y


def scheduled(n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """(n, 2) aileron and airspeed, which sets gain and bandwidth and does nothing by itself; roll rate."""
    rng = np.random.default_rng(seed)
    u = np.stack([held(n, rng), held(n, rng, 60)], axis=1)
    y = np.zeros(n)
    for k in range(1, n):
        speed = 1.0 + 0.4 * u[k - 1, 1]
        y[k] = y[k - 1] + DT * speed * (3.0 * speed * u[k - 1, 0] - 2.0 * y[k - 1])
    return u, y


def free_run_error(model: FittedTS, u: FloatArray, y: FloatArray) -> float:
    """Of the spread of y."""
    run = model.simulate(u, y[: model.n_init, None])
    return float(np.sqrt(np.mean((run[:, 0] - y) ** 2)) / y.std())


def test_inputs_that_do_nothing_cost_nothing() -> None:
    u, y = bent(1500, 2)
    noisy = y + 0.02 * y.std() * np.random.default_rng(2).normal(size=len(y))
    model = over_lags(TS(most_rules=2, search=QUICK), dataset(u, noisy, "throttle", "pan", "tilt"))
    assert any("past values of pan, tilt" in note for note in model.notes)
    alone = over_lags(TS(most_rules=2, search=QUICK), dataset(u[:, :1], noisy, "throttle"))
    fresh_u, fresh_y = bent(1000, 7)
    assert free_run_error(model, fresh_u, fresh_y) < 1.2 * free_run_error(alone, fresh_u[:, :1], fresh_y)


def test_an_input_that_only_sets_the_gain_speaks_in_the_conditions() -> None:
    u, y = scheduled(2000, 1)
    noisy = y + 0.02 * y.std() * np.random.default_rng(2).normal(size=len(y))
    model = over_lags(TS(most_rules=2, search=QUICK), dataset(u, noisy, "aileron", "airspeed"))
    names = [antecedent.name(model.layout.signals) for antecedent in model.layout.antecedents]
    assert any("airspeed" in name for name in names)
    fresh_u, fresh_y = scheduled(1000, 7)
    linear = over_lags(TS(rules=1, search=QUICK), dataset(u, noisy, "aileron", "airspeed"))
    assert free_run_error(model, fresh_u, fresh_y) < 0.3 * free_run_error(linear, fresh_u, fresh_y)


def test_orders_that_were_given_are_kept() -> None:
    u, y = bent(800, 1)
    model = over_lags(TS(rules=1, na=2, nb=2, nk=1), dataset(u, y, "throttle", "pan", "tilt"))
    assert model.layout.orders.nb == (2, 2, 2)
