"""Polynomial NARX: terms are found, named and fitted on the free run; no free run leaves its limits."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from bench.polynarx import of_many_signals
from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import UsageError
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.narx.fitted_polynomial import FittedPolyNARX, Units, from_dict
from flysid.model.narx.polynomial_terms import (
    Factor,
    SeenRange,
    Term,
    continued,
    depth_of,
    meaning,
    table_of,
    term_name,
)
from flysid.model.narx.simulation_fit import TermFit
from flysid.model.narx.term_search import linear_terms, spread
from flysid.model.polynarx import PolyNARX
from flysid.validate.runs.run import FitSettings
from flysid.validate.runs.wanted_models import estimators
from tests.model_examples import data, fitted

V = Signal("v", "m/s")
U = Signal("u")
SPEED = Factor(0, 1)
SIZE = Factor(0, 1, form="magnitude")
ZERO = np.zeros(2)


def dragged(rows: int = 600, noise: float = 0.02, seed: int = 0) -> Dataset:
    """A speed that square drag brakes, under random steps."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, rows // 20), 20)
    v = np.zeros(rows)
    for k in range(1, rows):
        v[k] = 0.95 * v[k - 1] + 0.2 * u[k - 1] - 0.08 * abs(v[k - 1]) * v[k - 1]
    return Dataset.from_arrays(u, v + noise * rng.normal(size=rows), 0.05, inputs=["u"], outputs=[V])


def small() -> FittedPolyNARX:
    model = fitted("polynarx")
    assert isinstance(model, FittedPolyNARX)
    return model


def test_drag_is_found_named_and_its_interval_holds_it() -> None:
    model = PolyNARX(na=1, nb=1, nk=1, most_terms=2).fit(dragged())
    assert isinstance(model, FittedPolyNARX)
    told = {c.regressor: c for c in model.coefficients()}
    drag = told["|v(k-1)| v(k-1)"]
    assert abs(drag.value + 0.08) <= 2.0 * drag.half_width < 0.04
    (note,) = [n for n in model.notes if "drag, growing with the square of v" in n]
    assert note.startswith("v: adds -0.08")
    assert "|v(k-1)| v(k-1)" in model.rules()[0].conclusion


def same_but_for_notes(model: Fitted, other: Fitted) -> bool:
    return {**model.to_dict(), "notes": []} == {**other.to_dict(), "notes": []}


def test_of_a_linear_plant_the_linear_model_comes_out_parameter_for_parameter() -> None:
    model = PolyNARX(na=2, nb=2, nk=1, most_terms=2).fit(data(noise=0.05))
    assert same_but_for_notes(model, ARX(na=2, nb=2, nk=1).fit(data(noise=0.05)))
    assert model.notes[0] == "A linear model is enough: no term helps on held-out data."


def test_without_held_out_data_no_term_is_looked_for() -> None:
    model = PolyNARX(na=1, nb=1, nk=1).fit(dragged(40))
    assert same_but_for_notes(model, ARX(na=1, nb=1, nk=1).fit(dragged(40)))
    assert "no part of the data is held out" in model.notes[0]


def test_deep_lags_are_searched_on_long_pieces() -> None:
    """Once, long data with a long dead time were cut into pieces too short for any free run."""
    found = spread(dragged(13_000), 6000, 4000)
    assert [len(s) for s in found.segments] == [4000]
    assert len(spread(dragged(13_000), 6000, 20).segments) > 1


def problem(runs: tuple[FloatArray, ...], terms: list[Term], seen: SeenRange | None = None) -> TermFit:
    limits = np.array([[-9.0, -9.0], [9.0, 9.0]])
    return TermFit(runs, table_of(terms, seen), limits, depth_of(terms), depth_of(terms, 2))


NARROW = SeenRange(*(0.05 * np.array([[-1.0] * 3, [1.0] * 3]) for _ in range(2)))


