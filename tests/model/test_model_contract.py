"""The laws of flysid.model.base, tried on one small fitted model of every structure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import FloatArray, Segment
from flysid.errors import UsageError
from flysid.model.base import Fitted, load
from flysid.model.structures import all_structures
from tests.model_examples import EXAMPLES, SCALING_TOLERANCE, fitted, scaled

ROWS = 80


def signals(model: Fitted, seed: int) -> tuple[FloatArray, FloatArray]:
    """Inputs and outputs like the training data's, with offsets and noise, not from the plant."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, (ROWS, len(model.inputs)))
    low, high = model.output_limits
    y = rng.uniform(0, 1, (ROWS, len(model.outputs))) * (high - low) / 3 + low + (high - low) / 3
    return u, y


every_model = pytest.mark.parametrize("name", EXAMPLES)
seeds = st.integers(0, 2**31)


def test_every_structure_has_an_example() -> None:
    tried = {fitted(name).structure for name in EXAMPLES}
    assert set(all_structures()) <= tried


@every_model
def test_a_free_run_starts_from_a_window_and_keeps_to_the_limits(name: str) -> None:
    model = fitted(name)
    u, y = signals(model, 3)
    run = model.free_run(Segment(u, y))  # type: ignore[attr-defined]
    low, high = model.output_limits
    assert run.shape == y.shape
    assert np.isfinite(run).all()
    assert ((run[model.n_init :] >= low) & (run[model.n_init :] <= high)).all()


@every_model
@pytest.mark.parametrize("arrays", [np.zeros((50, 1)), None, [1.0, 2.0]])
def test_what_is_no_dataset_is_refused_in_words(name: str, arrays: object) -> None:
    build: Any = EXAMPLES[name][0]
    with pytest.raises(UsageError, match="fitted to a dataset, not to") as caught:
        build(arrays)
    assert "from_arrays" in str(caught.value)


@every_model
@settings(deadline=None, max_examples=10)
@given(seed=seeds)
def test_results_are_finite_where_defined_and_pure(name: str, seed: int) -> None:
    model = fitted(name)
    u, y = signals(model, seed)
    before = u.copy(), y.copy()
    for k in (1, 2, 7):
        first = model.predict(u, y, k)
        blank = model.n_init + k - 1
        assert np.isnan(first[:blank]).all()
        assert np.isfinite(first[blank:]).all()
        assert np.array_equal(first, model.predict(u, y, k), equal_nan=True)
    run = model.simulate(u, y[: model.n_init])
    assert run.shape == y.shape
    assert np.isfinite(run).all()
    assert np.array_equal(run, model.simulate(u, y[: model.n_init]))
    assert np.isfinite(model.simulate(u)).all()
    assert np.array_equal(u, before[0])
    assert np.array_equal(y, before[1])


@every_model
@settings(deadline=None, max_examples=10)
@given(seed=seeds, row=st.integers(0, ROWS - 1), k=st.integers(1, 6))
def test_causality(name: str, seed: int, row: int, k: int) -> None:
    """Changing the future changes nothing before it."""
    model = fitted(name)
    u, y = signals(model, seed)
    later_u = u.copy()
    later_y = y.copy()
    later_u[row + 1 :] += 0.3
    later_y[max(row - k + 1, 0) :] += 0.1
    a = model.predict(u, y, k)
    b = model.predict(later_u, later_y, k)
    assert np.array_equal(a[: row + 1], b[: row + 1], equal_nan=True)
    n = model.n_init
    early = model.simulate(u, y[:n])
    assert np.array_equal(early[: row + 1], model.simulate(later_u, y[:n])[: row + 1]) or row < n
    assert np.array_equal(early, model.simulate(u, y))  # rows of y after the first n_init are not read


@pytest.mark.parametrize("name", ["iv", "oe", "bj"])
def test_what_a_free_run_leaves_over_has_a_model(name: str) -> None:
    """So that predictions lean on the newest error."""
    noise = fitted(name).noise  # type: ignore[attr-defined]
    assert noise is not None
    assert (noise[0] == 1.0).all()


