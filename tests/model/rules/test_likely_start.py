"""Models of rules start a free run from as many measured samples as tell their lags and derivatives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.model.arx import ARX
from flysid.model.base import load
from flysid.model.start import settled_start_rows
from flysid.model.ts import TS, over_lags

DT = 1e-3
NOISE = 1e-3


def positioned(seed: int, samples: int = 6000) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Force, true and measured position of a mass that a controller moves; nothing pulls it back."""
    rng = np.random.default_rng(seed)
    goal = DT * np.cumsum(np.repeat(rng.uniform(-0.4, 0.4, samples // 1000 + 1), 1000)[:samples])
    u = np.zeros(samples)
    y = np.zeros(samples)
    x = v = 0.0
    for k in range(samples):
        y[k] = x
        u[k] = 60.0 * (goal[k] - x) - 12.0 * v + 2.0 * np.sin(2.6 * np.pi * k * DT + seed)
        v += DT * (u[k] - 1.5 * v)
        x += DT * v
    return u, y, y + NOISE * rng.standard_normal(samples)


@pytest.fixture(scope="module")
def train() -> Dataset:
    u, _, measured = positioned(2)
    return Dataset.from_arrays(u, measured, DT)


@pytest.mark.parametrize("rules", [1, 2])
def test_first_samples_of_a_double_integrator_at_a_high_rate_tell_its_speed(
    train: Dataset, rules: int, tmp_path: Path
) -> None:
    """Two measured positions do not: they started free runs 0.1 off, 1.9 times what the position spans."""
    model = over_lags(TS(rules=rules, na=2, nb=2, nk=1), train)
    u, true, measured = positioned(1002)
    run = model.simulate(u, measured[: model.n_init])
    late = slice(600, None)
    error = float(np.sqrt(np.mean((run[late, 0] - true[late]) ** 2)))
    assert error < 0.03 * true.std()
    model.save(tmp_path / "model.json")
    np.testing.assert_array_equal(load(tmp_path / "model.json").simulate(u, measured[: model.n_init]), run)


def test_an_equation_that_integrates_starts_from_as_many_samples_as_others(train: Dataset) -> None:
    """ARX whose pole is at one, or a rounding beyond: it took the lags as measured."""
    model = ARX().fit(train)
    u, true, measured = positioned(1002)
    run = model.simulate(u, measured[: model.n_init])[600:, 0]
    assert model.n_init > 100
    assert np.sqrt(np.mean((run - true[600:]) ** 2)) < 0.03 * true.std()


def test_a_start_without_noise_is_the_true_one() -> None:
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-1.0, 1.0, 60), 10)
    y = np.zeros(600)
    for k in range(2, 600):
        y[k] = 1.6 * y[k - 1] - 0.7 * y[k - 2] + 0.1 * u[k - 1]
    model = over_lags(TS(rules=1, na=2, nb=1, nk=1), Dataset.from_arrays(u, y, DT))
    run = model.simulate(u[100:], y[100 : 100 + model.n_init])
    np.testing.assert_allclose(run[:, 0], y[100:], atol=1e-6)


def test_more_samples_are_taken_where_only_many_help() -> None:
    """Four positions at a high rate tell a speed no better than two, a hundred do."""
    by_rows = {2: 100.0, 4: 99.0, 8: 60.0, 16: 20.0, 32: 4.0, 64: 1.0, 100: 0.9}
    assert settled_start_rows(by_rows.__getitem__, 2, 100) == 64
    assert settled_start_rows(lambda rows: 0.1, 2, 100) == 2  # noqa: ARG005
    assert settled_start_rows(lambda rows: 5.0, 2, 100) == 2  # noqa: ARG005