@pytest.mark.parametrize("seen", [None, NARROW])
def test_sensitivities_equal_differences_of_the_free_run(seen: SeenRange | None) -> None:
    rng = np.random.default_rng(1)
    runs = tuple(rng.uniform(-1.0, 1.0, (40, 3)) for _ in range(2))
    change = Factor(1, 1, change=True)
    terms = [
        Term(0, (SPEED,)),
        Term(0, (Factor(2, 0),)),
        Term(0, (SIZE, change)),
        Term(1, (Factor(1, 1), Factor(1, 1), SPEED)),
        Term(1, (Factor(2, 1), Factor(1, 2, form="magnitude"))),
        Term(1, ()),
        Term(1, (SPEED, SPEED)),
    ]
    theta = np.array([0.6, 0.3, -0.2, -0.3, 0.2, 0.1, 0.0])
    if seen is not None:
        held, theta = continued(terms, theta)
        terms = list(held)
    error = problem(runs, terms, seen)
    p = np.concatenate([theta, error.measured_starts + 0.1])
    cost, matrix, gradient = error.normal_equations(p)
    assert cost == pytest.approx(error.cost(p))
    steps = 1e-6 * np.eye(len(p))
    slopes = [(error.cost(p + step) - error.cost(p - step)) / 4e-6 for step in steps]
    assert gradient == pytest.approx(np.array(slopes), abs=1e-6)
    assert (matrix.diagonal() > 0.0).all()


def test_a_polynomial_that_runs_away_is_held_and_told_of() -> None:
    terms = [Term(0, (SPEED,)), Term(0, (SPEED, SPEED, SPEED)), Term(1, (Factor(2, 1),))]
    runs = (np.full((50, 3), 1.5),)
    error = problem(runs, terms)
    assert error.cost(np.array([1.1, 0.5, 0.1, *error.measured_starts])) == np.inf


def beyond(model: FittedPolyNARX, row: list[float]) -> float:
    """What the model makes of one row, which is v and u, in one step."""
    return float(model.simulate(np.array([[row[1]], [0.0]]), np.array([[row[0]]]))[1, 0])


def test_beyond_its_training_a_polynomial_goes_on_along_its_tangents() -> None:
    """By hand: of v^2 |u| what v = 2, u = -3 make, where v was in -1 to 1 and u in -1 to 2."""
    terms = (Term(0, (SPEED,)), Term(0, (SPEED, SPEED, Factor(1, 1, form="magnitude"))))
    plain = replace(
        small(),
        output_limits=np.array([[-99.0], [99.0]]),
        terms=terms,
        theta=np.array([0.5, 0.1]),
        covariance=np.zeros((2, 2)),
        units=Units(np.zeros(2), np.ones(2), 1),
        seen=None,
    )
    seen = SeenRange(np.array([[-1.0, -1.0], [1.0, 2.0]]), np.zeros((2, 2)))
    held = replace(plain, seen=seen)
    assert beyond(plain, [2.0, -3.0]) == pytest.approx(0.5 * 2.0 + 0.1 * 4.0 * 3.0)
    edge, along_v, along_u = 1.0, 2.0 * 1.0, 1.0 * 2.0
    assert beyond(held, [2.0, -3.0]) == pytest.approx(0.5 * 2.0 + 0.1 * (edge + along_v + along_u))
    for row in ([1.0, 2.0], [-1.0, -1.0], [0.3, -0.7]):
        assert beyond(held, row) == beyond(plain, row)
    u, y = np.array([[-3.0], [0.0]]), np.array([[2.0], [0.0]])
    assert held.predict(u, y)[1, 0] == beyond(held, [2.0, -3.0])
    copy = from_dict(json.loads(json.dumps(held.to_dict())))
    assert beyond(copy, [2.0, -3.0]) == beyond(held, [2.0, -3.0])


def test_inside_its_training_range_a_polynomial_computes_what_its_terms_say_to_the_bit() -> None:
    model = small()
    free = replace(model, seen=None)
    (segment,) = data(drag=0.5, noise=0.002).segments[:1]
    assert model.seen is not None
    assert np.array_equal(model.free_run(segment), free.free_run(segment))
    far = replace(segment, u=4.0 * segment.u)
    assert not np.array_equal(model.free_run(far), free.free_run(far))


def test_gains_find_the_term_that_is_missing() -> None:
    rng = np.random.default_rng(2)
    W = np.zeros((400, 3))
    W[:, 2] = rng.normal(size=400)
    for k in range(1, 400):
        W[k, 0] = 0.8 * W[k - 1, 0] + 0.3 * W[k - 1, 2] - 0.1 * W[k - 1, 0] ** 3
    further = [
        Term(0, (SIZE,)),
        Term(0, (SPEED, SPEED)),
        Term(0, (SPEED,) * 3),
        Term(0, (SPEED, Factor(2, 1))),
    ]
    terms = [Term(0, (SPEED,)), Term(0, (Factor(2, 1),)), Term(1, ()), *further]
    error = problem((W,), terms)
    p = np.concatenate([[0.7, 0.3, 0.0], np.zeros(len(further)), error.measured_starts])
    assert int(np.argmax(error.gains(p, 3))) == 2


