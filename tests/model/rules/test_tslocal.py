"""Local views, certificates, explanations, updates and exports of TS models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.model.rules.explanation import explain, outside_share
from flysid.model.rules.fitted import to_nonlinear_system
from flysid.model.ts import TS, FittedTS, over_lags
from tests.bent_plant import flight

DT = 0.05


@pytest.fixture(scope="module")
def model() -> FittedTS:
    return over_lags(
        TS(rules=3, na=2, nb=2, nk=1, antecedents=["y(k-1)"], iterations=10),
        Dataset.from_arrays(*flight(1200, 1), DT),
    )


def test_the_blend_of_the_polytope_is_the_model(model: FittedTS) -> None:
    u, y = flight(60, 2)
    rules = model.polytope()
    phi = model.firing(u, y)
    one = model.one_step(u, y)
    k = 30
    x = np.array([y[k - 1], y[k - 2], u[k - 1], u[k - 2]])
    blend = sum(p * (s.C @ x + s.D @ [u[k]] + s.g) for p, s in zip(phi[k], rules, strict=True))
    assert blend == pytest.approx(one[k], abs=1e-12)
    nxt = rules[0].A @ x + rules[0].B @ [u[k]] + rules[0].f
    assert nxt[1:] == pytest.approx([y[k - 1], u[k], u[k - 1]])


def test_linearisation_predicts_small_steps(model: FittedTS) -> None:
    local = model.linearise({model.inputs[0].name: 0.2, model.outputs[0].name: 0.1})
    u = np.full(8, 0.2)
    y = np.full(8, 0.1)
    base = model.one_step(u, y)[-1, 0]
    y2 = y.copy()
    y2[-2] += 1e-4
    assert model.one_step(u, y2)[-1, 0] - base == pytest.approx(1e-4 * local.C[0, 0], rel=1e-3)


def test_linearise_takes_signals_by_name_and_means_for_the_rest(model: FittedTS) -> None:
    u = model.inputs[0].name
    y = model.outputs[0].name
    mean_y, mean_u = model.layout.shift
    for at, u_at, y_at in (({u: 0.2, y: 0.1}, 0.2, 0.1), ({u: 0.2}, 0.2, mean_y), ({}, mean_u, mean_y)):
        expected = model.linearise({u: u_at, y: y_at})
        assert np.array_equal(model.linearise(at).A, expected.A)
    with pytest.raises(UsageError, match="no signal 'speed'"):
        model.linearise({"speed": 1.0})
    for value in ("fast", np.nan, None):
        with pytest.raises(UsageError, match="is not an operating point"):
            model.linearise({y: value})  # type: ignore[dict-item]
    with pytest.raises(UsageError, match="is saturated"):
        model.linearise({y: 1e3})


def test_a_certificate_is_a_proof(model: FittedTS) -> None:
    found = model.certificate()
    rules = [s.A[:2, :2] for s in model.polytope()]
    assert found.proved
    assert found.decay < 1.0
    assert np.linalg.eigvalsh(found.P).min() > 0
    for A in rules:
        assert np.linalg.eigvalsh(found.P - A.T @ found.P @ A).min() > 0


def test_an_unstable_rule_is_named(model: FittedTS) -> None:
    theta = model.parameters.theta.copy()
    theta[1, 0, 0] += 1.0
    wild = replace(model, parameters=model.parameters._replace(theta=theta))
    found = wild.certificate()
    assert not found.proved
    assert "R2" in found.reason


def test_an_explanation_adds_up(model: FittedTS) -> None:
    u, y = flight(60, 2)
    told = explain(model, u, y, 40)
    assert sum(v.share for v in told.voices) == pytest.approx(1.0)
    assert [v.share for v in told.voices] == sorted((v.share for v in told.voices), reverse=True)
    mean = sum(v.share * v.output[0] for v in told.voices)
    assert mean == pytest.approx(told.output[0])
    assert told.antecedents["y(k-1)"] == pytest.approx(y[39])
    assert "has weight" in str(told)
    assert told.outside == ()
    far = explain(model, u, y + 100, 40)
    assert far.outside == ("y(k-1)",)
    assert outside_share(model, u, y + 100) == 1.0
    for row in (0, 60, "last"):
        with pytest.raises(UsageError, match="cannot be explained"):
            explain(model, u, y, row)  # type: ignore[arg-type]


def test_what_lies_outside_the_training_range_is_said_from_its_end_on(model: FittedTS) -> None:
    """The memberships go on a quarter beyond; that is no reason to call those samples seen."""
    u, y = flight(1200, 1)
    assert model.trained_range[:, 0] == pytest.approx([y[1:-1].min(), y[1:-1].max()])
    assert outside_share(model, u, y) == 0.0
    top = int(y[1:-1].argmax()) + 2
    assert explain(model, u, y, top).outside == ()
    beyond = y.copy()
    beyond[top - 1] += 0.02 * np.ptp(y)
    assert explain(model, u, beyond, top).outside == ("y(k-1)",)
    assert outside_share(model, u, beyond) > 0.0


def test_python_control_follows_the_free_run(model: FittedTS) -> None:
    control = pytest.importorskip("control")
    u, _ = flight(20, 3)
    d = model.n_init
    system = to_nonlinear_system(model)
    run = model.simulate(u)  # from rest: no estimated start
    x0 = np.concatenate([run[d - 1 :: -1, 0][:d], u[d - 1 :: -1][:d]])
    answer = control.input_output_response(system, DT * np.arange(20 - d), u[d:], x0)
    assert np.allclose(np.ravel(answer.outputs), run[d:, 0], atol=1e-9)
