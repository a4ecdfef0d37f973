"""Hostile and hopeless input, a few trials of each kind; `make soak` makes the many."""

from __future__ import annotations

import json
from pathlib import Path

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
    document = json.loads(TS.read_text())
    inner = document
    for key in spot[:-1]:
        inner = inner[key]
    inner[spot[-1]] = value
    (tmp_path / "m.json").write_text(json.dumps(document))
    with pytest.raises(StoreError, match="damaged model file"):
        load(tmp_path / "m.json")


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
