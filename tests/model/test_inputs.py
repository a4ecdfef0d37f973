"""Hostile and hopeless input, a few trials of each kind; `make soak` makes the many."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from flysid.errors import StoreError
from flysid.model.base import load
from tests.injection_trials import FIELDS, injections
from tests.input_trials import hopeless_data, hostile_models, leaks, wild_models
from tests.released_files import released

TS = released()[-1] / "models" / "ts.json"


def test_hostile_model_files_are_refused_or_harmless(tmp_path: Path) -> None:
    outcome = hostile_models(tmp_path, 100)
    assert outcome.failures == []
    assert outcome.raised > 50


@pytest.mark.parametrize(
    "spot", [("antecedents", 0, 0), ("antecedents", 0, 1), ("na",), ("nb", 0), ("nk", 0)]
)
@pytest.mark.parametrize("value", [-7, 10**6, 2**63])
def test_indices_beyond_the_data_never_reach_compiled_code(
    tmp_path: Path, spot: tuple[str | int, ...], value: int
) -> None:
    (tmp_path / "m.json").write_text(json.dumps(forged(TS, spot, value)))
    with pytest.raises(StoreError, match="damaged model file"):
        load(tmp_path / "m.json")


@pytest.mark.parametrize(
    ("name", "spot", "value", "what"),
    [
        ("arx", ("a", 0, 0, 0), 0, "a does not begin with 1"),
        ("arx_coupled_outputs", ("a", 0, 0, 1), 0.5, "a does not begin with 1"),
        ("tf", ("a", 0, 0, 0), 1e9, "a does not begin with 1"),
        ("oe", ("noise", 0, 0), 0, "noise does not begin with 1"),
        ("armax", ("ma", 0, 0), 0, "ma does not begin with 1"),
        ("statespace_refined_two_inputs_and_outputs", ("noise", 0, 1), 0, "noise does not begin with 1"),
        ("ts", ("noise", 0, 0), -7, "noise does not begin with 1"),
        ("ts_ss", ("noise", 0, 0), 0, "noise does not begin with 1"),
        ("arx", ("free", 0), -1, "free holds places"),
        ("arx", ("free", 0), 6, "free holds places"),
        ("arx", ("free", 0), 1, "free holds places"),
    ],
)
def test_what_a_model_divides_by_and_points_to_is_looked_at(
    tmp_path: Path, name: str, spot: tuple[str | int, ...], value: float, what: str
) -> None:
    path = tmp_path / f"{name}.json"
    path.write_text(json.dumps(forged(TS.with_name(path.name), spot, value)))
    with pytest.raises(StoreError, match=what) as caught:
        load(path)
    assert caught.value.path == str(path)


@pytest.mark.parametrize("factor", [20.0, 1e3, 1e6])
def test_a_state_space_whose_predictor_runs_away_is_refused(tmp_path: Path, factor: float) -> None:
    document = json.loads(TS.with_name("statespace.json").read_text())
    document["k"] = [[factor * value for value in row] for row in document["k"]]
    (tmp_path / "m.json").write_text(json.dumps(document))
    with pytest.raises(StoreError, match="its predictor is not stable"):
        load(tmp_path / "m.json")


@pytest.mark.filterwarnings("ignore")
def test_a_state_space_whose_numbers_overflow_predicts_finite_numbers(tmp_path: Path) -> None:
    document = forged(TS.with_name("statespace.json"), ("gains", 1, 0, 0), 1e308)
    (tmp_path / "m.json").write_text(json.dumps(document))
    model = load(tmp_path / "m.json")
    rng = np.random.default_rng(4)
    u = 10.0 * rng.standard_normal((200, len(model.inputs)))
    y = model.output_limits.mean(axis=0) + 10.0 * rng.standard_normal((200, len(model.outputs)))
    assert np.isfinite(model.predict(u, y)[model.n_init :]).all()
    assert np.isfinite(model.simulate(u, y[: model.n_init])).all()


def forged(path: Path, spot: tuple[str | int, ...], value: object) -> object:
    """The model file's document with another value in one place."""
    document = json.loads(path.read_text())
    inner = document
    for key in spot[:-1]:
        inner = inner[key]
    inner[spot[-1]] = value
    return document


@pytest.mark.filterwarnings("ignore")
def test_data_that_cannot_answer_is_told_so() -> None:
    outcome = hopeless_data(shapes=6)
    assert outcome.failures == []
    assert outcome.raised >= 6


@pytest.mark.filterwarnings("ignore")
def test_divergence_is_said_and_numbers_stay_finite() -> None:
    outcome = wild_models(25)
    assert outcome.failures == []


def test_a_copied_flight_is_found_by_content() -> None:
    assert leaks(10).failures == []


def test_strings_in_reports_stay_strings() -> None:
    outcome = injections(step=len(FIELDS))  # every text in one field
    assert outcome.failures == []
    assert outcome.trials == 4
