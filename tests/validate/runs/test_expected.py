"""The fields that --fail-if is tried on before the work are those of the document after it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from flysid.dataset import Dataset
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.validate.compare.models import sides_of, with_references
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.document import to_json
from flysid.validate.runs.expected import expected_document
from tests.fakes import FirstOrder, fields_of, flown
from tests.validate.show.page.test_report_mimo import flights

ARX_MODEL = FirstOrder(a=0.9, b=0.08)
TS_MODEL = FirstOrder(a=0.9, b=0.1, structure="ts", labels=("R1", "R2"))
TEST = flown(TS_MODEL, [200] * 3, noise=0.02)


def of_models(models: Mapping[str, Fitted], test: Dataset) -> tuple[dict[str, Any], dict[str, Any]]:
    """The document that is expected, and the one that is."""
    c = compare(models, test)
    expected = expected_document({"c": (models, sides_of(models, c.baseline))}, {})
    return expected["channels"], to_json({"c": c})["channels"]


@pytest.mark.parametrize(
    "models",
    [
        {"arx": ARX_MODEL, "oe": replace(ARX_MODEL, structure="oe", b=0.09), "ts": TS_MODEL},
        {"ts": TS_MODEL, "arx": ARX_MODEL},
        {"arx": ARX_MODEL},
        {"ts": TS_MODEL, "ts_ss": replace(TS_MODEL, structure="ts_ss")},
    ],
    ids=["fuzzy and rivals", "fuzzy first", "one", "no linear one"],
)
def test_the_fields_are_those_of_the_document(models: Mapping[str, Fitted]) -> None:
    expected, found = of_models(with_references(models, TEST), TEST)
    assert fields_of(expected) == fields_of(found)


def test_every_output_of_a_channel_has_its_fields() -> None:
    model = ARX(na=1, nb=1, nk=1, refine=False).fit(flights(3, 0))
    expected, found = of_models({"arx": model}, flights(6, 1))
    assert list(expected) == ["c/v_x", "c/v_y"]
    assert fields_of(expected) == fields_of(found)
