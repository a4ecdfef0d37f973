"""Fits from disk: the numbers of a fit in memory, whatever the blocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flysid import datasetfile
from flysid.dataset import Dataset, FloatArray
from flysid.datasetfile import DatasetFile, open_dataset, write_dataset
from flysid.errors import DataError, UsageError
from flysid.model.arx import ARX
from flysid.model.fir import FIR
from flysid.model.statespace import StateSpace
from flysid.model.stream import Late, blocks_of, delayed_inputs, windows
from tests.model_examples import data

WHOLE = data(2, 2, samples=900, noise=0.05)


@pytest.fixture
def stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> DatasetFile:
    """Two segments in row groups that end anywhere."""
    monkeypatch.setattr(datasetfile, "ROWS_PER_GROUP", 250)
    write_dataset(tmp_path / "data.parquet", WHOLE)
    return open_dataset(tmp_path / "data.parquet")


def close(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.abs(a - b).max() <= 1e-9 * np.abs(b).max())


@pytest.mark.parametrize("estimator", [ARX(na=2, nb=2, nk=1, refine=False), FIR(taps=20)])
def test_polynomials_from_disk_are_those_from_memory(stored: DatasetFile, estimator: ARX | FIR) -> None:
    disk = estimator.fit(stored)
    memory = estimator.fit(WHOLE)
    assert close(disk.flat, memory.flat)
    assert close(disk.covariance, memory.covariance)
    assert np.array_equal(disk.output_limits, memory.output_limits)
    assert disk.n_init == memory.n_init


@pytest.mark.parametrize("method", ["pbsid", "moesp"])
def test_a_state_space_from_disk_is_that_from_memory(stored: DatasetFile, method: str) -> None:
    estimator = StateSpace(order=3, method=method, past=6, refine=False)  # type: ignore[arg-type]
    disk = estimator.fit(stored).realisation
    memory = estimator.fit(WHOLE).realisation
    for power in range(5):
        at = [r.c @ np.linalg.matrix_power(r.a, power) @ np.hstack([r.b, r.k]) for r in (disk, memory)]
        assert close(*at)
    assert close(disk.d, memory.d)


def test_a_delay_from_disk_is_that_in_memory(stored: DatasetFile) -> None:
    late = Late(stored, (3, 7))
    memory = delayed_inputs(WHOLE, (3, 7))
    for number, segment in enumerate(memory.segments):
        found = [(u, y) for n, u, y in late.blocks() if n == number]
        assert np.array_equal(np.concatenate([u for u, _ in found]), segment.u)
        assert np.array_equal(np.concatenate([y for _, y in found]), segment.y)
    assert np.array_equal(late.head(100).segments[0].u, memory.segments[0].u[:100])
    settings = StateSpace(order=3, method="pbsid", past=6, refine=False, nk=(4, 8))
    disk = settings.fit(stored)
    given = settings.fit(WHOLE)
    assert disk.delays == given.delays == (3, 7)
    assert close(disk.dc_gain, given.dc_gain)


def test_choices_are_made_on_the_head_and_said(stored: DatasetFile) -> None:
    assert "one step ahead" in ARX().fit(stored).notes[-1]
    assert ARX().fit(stored).n_parameters == ARX(refine=False).fit(WHOLE).n_parameters
    settings = StateSpace(method="pbsid", past=10, refine=False)
    assert settings.fit(stored).order == settings.fit(WHOLE).order
    with pytest.raises(UsageError, match="needs its data in memory"):
        ARX(refine=True).fit(stored)


def test_intervals_of_the_first_samples_are_not_given_out_for_those_of_all(stored: DatasetFile) -> None:
    settings = StateSpace(order=3, method="pbsid", past=10, refine=False)
    disk = settings.fit(stored)
    memory = settings.fit(WHOLE)
    assert len(memory.covariance)
    assert not len(disk.covariance)
    assert "none (fitted from disk" in str(disk)


def test_the_head_is_the_first_samples_with_their_segments(stored: DatasetFile) -> None:
    head = stored.head(1000)
    assert [len(s) for s in head.segments] == [900, 100]
    assert np.array_equal(head.segments[1].y, WHOLE.segments[1].y[:100])
    assert head.segments[0].flight == WHOLE.segments[0].flight
    assert len(stored.head(10**6)) == len(WHOLE)


def test_a_degenerate_file_takes_the_stable_way(tmp_path: Path) -> None:
    t = np.arange(3000.0)
    smooth = Dataset.from_arrays(np.sin(1e-3 * t) + 1e-3 * np.cos(0.011 * t), np.sin(1e-3 * t + 0.3), 0.01)
    write_dataset(tmp_path / "smooth.parquet", smooth)
    estimator = ARX(na=2, nb=2, nk=1, refine=False)
    disk = estimator.fit(open_dataset(tmp_path / "smooth.parquet"))
    memory = estimator.fit(smooth)
    assert np.abs(disk.predict(*_signals(smooth)) - memory.predict(*_signals(smooth)))[5:].max() < 1e-9


def _signals(dataset: Dataset) -> tuple[FloatArray, FloatArray]:
    return dataset.segments[0].u, dataset.segments[0].y


def test_a_file_with_a_value_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    write_dataset(tmp_path / "a.parquet", WHOLE)
    import pyarrow.parquet as pq

    table = pq.read_table(tmp_path / "a.parquet")
    y = table["y1"].to_numpy().copy()
    y[7] = np.nan
    at = table.schema.get_field_index("y1")
    pq.write_table(table.set_column(at, table.schema.field(at), [y]), tmp_path / "b.parquet")
    damaged = open_dataset(tmp_path / "b.parquet")
    with pytest.raises(DataError, match=r"not finite.*b\.parquet"):
        list(damaged.blocks())
    with pytest.raises(DataError, match="not finite at sample 7"):
        ARX(na=1, nb=1, nk=1, refine=False).fit(damaged)


def test_windows_keep_segments_apart() -> None:
    seen = [(number, w.shape[1]) for number, w in windows(blocks_of(WHOLE)(), 3)]
    assert seen == [(0, 900), (1, 900)]
