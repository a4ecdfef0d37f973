from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flysid.dataset import Dataset, Segment, Signal
from flysid.datasetfile import open_dataset, write_dataset
from flysid.errors import StoreError, UsageError
from flysid.model.arx import ARX
from tests.fakes import FirstOrder, flown

RNG = np.random.default_rng(0)


def data(segments: int = 3, rows: int = 50) -> Dataset:
    return Dataset(
        0.02,
        (Signal("u", "deg", 0.5), Signal("w")),
        (Signal("y", "m/s"),),
        tuple(
            Segment(
                RNG.normal(size=(rows + i, 2)),
                RNG.normal(size=(rows + i, 1)),
                t0_ns=10**12 + i * 10**10,
                flight=f"f{i // 2}",
                marks={"mode": "LOITER", "excitation": 1.5 * i},
            )
            for i in range(segments)
        ),
        name="roll",
    )


def test_arrow_protocol_gives_one_row_per_sample_with_units() -> None:
    whole = data()
    table = pa.table(whole)
    assert table.column_names == ["flight", "segment", "time_ns", "marks", "u", "w", "y"]
    assert table.num_rows == len(whole)
    assert table.schema.field("u").metadata[b"unit"] == b"deg"
    np.testing.assert_array_equal(table["y"].to_numpy(), np.concatenate([s.y[:, 0] for s in whole.segments]))
    assert table["time_ns"][1].as_py() - table["time_ns"][0].as_py() == 20_000_000


def test_pandas_polars_and_xarray() -> None:
    whole = data()
    frame = whole.to_pandas()
    assert list(frame.groupby("segment", observed=True).size()) == [50, 51, 52]
    polars = pytest.importorskip("polars")
    assert polars.DataFrame(whole).shape == (153, 7)
    pytest.importorskip("xarray")
    cube = whole.to_xarray()
    assert cube["u"].attrs["units"] == "deg"
    assert cube.sizes["sample"] == 153


def test_numpy_gives_all_samples_inputs_first() -> None:
    whole = data()
    matrix = np.asarray(whole)
    assert matrix.shape == (153, 3)
    np.testing.assert_array_equal(matrix[50:101], np.hstack([whole.segments[1].u, whole.segments[1].y]))
    assert np.asarray(whole, dtype=np.float32).dtype == np.float32
    assert np.asarray(whole.with_segments([])).shape == (0, 3)
    with pytest.raises(ValueError, match="without a copy"):
        np.array(whole, copy=False)


def test_equal_names_of_input_and_output_are_kept_apart() -> None:
    both = Dataset.from_arrays(np.ones(30), np.zeros(30), 0.1, inputs=["v"], outputs=["v"])
    assert both.to_arrow().column_names[-2:] == ["v", "y1_v"]


def test_a_notebook_shows_signals_and_lost_time_and_escapes_names() -> None:
    shown = data()._repr_html_()
    assert shown.count("<tr>") == 3
    assert "<b>u</b> [deg]" in shown
    assert "9" in shown
    hostile = Dataset.from_arrays(np.ones(30), np.zeros(30), 0.1, inputs=["<script>"])
    assert "<script>" not in hostile._repr_html_()


@pytest.mark.parametrize("rows_per_group", [1, 60, 1000])
def test_a_dataset_survives_the_disk_segment_by_segment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows_per_group: int
) -> None:
    monkeypatch.setattr("flysid.datasetfile.ROWS_PER_GROUP", rows_per_group)
    whole = data(5)
    path = tmp_path / "roll.parquet"
    assert write_dataset(path, whole) == len(whole)
    opened = open_dataset(path)
    assert len(opened) == len(whole)
    back = opened.read()
    assert back.content_hash() == whole.content_hash()
    assert [(s.flight, s.t0_ns, s.marks) for s in back.segments] == [
        (s.flight, s.t0_ns, s.marks) for s in whole.segments
    ]
    assert (back.inputs, back.outputs, back.name, back.dt_s) == (
        whole.inputs,
        whole.outputs,
        whole.name,
        whole.dt_s,
    )
    with pytest.raises(UsageError, match="exists"):
        write_dataset(path, whole)


@pytest.mark.parametrize("rows_per_group", [1, 60, 120, 1000])
def test_segments_are_read_in_any_order_and_in_groups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows_per_group: int
) -> None:
    monkeypatch.setattr("flysid.datasetfile.ROWS_PER_GROUP", rows_per_group)
    whole = data(6)
    marked = [replace(s, marks={"vehicle": "ab"[i % 2]}) for i, s in enumerate(whole.segments)]
    write_dataset(tmp_path / "d.parquet", whole.with_segments(marked))
    file = open_dataset(tmp_path / "d.parquet")
    assert [(e.number, e.rows, e.flight) for e in file.entries] == [
        (i, len(s), s.flight) for i, s in enumerate(marked)
    ]
    for number in (4, 0, 5, 2):
        one = file.segment(number)
        np.testing.assert_array_equal(one.y, marked[number].y)
        assert (one.t0_ns, one.flight, one.marks) == (
            marked[number].t0_ns,
            marked[number].flight,
            marked[number].marks,
        )
    with pytest.raises(UsageError, match="no segment 6"):
        file.segment(6)
    groups = file.group_by("vehicle")
    for name, own in whole.with_segments(marked).group_by("vehicle").items():
        assert groups[name].read().content_hash() == own.content_hash()
        assert len(groups[name]) == len(own)
        assert sum(len(y) for _, _, y in groups[name].blocks()) == len(own)
        assert len(groups[name].head(60)) == 60
    assert list(file.group_by("flight")) == ["f0", "f1", "f2"]
    assert list(file.group_by("vehicle")["a"].group_by("flight")["f1"]) != []


def test_a_fit_from_a_group_on_disk_is_the_fit_of_the_group(tmp_path: Path) -> None:
    flown_twice = flown(FirstOrder(), [400, 300, 350], 0.02)
    marked = [replace(s, marks={"vehicle": v}) for s, v in zip(flown_twice.segments, "aba", strict=True)]
    whole = flown_twice.with_segments(marked)
    write_dataset(tmp_path / "d.parquet", whole)
    settings = ARX(na=1, nb=1, nk=1, refine=False)
    on_disk = settings.fit(open_dataset(tmp_path / "d.parquet").group_by("vehicle")["a"])
    in_memory = settings.fit(whole.group_by("vehicle")["a"])
    np.testing.assert_allclose(on_disk.flat, in_memory.flat, rtol=1e-9)


def test_a_writer_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def broken() -> "list[Segment]":
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_dataset(tmp_path / "x.parquet", data(), (s for s in broken()))
    assert list(tmp_path.iterdir()) == []


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.parquet").write_text("not parquet")
    pq.write_table(pa.table({"a": [1]}), tmp_path / "other.parquet")
    for name in ("text", "other"):
        with pytest.raises(StoreError, match="not a dataset"):
            open_dataset(tmp_path / f"{name}.parquet")
    with pytest.raises(StoreError, match=r"^cannot be read: No such file or directory \("):
        open_dataset(tmp_path / "absent.parquet")
    path = tmp_path / "cut.parquet"
    write_dataset(path, data())
    opened = open_dataset(path)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(StoreError, match="damaged"):
        opened.read()
