"""`flysid.TS()` in Python and `ts` of `flysid fit` are one search; the old name still works, and warns."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import flysid
from flysid.dataset import Dataset
from flysid.model import ts_best
from flysid.model.last_gates import LINEAR_ENOUGH
from flysid.model.rules.search_settings import EFFORTS
from flysid.model.ts import TS, FittedTS, over_lags
from flysid.validate.runs.run import FitSettings
from flysid.validate.runs.wanted_models import estimators

QUICK = replace(EFFORTS["quick"], highest_order=2)


def lag(samples: int = 400) -> Dataset:
    """A linear lag, a little noise."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1.0, 1.0, samples // 10), 10)
    y = np.zeros(samples)
    for k in range(1, samples):
        y[k] = 0.8 * y[k - 1] + 0.2 * u[k - 1]
    return Dataset.from_arrays(u, y + 0.01 * rng.normal(size=samples), 0.05)


def bent(samples: int) -> Dataset:
    """A lag behind an actuator that saturates."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-1.0, 1.0, samples // 10), 10)
    y = np.zeros(samples)
    for k in range(1, samples):
        y[k] = 0.8 * y[k - 1] + 0.2 * np.tanh(3.0 * u[k - 1])
    return Dataset.from_arrays(u, y + 0.01 * rng.normal(size=samples), 0.05)


def test_the_command_fits_what_python_does() -> None:
    wanted = estimators(FitSettings(models=("ts", "ts_lags")))
    assert wanted["ts"] == TS()
    assert wanted["ts_lags"] == TS(states=0)


@pytest.mark.usefixtures("arx_alone")
def test_where_no_rules_pay_the_linear_model_is_delivered() -> None:
    model = TS(search=QUICK).fit(lag())
    assert not isinstance(model, FittedTS)
    assert model.notes[0].startswith(LINEAR_ENOUGH)


@pytest.mark.usefixtures("arx_alone")
@pytest.mark.parametrize("asked", [{"states": 0}, {"na": 1, "nb": 1, "nk": 1}, {"stable": True}])
def test_what_only_lags_have_asks_for_rules_over_lags(asked: dict[str, int]) -> None:
    settings = TS(search=QUICK, **asked)  # type: ignore[arg-type]
    model = settings.fit(lag())
    assert isinstance(model, FittedTS)
    assert model.structure == "ts"
    assert np.array_equal(model.consequents, over_lags(settings, lag()).consequents)


@pytest.mark.usefixtures("arx_alone")
def test_the_order_of_flights_changes_nothing() -> None:
    """Parts of flights are held out, and which ones must not hang on how they are listed."""
    whole = bent(1200)
    flights = [
        replace(whole.segments[0].slice(k, k + 300, whole.dt_s), flight=f"flight {k}")
        for k in range(0, 1200, 300)
    ]
    settings = TS(rules=2, search=QUICK, iterations=5)
    models = [settings.fit(whole.with_segments(list(order))) for order in (flights, flights[::-1])]
    assert models[0].to_dict() == models[1].to_dict()


def test_rules_that_are_asked_for_are_rules_whatever_the_plant() -> None:
    model = TS(rules=2, nk=1, search=QUICK, iterations=5).fit(lag())
    assert len(model.rules()) == 2


@pytest.mark.usefixtures("arx_alone")
def test_the_old_name_warns_once_and_finds_the_same() -> None:
    ts_best._warn.cache_clear()
    with pytest.warns(FutureWarning, match="flysid.BestTS is flysid.TS now") as caught:
        old = flysid.BestTS(search=QUICK)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = flysid.BestTS(search=QUICK)
    assert again == old
    assert old.fit(lag()).to_dict() == TS(search=QUICK).fit(lag()).to_dict()
