"""Every file that a version of flysid has written stays readable, and means what it meant."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from flysid import manifest, tabular
from flysid.datasetfile import open_dataset
from flysid.errors import StoreError
from flysid.ingest.lake.lake import open as open_lake
from flysid.model.base import MODEL_VERSION, load
from flysid.model.structures import all_structures
from flysid.validate.runs.judge import judge_run
from flysid.validate.runs.run import RUN_VERSION, open_run
from flysid.version import check_version
from tests.released_files import released

MODELS = [path for folder in released() for path in sorted((folder / "models").glob("*.json"))]


@pytest.mark.parametrize("path", MODELS, ids=lambda path: f"{path.parts[-3]}/{path.stem}")
def test_a_released_model_computes_what_it_did(path: Path) -> None:
    model = load(path)
    case = json.loads((path.parents[1] / "expected.json").read_text())[path.name]
    u = np.array(case["u"])
    y = np.array(case["y"])
    assert np.allclose(model.simulate(u, y[: model.n_init]), case["free_run"], rtol=1e-6, atol=1e-9)
    assert np.allclose(np.nan_to_num(model.predict(u, y)), case["one_step"], rtol=1e-6, atol=1e-9)
    assert model.rules()


@pytest.mark.parametrize("folder", released(), ids=lambda folder: folder.name)
def test_released_data_and_runs_are_read(folder: Path) -> None:
    dataset = open_dataset(folder / "dataset.parquet").read()
    assert [len(s) for s in dataset.segments] == [50, 50]
    lake = open_lake(folder / "data")
    assert all(lake.flight(m.id).rows == m.rows > 0 for m in lake.flights)
    run = open_run(folder / "run")
    judgement = judge_run(run, folder / "data")
    stored = json.loads((folder / "run" / "report" / "report.json").read_text())
    for name, comparison in judgement.comparisons.items():
        for output, entry in comparison.verdict.items():
            assert str(entry.verdict), (name, output)
    assert set(stored["channels"])


def test_the_present_formats_are_among_the_released() -> None:
    newest = released()[-1]
    models = {json.loads(path.read_text())["version"] for path in (newest / "models").glob("*.json")}
    stated = {
        "model": max(models),
        "run": json.loads((newest / "run" / "run.json").read_text())["version"],
        "data": json.loads((newest / "data" / "flysid-data.json").read_text())["version"],
        "dataset": json.loads(pq.read_schema(newest / "dataset.parquet").metadata[tabular.META])["version"],
    }
    present = {
        "model": MODEL_VERSION,
        "run": RUN_VERSION,
        "data": manifest.VERSION,
        "dataset": tabular.VERSION,
    }
    assert stated == present, "a new format version needs: python -m tests.released_files"


def test_every_structure_of_the_released_files_is_still_there() -> None:
    assert {json.loads(path.read_text())["structure"] for path in MODELS} <= set(all_structures())


@pytest.mark.parametrize("stated", [None, 0, -1, "1", 1.5, True, [1]])
def test_what_is_no_version_is_damage(stated: object) -> None:
    with pytest.raises(StoreError, match="damaged"):
        check_version(stated, 3, "model file", "x.json")


def test_a_newer_version_names_the_upgrade_and_an_older_one_is_read() -> None:
    assert check_version(2, 3, "run", "x") == 2
    with pytest.raises(StoreError, match="newer flysid; this one reads up to 3") as raised:
        check_version(4, 3, "run", "x")
    assert "upgrade" in raised.value.hint
