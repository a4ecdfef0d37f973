"""Consequents from disk: the numbers of a fit in memory, and those of a plain least-squares solution."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.ts_intervals import experiment, known_model
from flysid import datasetfile
from flysid.dataset import Dataset
from flysid.datasetfile import DatasetFile, open_dataset, write_dataset
from flysid.errors import DataError, UsageError
from flysid.model.rules.consequents import refit_consequents
from flysid.model.rules.fitted import FittedTS
from flysid.model.static_ts import StaticTS


@pytest.fixture(scope="module")
def model() -> FittedTS:
    return known_model()


@pytest.fixture(scope="module")
def whole(model: FittedTS) -> Dataset:
    return experiment(model, 1)


@pytest.fixture
def stored(whole: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> DatasetFile:
    monkeypatch.setattr(datasetfile, "ROWS_PER_GROUP", 333)
    write_dataset(tmp_path / "data.parquet", whole)
    return open_dataset(tmp_path / "data.parquet")


def test_dynamic_consequents_from_disk_are_those_from_memory(
    model: FittedTS, stored: DatasetFile, whole: Dataset
) -> None:
    disk = refit_consequents(model, stored)
    memory = refit_consequents(model, whole)
    assert disk.consequents == pytest.approx(memory.consequents, rel=1e-9)
    assert "1499 samples" in disk.notes[-1]


def test_they_are_the_least_squares_solution(model: FittedTS, whole: Dataset) -> None:
    [segment] = whole.segments
    fitted = refit_consequents(model, whole)
    W = model.layout.stack(segment.u, segment.y)
    phi = model.firing(segment.u, segment.y)[1:]
    X = np.column_stack([W[:-1, 0], W[:-1, 1], np.ones(len(W) - 1)])
    design = np.hstack([phi[:, [r]] * X for r in range(2)])
    expected = np.linalg.lstsq(design, W[1:, 0], rcond=None)[0].reshape(2, 1, 3)
    assert fitted.parameters.theta == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("method", ["gustafson-kessel", "subtractive"])
def test_a_static_model_from_disk_is_that_from_memory(
    stored: DatasetFile, whole: Dataset, method: str
) -> None:
    settings = StaticTS(rules=3, method=method)  # type: ignore[arg-type]
    disk = settings.fit(stored)
    memory = settings.fit(whole)
    assert disk.consequents == pytest.approx(memory.consequents, rel=1e-9)
    assert np.array_equal(disk.partition.centre, memory.partition.centre)
    assert np.array_equal(disk.output_limits, memory.output_limits)
    assert np.array_equal(disk.support, memory.support)


def test_other_signals_and_short_segments_are_refused(model: FittedTS) -> None:
    with pytest.raises(UsageError, match="the model knows"):
        refit_consequents(model, Dataset.from_arrays(np.zeros((9, 2)), np.zeros(9), model.dt_s))
    with pytest.raises(DataError, match="no segment"):
        refit_consequents(model, Dataset.from_arrays(np.zeros((1, 1)), np.zeros(1), model.dt_s))
    with pytest.raises(DataError, match="6 samples are too few for 6 numbers"):
        refit_consequents(model, Dataset.from_arrays(np.zeros((7, 1)), np.zeros(7), model.dt_s))
