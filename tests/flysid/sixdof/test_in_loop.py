"""Predictions from many starts: damage is masked, physics helps early, the loop late, inputs tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.horizons import Starts, errors, fly_ahead, hold, whole_starts
from flysid.sixdof.in_loop import blind, fit_in_loop, fit_ridge
from flysid.sixdof.records import Scale, flights_of
from tests.flysid.sixdof.hidden_quad import HiddenQuad, dataset
from tests.flysid.sixdof.test_cleaning import damaged

STEPS = 30


def starts_of(data: Dataset) -> list[Starts]:
    return [whole_starts(record, STEPS, 5) for record in flights_of(data, Scale(0.0, 1.0)).records]


def test_no_start_touches_damage(still: Dataset) -> None:
    (starts,) = starts_of(damaged(still, 800, 100, 20.0))
    near = (starts.at + STEPS >= 801) & (starts.at - 20 <= 898)
    assert not near.any()
    assert len(starts.at) > 300


def test_each_predictor_is_better_where_it_knows_more(gusty: Dataset, gusty_regressed: FittedVehicle) -> None:
    known = starts_of(gusty)
    (unseen,) = starts_of(dataset(HiddenQuad(gust=8.0), 1, 15.0, 90))
    held = errors(unseen, hold(unseen))
    alone = errors(unseen, fly_ahead(unseen, gusty_regressed))
    in_loop = errors(unseen, fit_in_loop(known, gusty_regressed).predict(unseen))
    without = errors(unseen, fit_in_loop(known, blind(gusty_regressed)).predict(unseen))
    assert alone[4, 3] < 0.8 * held[4, 3]
    assert alone[:, :2].sum() < held[:, :2].sum()
    assert in_loop.sum() < 0.9 * without.sum()
    assert without.sum() < held.sum()


def test_without_motors_no_motor_tells(gusty: Dataset, gusty_regressed: FittedVehicle) -> None:
    known = starts_of(gusty)
    model = fit_in_loop(known, blind(gusty_regressed), weight=0.01)
    first = known[0]
    rng = np.random.default_rng(0)
    other = replace(first.record, commands=rng.uniform(0.1, 1.0, first.record.commands.shape))
    same = model.predict(first)
    moved = model.predict(replace(first, record=other))
    np.testing.assert_allclose(same.rate, moved.rate, atol=1e-9)


def test_the_future_of_motors_beyond_the_horizon_tells_nothing(
    gusty: Dataset, gusty_regressed: FittedVehicle
) -> None:
    known = starts_of(gusty)
    model = fit_in_loop(known, gusty_regressed, weight=0.01)
    one = replace(known[0], at=known[0].at[:1])
    step = 7
    later = one.record.commands.copy()
    later[one.at[0] + step :] = 0.5
    other = replace(one, record=replace(one.record, commands=later))
    np.testing.assert_allclose(model.predict(one).rate[: step - 1], model.predict(other).rate[: step - 1])


def test_a_ridge_finds_slopes() -> None:
    rng = np.random.default_rng(1)
    x = [rng.standard_normal((200, 3)), rng.standard_normal((50, 3))]
    slopes = np.array([[1.0], [-2.0], [0.5]])
    found = fit_ridge(x, [each @ slopes + 3.0 for each in x], 1e-9)
    np.testing.assert_allclose(found(np.eye(3)), slopes + 3.0, atol=1e-6)
