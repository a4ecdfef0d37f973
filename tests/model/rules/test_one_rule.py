"""One rule is the linear side's choice, parameter for parameter; fits that several ask for are done once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bench import accuracy_data
from flysid.dataset import Dataset
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.last_gates import LINEAR_ENOUGH
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear_choice import best_linear, choose_baseline
from flysid.model.one_rule import OneRule, linear_choice, linear_rivals, same_orders
from flysid.model.rules import search_context
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.growth import linear_stage
from flysid.model.rules.linear_starts import as_linear, orders_of
from flysid.model.rules.search_settings import EFFORTS, NORMAL
from flysid.model.rules.stages import Stage
from flysid.model.selection import free_run_errors, parts_to_choose_on
from flysid.model.shared import sharing
from flysid.model.statespace import StateSpace
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.ts import TS, over_lags
from flysid.validate.compare_models import compare
from flysid.validate.show.page.narrative import heads, subtitle, title

DT = 0.05


def lag(seed: int, samples: int = 400, late: int = 2) -> Dataset:
    """A second-order lag with a dead time; nothing bends."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, samples // 10 + 1), 10)[:samples]
    y = np.zeros(samples)
    for k in range(late, samples):
        y[k] = 1.5 * y[k - 1] - 0.56 * y[k - 2] + 0.06 * u[k - late]
    return Dataset.from_arrays(3.0 + 2.0 * u, 10.0 + 5.0 * y + 0.1 * rng.normal(size=samples), DT)


def test_where_rules_do_not_pay_the_baseline_comes_back() -> None:
    train = lag(0)
    quick = EFFORTS["quick"]
    with sharing():
        found = TS(search=quick).fit(train)
        choice, linear = best_linear(train, None, linear_rivals(search=quick))
    assert found.structure == choice.label == linear.structure
    assert isinstance(found, FittedLinear)
    assert isinstance(linear, FittedLinear)
    assert np.array_equal(found.flat, linear.flat)
    assert found.notes[0].startswith(LINEAR_ENOUGH)
    assert any(note.startswith("Validation free-run error by number of rules") for note in found.notes)
    compared = compare({choice.label: linear, "ts": found}, lag(1), baseline=choice.label)
    assert compared.verdict["y"].one_rule
    assert compared.verdict["y"].change_pct == 0.0
    told = heads({"y": compared})
    said = f"{title(told)} {subtitle(told)}"
    assert "A linear model is enough" in said
    assert "fuzzy" not in said.lower()


@pytest.mark.parametrize("asked", [{}, {"na": 2, "nb": 2, "nk": 2}])
def test_one_rule_over_lags_has_the_linear_models_coefficients(asked: dict[str, int]) -> None:
    train = lag(2)
    settings = TS(rules=1, search=EFFORTS["quick"], **asked)  # type: ignore[arg-type]
    with sharing():
        model = over_lags(settings, train)
        choice = linear_choice(settings, train, None)
    assert isinstance(model, FittedTS)
    assert choice is not None
    linear = as_linear(choice[1])
    assert linear is not None
    (A, B, _), a, b = model.local_polynomials()[0], linear.system.a, linear.system.b
    assert np.allclose(A[:, 0, 0], -a[1:, 0, 0], rtol=1e-9, atol=1e-12)
    assert np.allclose(B[: len(b), 0, 0], b[:, 0, 0], rtol=1e-9, atol=1e-12)
    test = lag(3).segments[0]
    linear_run = choice[1].free_run(test)  # type: ignore[attr-defined]
    assert np.allclose(model.free_run(test)[100:], linear_run[100:], atol=1e-3)


def test_on_whole_flights_rules_start_from_what_their_rival_of_one_rule_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flights = [replace(lag(seed, 150).segments[0], flight=str(seed)) for seed in range(4)]
    train = lag(0).with_segments(flights)
    short = replace(EFFORTS["quick"], short=100)
    asked: list[int] = []
    alone = linear_stage

    def counted(*args: Any) -> Stage:
        asked.append(1)
        return alone(*args)

    monkeypatch.setattr(search_context, "linear_stage", counted)
    with sharing():
        OneRule(search=short).fit(*parts_to_choose_on(train))
        rival = len(asked)
        over_lags(TS(rules=2, search=short), train)
    assert rival > 0
    assert len(asked) == rival


