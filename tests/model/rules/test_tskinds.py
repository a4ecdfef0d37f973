"""Rules over lags and over hidden states tell alike; models of other kinds are refused in words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.model.arx import ARX
from flysid.model.rules.consequents import refit_consequents
from flysid.model.rules.edits import simplifications
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.stabilise import with_stable_rules
from flysid.model.rules.update import update
from flysid.model.static_ts import StaticTS
from flysid.model.ts import TS, over_lags
from flysid.model.ts_state_space import TSStateSpace
from tests import model_examples

DATA = model_examples.data()


@pytest.fixture(scope="module", params=["ts", "ts_ss"])
def model(request: pytest.FixtureRequest) -> FittedTS:
    if request.param == "ts":
        return over_lags(TS(rules=2, na=2, nb=2, nk=1, iterations=5), DATA)
    return TSStateSpace(states=2, rules=2, nk=1, iterations=5).fit(DATA)


def test_both_kinds_have_the_same_methods(model: FittedTS) -> None:
    corners = model.polytope()
    assert len(corners) == 2
    assert corners[0].A.shape == corners[1].A.shape
    found = model.certificate()
    assert found.reason
    u = DATA.segments[0].u
    y = DATA.segments[0].y
    low, high = model.uncertainty(DATA).simulation_band(u, y[: model.n_init])
    assert (low <= high).all()
    assert model.outside_share(u, y) < 0.05  # of changes, the simulated ones are what was seen
    assert model.outside_share(100.0 * u, 100.0 * y) > 0.5
    local = model.linearise(at={"u": 0.2})
    assert local.A.shape == local.A.T.shape


def test_python_control_follows_either(model: FittedTS) -> None:
    control = pytest.importorskip("control")
    system = model.to_control()
    assert isinstance(system, control.NonlinearIOSystem)
    assert system.dt == model.dt_s


def test_python_control_follows_one_rule_beyond_its_limits() -> None:
    control = pytest.importorskip("control")
    model = over_lags(TS(rules=1, na=2, nb=1, nk=1, iterations=5), DATA)
    u = np.concatenate([np.full(60, 30.0), np.full(60, -1.0)])[:, None]
    run = model.simulate(u)
    d = model.n_init
    assert (run == model.output_limits[1]).any()
    assert pytest.approx(model.polytope()[0].A, abs=1e-6) == model.linearise(at={"y": 100.0}).A
    answer = control.input_output_response(
        model.to_control(), model.dt_s * np.arange(len(u)), u.T, np.zeros(2 * d)
    )
    assert np.ravel(answer.outputs) == pytest.approx(run[:, 0], abs=1e-9)


OF_LAGS: list[Callable[[Any, Dataset], object]] = [
    simplifications,
    update,
    refit_consequents,
    with_stable_rules,
]


@pytest.mark.parametrize("function", OF_LAGS)
def test_what_is_for_lags_refuses_hidden_states(function: Callable[[Any, Dataset], object]) -> None:
    states = TSStateSpace(states=2, rules=1, nk=1, iterations=2).fit(DATA)
    with pytest.raises(UsageError, match="rules over lags, and the model is 'ts_ss'"):
        function(states, DATA)


@pytest.mark.parametrize("function", OF_LAGS)
def test_other_models_are_refused(function: Callable[[Any, Dataset], object]) -> None:
    for other in (StaticTS(rules=2).fit(DATA), ARX(na=1, nb=1, nk=1, refine=False).fit(DATA)):
        with pytest.raises(UsageError, match="this is for"):
            function(other, DATA)


def test_states_are_a_setting_of_one_structure() -> None:
    """`TS(states=2)` is `TSStateSpace(states=2)`; what belongs to lags alone is refused beside it."""
    asked: dict[str, Any] = {"states": 2, "rules": 2, "nk": 1, "iterations": 5}
    model = TS(**asked).fit(DATA)
    assert isinstance(model, FittedTS)
    other = TSStateSpace(**asked).fit(DATA)
    assert model.structure == "ts_ss"
    assert np.array_equal(model.consequents, other.consequents)
    for wrong in ({"na": 2}, {"nb": 1}, {"refine": False}, {"stable": True}):
        with pytest.raises(UsageError, match="states=0") as caught:
            TS(**(asked | wrong)).fit(DATA)
        assert caught.value.hint == "give states=0"
    for states in (-1, 1.5, True, "many"):
        with pytest.raises(UsageError, match="states"):
            TS(states=states).fit(DATA)  # type: ignore[arg-type]