def test_slow_disturbances_of_a_linear_plant_of_many_signals_are_not_taken_for_terms() -> None:
    """Of 450 on offer one followed them on held-out blocks, too, and ran 2.4 times as far off elsewhere."""
    train, _, _ = of_many_signals("linear", 515)
    assert same_but_for_notes(PolyNARX().fit(train), ARX().fit(train))


@pytest.mark.parametrize("name", ["arx", "arx, refined, two inputs and outputs", "arx, coupled outputs"])
def test_a_linear_model_as_terms_predicts_the_same(name: str) -> None:
    linear = fitted(name)
    dataset = data(len(linear.inputs), len(linear.outputs))
    units = Units.of(dataset)
    terms, theta = linear_terms(linear, units)  # type: ignore[arg-type]
    limits = linear.output_limits
    nothing = np.full((len(terms), len(terms)), np.nan)
    model = FittedPolyNARX(linear.dt_s, linear.inputs, linear.outputs, limits, terms, theta, nothing, units)
    s = dataset.segments[0]
    first = np.zeros((model.n_init, len(linear.outputs)))
    assert np.isfinite(model.simulate(s.u, first)).all()
    system = linear.system  # type: ignore[attr-defined]
    assert np.allclose(model.linearised.a, system.a)
    assert np.allclose(model.linearised.b[: len(system.b)], system.b)


@pytest.mark.parametrize(
    ("factors", "coefficient", "words"),
    [
        ((SIZE, SPEED), -1.0, "drag, growing with the square of v"),
        ((SPEED, SPEED, SPEED), -1.0, "drag, growing with the cube of v"),
        ((Factor(0, 1, form="sign"),), -1.0, "dry friction, by the sign of v"),
        ((Factor(0, 1, form="sign"),), 1.0, "a push, by the sign of v"),
        ((SPEED, SPEED), 1.0, "the same on both sides, growing with the square of v"),
        ((SIZE,), 1.0, "the same on both sides, growing with the size of v"),
        ((Factor(1, 2), SPEED), 1.0, "the effect of u depends on v"),
        ((Factor(0, 1, change=True), SPEED), 1.0, "the effect of the change of v depends on v"),
    ],
)
def test_what_a_term_does_is_said(factors: tuple[Factor, ...], coefficient: float, words: str) -> None:
    assert meaning(Term(0, factors), coefficient, (V, U)) == words


def test_a_place_is_pulled_back() -> None:
    said = meaning(Term(0, (SPEED,) * 3), -1.0, (Signal("x", "m"), U))
    assert said == "a pull back, as of a spring that hardens, growing with the cube of x"


def test_terms_have_names() -> None:
    change = Factor(0, 1, change=True)
    assert term_name(Term(0, (SPEED, SPEED, change)), (V, U), ZERO) == "v(k-1)^2 (v(k-1) - v(k-2))"
    assert (
        term_name(Term(0, (Factor(1, 0, form="sign"),)), (V, U), np.array([0.0, 2.5])) == "sign(u(k) - 2.5)"
    )
    assert term_name(Term(0, ()), (V, U), ZERO) == "1"


@pytest.mark.parametrize(
    "damage",
    [
        {"terms": []},
        {"terms": [{"equation": 0, "factors": [[9, 1, False, "plain"]]}]},
        {"terms": [{"equation": 0, "factors": [[0, 0, False, "plain"]]}]},
        {"terms": [{"equation": 0, "factors": [[0, 1, False, "cube"]]}]},
        {"terms": [{"equation": 3, "factors": []}]},
        {"terms": [{"equation": 0, "factors": [[0, 1, False, "plain"]] * 4}]},
        {"scale": [0.0, 1.0]},
        {"covariance": [[1.0]]},
        {"seen": [[[0.1, 0.0], [1.0, 1.0]], [[0.0, 0.0], [1.0, 1.0]]]},
        {"seen": [[[-1.0, -1.0], [1.0, 1.0]]]},
    ],
)
def test_a_forged_file_is_refused(damage: dict[str, object]) -> None:
    document = json.loads(json.dumps(small().to_dict()))
    with pytest.raises((ValueError, KeyError, TypeError)):
        from_dict(document | damage)


def test_settings_that_cannot_be_are_refused() -> None:
    with pytest.raises(UsageError, match="most_terms is a whole number from 0 on, not -1"):
        PolyNARX(most_terms=-1).fit(data())


def test_a_run_offers_it_by_name() -> None:
    assert "polynarx" in estimators(FitSettings(models=("polynarx",)))