def test_a_state_space_with_delays_becomes_its_difference_equation() -> None:
    model = StateSpace(order=2, nk=3, refine=False).fit(lag(4, late=3))
    equation = as_linear(model)
    assert equation is not None
    u = np.zeros((60, 1))
    u[25:] = 1.0
    start = np.zeros((equation.system.depth, 1))
    response = equation.system.run(u, start) - equation.system.run(0.0 * u, start)
    expected = model.simulate(model.u_origin + u) - model.simulate(model.u_origin + 0.0 * u)
    assert response == pytest.approx(expected, abs=1e-9)


def test_a_fit_is_done_once_within_a_scope_and_forgotten_after() -> None:
    train = lag(5)
    again = lag(5)
    with sharing():
        first = ARX(na=1, nb=1, nk=1).fit(train)
        assert ARX(na=1, nb=1, nk=1).fit(again) is first
        assert ARX(na=1, nb=1, nk=2).fit(train) is not first
        assert ARX(na=1, nb=1, nk=1).fit(lag(6)) is not first
        with sharing():
            assert ARX(na=1, nb=1, nk=1).fit(train) is first
    assert ARX(na=1, nb=1, nk=1).fit(train) is not first


def test_models_of_one_rule_compete_for_the_baseline() -> None:
    choice = choose_baseline(lag(7), linear_rivals())
    assert {"linear_lags", "linear_ss"} <= choice.rmse.keys()
    assert "linear_ss" not in linear_rivals(search=EFFORTS["quick"])


@pytest.mark.skipif(not accuracy_data.FOLDER.is_dir(), reason="no public sets here")
def test_one_rule_finds_orders_that_no_linear_structure_tries() -> None:
    case = accuracy_data.dryer()
    structures = {name: m for name, m in linear_rivals().items() if not isinstance(m, OneRule)}
    with sharing():
        _, structure = best_linear(case.train, None, structures)
        models = {"one rule": OneRule().fit(case.train), "structure": structure}
    errors = free_run_errors(models, case.tests["test"])
    assert errors["one rule"].mean() < 0.7 * errors["structure"].mean()


def test_one_rule_is_its_equation_over_lags() -> None:
    data = lag(8)
    model = OneRule().fit(data)
    equation = as_linear(model)
    assert equation is not None
    u = np.zeros((60, 1))
    u[25:] = 1.0
    start = np.zeros((equation.system.depth, 1))
    expected = model.simulate(u) - model.simulate(0.0 * u)
    response = equation.system.run(u, start) - equation.system.run(0.0 * u, start)
    assert response == pytest.approx(expected, abs=1e-6)


def test_a_baseline_of_one_rule_is_a_linear_one() -> None:
    train = lag(9)
    models: dict[str, Fitted] = {"arx": ARX(na=1, nb=1, nk=1).fit(train), "linear_lags": OneRule().fit(train)}
    models["ts"] = over_lags(TS(rules=2, na=1, nb=1, nk=2), train)
    compared = compare(models, lag(10), baseline="linear_lags", horizons=["free_run"])
    assert set(compared.entry().rivals) == {"arx"}


def test_a_model_of_one_rule_that_was_asked_for_claims_no_search() -> None:
    found = TS(rules=1, search=EFFORTS["quick"]).fit(lag(1))
    assert found.notes[0] == f"{LINEAR_ENOUGH}one rule was requested, and one rule is a linear model."


@pytest.mark.parametrize("label", ["arx", "oe", "armax", "bj", "statespace", "linear_lags", "linear_ss"])
def test_a_linear_model_is_fitted_again_with_its_orders(label: str) -> None:
    train = lag(3)
    model = linear_rivals()[label].fit(train)
    settings = same_orders(model, NORMAL)
    assert settings is not None
    again = settings.fit(train.with_segments([s.slice(0, 300, DT) for s in train.segments]))
    assert again.structure == model.structure
    if isinstance(model, FittedStateSpace):
        assert isinstance(again, FittedStateSpace)
        assert (again.order, again.delays) == (model.order, model.delays)
    elif isinstance(model, FittedTS):
        assert isinstance(again, FittedTS)
        assert again.layout.n == model.layout.n
        assert model.layout.hidden or again.layout.orders == model.layout.orders
    else:
        assert isinstance(model, FittedLinear)
        assert isinstance(again, FittedLinear)
        assert orders_of(again.system) == orders_of(model.system)
