"""What the search for rules weighs can be set, and the efforts are such settings."""

from __future__ import annotations

import doctest
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bench.hidden_plants import PLANTS
from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.model.rules import learning, search_settings
from flysid.model.rules.search import different
from flysid.model.rules.search_settings import EFFORTS, NORMAL, SearchSettings
from flysid.model.ts import TS, over_lags
from flysid.model.ts_choice import contest
from flysid.validate.runs.run import FitSettings
from flysid.validate.runs.wanted_models import estimators


def _data() -> Dataset:
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.0, 60), 10)
    y = np.zeros(600)
    for k in range(1, 600):
        y[k] = 0.8 * y[k - 1] + 0.2 * np.tanh(2.0 * u[k - 1])
    return Dataset.from_arrays(u, y + 0.02 * rng.normal(size=600), 0.05)


def test_the_examples_of_the_settings_are_true() -> None:
    assert doctest.testmod(search_settings).failed == 0


@pytest.mark.parametrize(
    "wrong",
    [{"folds": 0}, {"folds": 5}, {"lanes": 0}, {"exchanges": -1}, {"ridges": ()}, {"rule_gain": -0.1}],
)
def test_settings_that_cannot_be_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=next(iter(wrong)).split("_")[-1]):
        over_lags(TS(search=replace(NORMAL, **wrong)), _data())


def test_an_unknown_effort_names_the_known_ones() -> None:
    with pytest.raises(UsageError) as raised:
        SearchSettings.of("hasty")
    assert all(effort in raised.value.hint for effort in EFFORTS)


@pytest.mark.usefixtures("arx_alone")
def test_what_is_set_is_done() -> None:
    """Fewer parts held out, no order above the highest, and no more rules than win what is asked for."""
    data = _data()
    usual = over_lags(TS(search=replace(NORMAL, highest_order=2)), data)
    assert any("held out in turn" in note for note in usual.notes)
    assert usual.layout.orders.na <= 2
    one = over_lags(TS(search=replace(NORMAL, highest_order=1, folds=1, rule_gain=1e9)), data)
    assert not any("held out in turn" in note for note in one.notes)
    assert len(one.rules()) == 1 < len(usual.rules())


def test_a_linear_model_that_was_found_twice_is_grown_from_once() -> None:
    found = learning.lag_starts(TS(na=1, nb=1, nk=1), _data(), None)
    start = found.starts[0]
    stage = start.linear.stage
    nearly = stage.under(offset=stage.problem.offset * (1.0 + 1e-7))
    again = replace(start, folds=((replace(start.linear, stage=nearly),),))
    other = replace(
        start, folds=((replace(start.linear, stage=stage.under(offset=0.9 * stage.problem.offset)),),)
    )
    assert different([start, again, other]) == [start, other]


@pytest.mark.usefixtures("arx_alone")
def test_a_quick_search_leaves_hidden_states_out() -> None:
    data = PLANTS["hysteresis"].dataset((1,), 400, 0.02)[0]
    quick = replace(EFFORTS["quick"], highest_order=2)
    assert contest(TS(rules=2, search=quick), data).states is None
    tried = contest(TS(rules=2, search=replace(quick, hidden_states=True)), data)
    assert tried.states is not None


@pytest.mark.parametrize("label", ["ts", "ts_lags", "ts_ss", "linear_lags"])
def test_the_effort_of_a_run_reaches_every_model_of_rules(label: str) -> None:
    for effort, wanted in EFFORTS.items():
        found: Any = estimators(FitSettings(models=(label,), effort=effort))[label]
        assert found.search is wanted
    with pytest.raises(UsageError, match="effort"):
        estimators(FitSettings(effort="hasty"))
