"""Flights for other programs: what was written is read back by those programs' own readers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli import root
from flysid.errors import UsageError
from flysid.flight import Flight, Source, field_metadata, field_unit
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.flight_export import export_tables, gridded_table, physical_tables
from tests.samplelogs import dataflash

T_NS = np.arange(500, dtype=np.int64) * 20_000_000 + 1_000_000_000


def log(boots: int = 1) -> FlightLog:
    """`ATT` at 50 Hz with a scaled angle, an array and a text; `BARO` at 10 Hz with a pause of 2 s."""
    boot = np.repeat(np.arange(boots, dtype=np.int32), len(T_NS) // boots)
    q = pa.FixedSizeListArray.from_arrays(pa.array(np.arange(1000.0)), 2)
    att = pa.table(
        [pa.array(T_NS), pa.array(boot), pa.array(np.arange(500, dtype=np.int16)), q, pa.array(["é,"] * 500)],
        schema=pa.schema(
            [
                pa.field("time_ns", pa.int64()),
                pa.field("boot", pa.int32()),
                pa.field("Roll", pa.int16(), metadata=field_metadata(unit="deg", scale=0.01)),
                pa.field("q", q.type),
                pa.field("name", pa.string()),
            ]
        ),
    )
    kept = np.r_[0:20, 40:100]
    baro = pa.table(
        {
            "time_ns": T_NS[::5][kept],
            "boot": boot[::5][kept],
            "Alt": np.sin(T_NS[::5][kept] / 1e9),
            "state": (kept > 50).astype(np.int8),
        }
    )
    return FlightLog(Flight(Source("a.BIN", "dataflash", 1, "0" * 64), {"ATT": att, "BARO": baro}))


def test_tables_are_physical_with_a_column_per_element() -> None:
    table = physical_tables(log(), ["ATT"])["ATT"]
    assert table.column_names == ["time_s", "Roll", "q[0]", "q[1]", "name"]
    assert field_unit(table.schema.field("Roll")) == "deg"
    np.testing.assert_allclose(table["Roll"].to_numpy(), 0.01 * np.arange(500))
    np.testing.assert_array_equal(table["q[1]"].to_numpy(), np.arange(1.0, 1000.0, 2.0))
    assert "boot" in physical_tables(log(boots=2), ["ATT"])["ATT"].column_names


def test_a_grid_interpolates_measurements_holds_states_and_leaves_pauses_empty() -> None:
    table = gridded_table(physical_tables(log()), 50.0)
    time_s = table["time_s"].to_numpy()
    np.testing.assert_allclose(np.diff(time_s), 0.02)
    np.testing.assert_allclose(table["ATT.Roll"].to_numpy(), 0.01 * np.arange(500))
    altitude = table["BARO.Alt"].to_numpy(zero_copy_only=False)
    empty = np.isnan(altitude)
    inside = (time_s > 2.91) & (time_s < 4.99)
    assert empty[inside].all()
    np.testing.assert_allclose(altitude[~empty], np.sin(time_s[~empty]), atol=2e-3)
    states = table["BARO.state"].to_numpy(zero_copy_only=False)
    assert set(states[~np.isnan(states)]) == {0.0, 1.0}, "a switch has no values between"
    assert "ATT.name" not in table.column_names


def test_boots_of_a_grid_stand_one_below_the_other() -> None:
    table = gridded_table(physical_tables(log(boots=2)), 50.0)
    assert table["boot"].to_pylist() == [0] * 250 + [1] * 250


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(UsageError, match="Hz"):
        gridded_table(physical_tables(log()), rate)


def test_csv_is_read_back_by_flysid_with_its_units(tmp_path: Path) -> None:
    folder = export_tables(physical_tables(log()), "csv", tmp_path / "flight")
    assert sorted(p.name for p in folder.iterdir()) == ["ATT.csv", "BARO.csv"]
    [table] = flysid.read(folder / "ATT.csv").tables.values()
    np.testing.assert_allclose(table["Roll"].to_numpy(), 0.01 * np.arange(500))
    assert field_unit(table.schema.field("Roll")) == "deg"


def test_parquet_keeps_units(tmp_path: Path) -> None:
    path = export_tables(physical_tables(log(), ["ATT"]), "parquet", tmp_path / "att.parquet")
    table = pq.read_table(path)
    assert field_unit(table.schema.field("Roll")) == "deg"
    assert table["name"][0].as_py() == "é,"


def test_matlab_reads_structures(tmp_path: Path) -> None:
    from scipy.io import loadmat

    path = export_tables(physical_tables(log()), "mat", tmp_path / "flight.mat")
    att = loadmat(path, simplify_cells=True)["ATT"]
    np.testing.assert_allclose(att["Roll"], 0.01 * np.arange(500))
    assert att["units"]["Roll"] == "deg"
    assert att["q_1"][1] == 3.0
    assert att["name"][0] == "é,"


def test_excel_has_a_sheet_per_stream(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    path = export_tables(physical_tables(log()), "xlsx", tmp_path / "flight.xlsx")
    book = openpyxl.load_workbook(path, read_only=True)
    rows = list(book["ATT"].iter_rows(values_only=True))
    assert rows[0][:2] == ("time_s", "Roll [deg]")
    assert rows[3][:2] == (1.04, 0.02)
    book.close()


def test_mcap_is_read_back_by_its_own_library(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    path = export_tables(physical_tables(log()), "mcap", tmp_path / "flight.mcap")
    with path.open("rb") as file:
        seen = [(c.topic, m.log_time, json.loads(m.data)) for _, c, m in make_reader(file).iter_messages()]
    roll = [(t, data["Roll"]) for topic, t, data in seen if topic == "ATT"]
    assert [t for t, _ in roll] == T_NS.tolist()
    np.testing.assert_allclose([v for _, v in roll], 0.01 * np.arange(500))
    flight = flysid.read(path)
    assert flight["BARO"].num_rows == 80
    assert field_unit(flight["ATT"].schema.field("Roll")) == "deg"


def test_the_command_writes_once_and_asks_which_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("0001.BIN").write_bytes(dataflash.build())

    def export(*arguments: str) -> object:
        done = CliRunner().invoke(root, ["export", "0001.BIN", "ATT", *arguments])
        return done.exception or done.stdout.strip()

    assert export("-o", "att.csv") == "att.csv"
    assert Path("att.csv").read_text().startswith('"time_s"')
    assert "the target exists" in str(export("-o", "att.csv"))
    assert export("--rate", "10", "--to", "mat", "-o", "att.mat") == "att.mat"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["0001.BIN", "att.csv", "att.mat"]
