"""The published JSON schema of models: every structure's saved file keeps it, and a changed one does not."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from flysid.model.structures import all_structures
from tests.model_examples import EXAMPLES, fitted

SCHEMA = Path("docs/reference/model.schema.json")


@cache
def validator() -> Any:
    schema = json.loads(SCHEMA.read_text("utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def saved(name: str) -> str:
    return json.dumps(fitted(name).to_dict(), allow_nan=False)


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_every_structure_keeps_the_schema(name: str) -> None:
    assert [e.message for e in validator().iter_errors(json.loads(saved(name)))] == []


def test_the_schema_names_every_structure() -> None:
    told = {json.loads(saved(name))["structure"] for name in EXAMPLES}
    text = SCHEMA.read_text("utf-8")
    assert told <= set(all_structures())
    assert all(f'"{name}"' in text for name in told)


@pytest.mark.parametrize(
    "change", [{"dt_s": -0.02}, {"a": "none"}, {"more": 1}, {"format": "other"}, {"structure": "unknown"}]
)
def test_a_changed_file_does_not_keep_it(change: dict[str, Any]) -> None:
    document = json.loads(saved("arx")) | change
    assert list(validator().iter_errors(document))
    del document[next(iter(change))]
    if "more" not in change:
        assert list(validator().iter_errors(document))