@every_model
def test_the_beginning_of_a_record_is_predicted_as_the_whole(name: str) -> None:
    """Records just as long as what a model looks back on, and shorter, too."""
    model = fitted(name)
    u, y = signals(model, 7)
    n = model.n_init
    whole, run = model.predict(u, y, 2), model.simulate(u, y[:n])
    size = 1e-9 * np.abs(run).max()
    for rows in range(max(n, 1), n + 7):
        begun = model.simulate(u[:rows], y[:n])
        np.testing.assert_allclose(begun, run[:rows], rtol=0.0, atol=size)
        np.testing.assert_allclose(model.predict(u[:rows], y[:rows], 2), whole[:rows], rtol=0.0, atol=size)


@every_model
@settings(deadline=None, max_examples=10)
@given(seed=seeds)
def test_a_simulation_starts_with_the_measured_rows(name: str, seed: int) -> None:
    model = fitted(name)
    u, y = signals(model, seed)
    assert np.array_equal(model.simulate(u, y[: model.n_init])[: model.n_init], y[: model.n_init])


@every_model
@settings(deadline=None, max_examples=10)
@given(seed=seeds, size=st.floats(1, 1e6))
def test_a_simulation_saturates_at_the_output_limits(name: str, seed: int, size: float) -> None:
    model = fitted(name)
    u, y = signals(model, seed)
    run = model.simulate(size * u, y[: model.n_init])[model.n_init :]
    assert (run >= model.output_limits[0]).all()
    assert (run <= model.output_limits[1]).all()


@every_model
def test_a_stored_model_gives_the_same_bits(name: str, tmp_path: Path) -> None:
    model = fitted(name)
    u, y = signals(model, 1)
    model.save(tmp_path / "model.json")
    again = load(tmp_path / "model.json")
    assert again.to_dict() == json.loads(json.dumps(model.to_dict()))
    assert np.array_equal(again.simulate(u, y[: model.n_init]), model.simulate(u, y[: model.n_init]))
    for k in (1, 5):
        assert np.array_equal(again.predict(u, y, k), model.predict(u, y, k), equal_nan=True)
    assert again.notes == model.notes
    assert again.n_parameters == model.n_parameters


@every_model
def test_other_units_scale_the_predictions(name: str) -> None:
    a = -1000.0
    b = 0.001
    build, dataset = EXAMPLES[name]
    model = fitted(name)
    other = build(scaled(dataset, a, b))
    segment = dataset.segments[0]
    n = model.n_init
    allowed = SCALING_TOLERANCE.get(name, 1e-6) * np.ptp(segment.y)
    assert other.n_init == n
    y = segment.y
    run = model.simulate(segment.u, y[:n])
    other_run = other.simulate(a * segment.u, b * y[:n])
    assert np.abs(other_run / b - run).max() < allowed
    one = model.predict(segment.u, y, 1)[n:]
    other_one = other.predict(a * segment.u, b * y, 1)[n:]
    assert np.abs(other_one / b - one).max() < allowed


@every_model
def test_rules_and_firing_fit_each_other(name: str) -> None:
    model = fitted(name)
    u, y = signals(model, 2)
    rules = model.rules()
    strength = model.firing(u, y)
    assert strength.shape == (ROWS, len(rules))
    assert strength.sum(axis=1) == pytest.approx(np.ones(ROWS))
    assert sum(r.support for r in rules) == pytest.approx(1.0)
    for rule in rules:
        assert rule.condition
        assert rule.conclusion
        assert rule.dc_gain.shape == (len(model.outputs), len(model.inputs))


@every_model
def test_a_model_says_something_about_itself(name: str) -> None:
    model = fitted(name)
    assert model.n_parameters >= (model.structure != "persistence")
    assert len(str(model)) > 40
    assert all(isinstance(note, str) and note for note in model.notes)
