"""Intervals of TS models: repeated experiments hold what they promise."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from bench.ts_intervals import coverage, experiment, known_model, refitted, steps
from flysid.dataset import Dataset
from flysid.errors import DataError, UsageError
from flysid.model.rules import rule_uncertainty
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.free_run_error import swept
from flysid.model.rules.rule_uncertainty import uncertainty
from flysid.model.ts import TS, over_lags


@pytest.fixture(scope="module")
def truth() -> FittedTS:
    return known_model()


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    shares = coverage(25)
    assert 0.85 <= shares["consequents"] <= 0.995
    assert 0.84 <= shares["gains"] <= 1.0
    assert 0.84 <= shares["simulation"] <= 0.995


def test_more_data_make_narrower_intervals(truth: FittedTS) -> None:
    data = experiment(truth, 3)
    model = refitted(truth, data)
    whole = uncertainty(model, data).consequent_errors
    half = Dataset.from_arrays(data.segments[0].u[:400], data.segments[0].y[:400], data.dt_s)
    assert (uncertainty(model, half).consequent_errors > whole).all()


def test_the_same_draws_every_time_and_every_run_finite(truth: FittedTS) -> None:
    data = experiment(truth, 4)
    sure = uncertainty(truth, data)
    first = sure.draws(5)
    second = sure.draws(5)
    assert all(np.array_equal(a.consequents, b.consequents) for a, b in zip(first, second, strict=True))
    low, high = sure.simulation_band(np.full((50, 1), 1e6))
    assert np.isfinite(low).all()
    assert (low <= high).all()


@pytest.mark.parametrize("from_rest", [True, False])
def test_the_band_is_what_small_steps_of_the_numbers_do(
    truth: FittedTS, from_rest: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = experiment(truth, 7)
    model = refitted(truth, data)
    sure = uncertainty(model, data)
    u = steps(3, 400)
    y0 = None if from_rest else data.segments[0].y[: model.n_init]
    run = model.simulate(u, y0)
    low, high = sure.simulation_band(u, y0)
    near = replace(sure, covariance=1e-8 * sure.covariance).draws(1000)
    spread = 1e4 * np.std([m.simulate(u, y0) - run for m in near], axis=0)
    assert np.abs((high - low) / 2 - 1.96 * spread).max() < 0.12 * spread.max()
    assert np.abs(high + low - 2 * run).max() < 1e-12
    assert (high > low)[model.n_init + 1 :].all()
    monkeypatch.setattr(rule_uncertainty, "swept", partial(swept, chunk=7))
    again = sure.simulation_band(u, y0)
    assert np.allclose(again, (low, high), rtol=1e-12, atol=0)
    short = sure.simulation_band(u[: model.n_init], None if y0 is None else y0)
    assert np.shape(short) == (2, model.n_init, 1)


def test_other_signals_are_refused(truth: FittedTS) -> None:
    u = np.zeros((50, 2))
    y = np.zeros(50)
    with pytest.raises(UsageError, match="the model has"):
        uncertainty(truth, Dataset.from_arrays(u, y, truth.dt_s))


def test_too_few_samples_are_refused(truth: FittedTS) -> None:
    data = experiment(truth, 5)
    few = Dataset.from_arrays(data.segments[0].u[:8], data.segments[0].y[:8], data.dt_s)
    with pytest.raises(DataError, match="fewer samples"):
        uncertainty(truth, few)


def test_a_gain_that_the_data_do_not_bound_has_no_interval(truth: FittedTS) -> None:
    data = experiment(truth, 6)
    p = truth.parameters
    slow = p.theta.copy()
    slow[0, 0, 0] = 0.99999  # a rule that nearly integrates: many draws do
    model = replace(truth, parameters=p._replace(theta=slow))
    interval = uncertainty(model, data).gain_interval
    assert np.isnan(interval[:, 0]).all()
    assert np.isfinite(interval[:, 1]).all()


def test_noisy_first_outputs_do_not_hide_what_the_data_know() -> None:
    """Lags of 200 Hz, measured with noise, start a run of third order at its limits."""
    dt = 0.005
    n = 2000
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-1, 1, n // 100), 100)
    slow = np.polymul([0.4, 1.0], np.polymul([0.1, 1.0], [0.05, 1.0]))
    b, a, _ = cont2discrete(([1.0], slow), dt)
    y = np.asarray(lfilter(b[0], a, u)) + 0.02 * rng.standard_normal(n)
    model = over_lags(TS(rules=1, na=3, nb=1, nk=1), Dataset.from_arrays(u, y, dt))
    low, high = model.uncertainty(Dataset.from_arrays(u, y, dt)).gain_interval[:, 0, 0, 0]
    assert 0.97 < low < 1.0 < high < 1.03
