"""New flights into an old TS model: what is lowered, what is remembered, what is said of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.rules.update import update
from flysid.model.ts import TS, FittedTS, over_lags
from tests.bent_plant import flight

DT = 0.05


def data(n: int, seed: int, gain: float = 0.1, noise: float = 0.0) -> Dataset:
    return Dataset.from_arrays(*flight(n, seed, gain, noise), DT)


@pytest.fixture(scope="module")
def model() -> FittedTS:
    return over_lags(TS(rules=3, na=2, nb=2, nk=1, antecedents=["y(k-1)"], iterations=10), data(1200, 1))


def free_run_error(m: FittedTS, gain: float) -> float:
    u, y = flight(600, 77, gain)
    return float(np.sqrt(np.mean((m.simulate(u)[:, 0] - y) ** 2)))


def test_noise_on_the_lags_does_not_spoil_the_free_run(model: FittedTS) -> None:
    """One step ahead measured lags carry their noise into every number; the free run has none."""
    newer = update(model, data(1500, 5, 0.15, noise=0.05), trust_samples=100)
    assert free_run_error(newer, 0.15) < 0.3 * free_run_error(model, 0.15)
    same = update(model, data(1500, 6, 0.1, noise=0.05))
    assert free_run_error(same, 0.1) < 0.02
    assert free_run_error(update(model, data(1500, 6, 0.1, noise=0.05), error="one step"), 0.1) > 0.02


def test_trust_and_forgetting_say_how_far_it_goes(model: FittedTS) -> None:
    fresh = data(1500, 5, 0.15, noise=0.02)
    told = [
        free_run_error(update(model, fresh, **how), 0.15)  # type: ignore[arg-type]
        for how in ({"trust_samples": 1e7}, {}, {"forgetting": 0.998}, {"trust_samples": 1.0})
    ]
    assert told == sorted(told, reverse=True)
    assert told[0] > 0.95 * free_run_error(model, 0.15)


def test_old_samples_are_forgotten(model: FittedTS) -> None:
    """The plant of the newest samples is followed, not the mean of all."""
    both = Dataset.from_arrays(
        [flight(1500, 5, 0.2)[0], flight(1500, 6, 0.15)[0]],
        [flight(1500, 5, 0.2)[1], flight(1500, 6, 0.15)[1]],
        DT,
    )
    forgets = update(model, both, forgetting=0.995)
    assert free_run_error(forgets, 0.15) < 0.25 * free_run_error(update(model, both), 0.15)


def test_one_step_ahead_it_is_weighted_least_squares(model: FittedTS) -> None:
    fresh = data(400, 5, 0.15, noise=0.02)
    forgetting = 0.99
    trust = 50.0
    newer = update(model, fresh, forgetting=forgetting, trust_samples=trust, error="one step")
    W = model.layout.stack(fresh.segments[0].u, fresh.segments[0].y)
    d = model.n_init
    x = model.layout.regressor_values(W)
    phi = model.firing(fresh.segments[0].u, fresh.segments[0].y)[d:]
    X = (phi[:, :, None] * x[:, None, :]).reshape(len(x), -1)
    power = (X * X).mean(axis=0)
    prior = forgetting ** len(X) * np.diag(trust * np.maximum(power, 1e-3 * power.max()))
    w = forgetting ** np.arange(len(X))[::-1]
    old = model.parameters.theta[:, 0].ravel()
    batch = np.linalg.solve(X.T @ (w[:, None] * X) + prior, X.T @ (w * W[d:, 0]) + prior @ old)
    assert newer.parameters.theta[:, 0].ravel() == pytest.approx(batch, abs=1e-8)


def test_both_errors_are_told_and_old_intervals_are_not(model: FittedTS) -> None:
    assert model.operating_points
    newer = update(model, data(800, 5, 0.15))
    assert newer.operating_points == ()
    assert "recursive least squares on the free run error over 800 new samples" in newer.notes[-1]
    assert "one step ahead" in newer.notes[-1]
    assert np.array_equal(newer.parameters.centre, model.parameters.centre)
    assert np.array_equal(newer.parameters.width, model.parameters.width)


def test_rules_that_come_out_unstable_are_named(model: FittedTS) -> None:
    theta = model.parameters.theta.copy()
    theta[1, 0, 0] += 1.0
    wild = replace(model, parameters=model.parameters._replace(theta=theta))
    newer = update(wild, data(100, 5), trust_samples=1e12, error="one step")
    assert newer.notes[-1].startswith("After the update unstable by itself: R2.")


def test_long_flights_are_taken_in_pieces(model: FittedTS) -> None:
    newer = update(model, data(9000, 5, 0.15), trust_samples=10.0)
    assert free_run_error(newer, 0.15) < 0.1 * free_run_error(model, 0.15)


def quiet(n: int) -> tuple[FloatArray, FloatArray]:
    return np.zeros(n), 1e-4 * np.random.default_rng(0).standard_normal(n)


@pytest.mark.parametrize("error", ["free run", "one step"])
@pytest.mark.parametrize(
    "flown",
    [quiet(300), (np.zeros(300), np.zeros(300)), flight(5, 1)],
    ids=["quiet", "still", "five samples"],
)
def test_flights_that_show_nothing_do_no_harm(
    model: FittedTS, flown: tuple[FloatArray, FloatArray], error: Literal["free run", "one step"]
) -> None:
    newer = update(model, Dataset.from_arrays(*flown, DT), error=error)
    assert max(rule.pole_radius for rule in newer.rules()) < 1.0
    assert free_run_error(newer, 0.1) < 2.0 * free_run_error(model, 0.1) + 0.02


def test_flights_that_the_memberships_were_not_made_for_are_told(model: FittedTS) -> None:
    u, y = flight(300, 5)
    newer = update(model, Dataset.from_arrays(100.0 * u, 100.0 * y, DT))
    assert any("outside the range that the memberships" in note for note in newer.notes)
    assert max(rule.pole_radius for rule in newer.rules()) < 1.0
    assert not any("outside the range" in note for note in update(model, data(300, 5)).notes)


def test_bad_requests_are_named(model: FittedTS) -> None:
    fresh = data(100, 5)
    with pytest.raises(UsageError, match="error='free'"):
        update(model, fresh, error="free")  # type: ignore[arg-type]
    for how in (
        {"forgetting": 2.0},
        {"forgetting": np.nan},
        {"trust_samples": 0.0},
        {"trust_samples": np.inf},
    ):
        with pytest.raises(UsageError, match="forgetting"):
            update(model, fresh, **how)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="no segment"):
        update(model, data(3, 5))
    with pytest.raises(UsageError, match="the model knows"):
        update(model, Dataset.from_arrays(*flight(100, 5), 2 * DT))
