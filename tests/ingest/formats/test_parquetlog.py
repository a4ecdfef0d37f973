"""Tables in parquet: what pandas, polars and flysid itself write."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli import root
from flysid.errors import FormatError
from flysid.flight import Flight, field_unit
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import all_formats, detect
from tests.model_examples import data
from tests.samplelogs import parquet as sample

LOGS = Path(__file__).resolve().parents[4] / "shared" / "logs" / "ardrone"

ROOT = Path(__file__).resolve().parents[3]


def read(blob: bytes, **limits: Any) -> Flight:
    return collect(memoryview(blob), "t.parquet", all_formats()["parquet"], Limits(**limits))


def written(table: pa.Table, **options: Any) -> bytes:
    out = io.BytesIO()
    pq.write_table(table, out, **options)
    return out.getvalue()


def frame_of(count: int = 200) -> pd.DataFrame:
    return pd.DataFrame({"u": np.sin(np.arange(count) / 9), "vx_m_s": np.arange(count) / 7})


def damaged(blob: bytes, group: int, name: str) -> bytes:
    facts = pq.ParquetFile(io.BytesIO(blob)).metadata.row_group(group)
    chunks = [facts.column(k) for k in range(facts.num_columns)]
    chunk = next(c for c in chunks if c.path_in_schema == name)
    start = chunk.dictionary_page_offset or chunk.data_page_offset
    middle = start + chunk.total_compressed_size // 2
    return blob[:middle] + bytes(8) + blob[middle + 8 :]


def seconds(flight: Flight) -> list[float]:
    return [ns / 1e9 for ns in flight["table"]["time_ns"].to_pylist()]


def test_units_come_from_the_fields_or_from_their_names() -> None:
    table = read(sample.build())["table"]
    assert [field_unit(table.schema.field(n)) for n in ("pitch_cmd", "v_x", "alt_m")] == ["deg", "m/s", "m"]
    assert table.schema.metadata[b"time_source"] == b"t_s in s, stated"
    assert table["rssi"].null_count == 360


@pytest.mark.parametrize(
    ("index", "expected"),
    [
        (pd.date_range("2024-01-01", periods=200, freq="20ms"), 1704067200.0),
        (pd.date_range("2024-01-01", periods=200, freq="20ms", tz="Europe/Rome", name="when"), 1704063600.0),
        (pd.to_timedelta(np.arange(200) * 0.02, unit="s"), 0.0),
        (pd.Index(np.arange(200) * 0.02, name="time"), 0.0),
        (pd.Index(np.arange(200) * 0.02), 0.0),
        (pd.Index(np.arange(200) * 20_000, name="TimeUS"), 0.0),
        (pd.Index(np.arange(200) * 20, name="t"), 0.0),
    ],
    ids=["dates", "dates in a zone", "durations", "time", "no name", "TimeUS", "whole numbers"],
)
def test_the_index_that_pandas_had_is_the_time(index: pd.Index, expected: float) -> None:
    out = io.BytesIO()
    frame_of().set_index(index).to_parquet(out)
    flight = read(out.getvalue())
    assert seconds(flight) == pytest.approx([expected + 0.02 * k for k in range(200)])
    assert not flight.damage.lossy


def test_labels_of_rows_are_no_time() -> None:
    out = io.BytesIO()
    frame = frame_of()
    frame[frame["u"] > 0].to_parquet(out)
    flight = read(out.getvalue())
    assert flight["table"].schema.metadata[b"time_source"] == b"row number"
    assert flight["table"]["index"].to_pylist() == frame.index[frame["u"] > 0].tolist()


def test_a_column_of_stamps_is_the_time_whatever_its_name() -> None:
    frame = frame_of().assign(received=pd.date_range("2024-01-01", periods=200, freq="10ms"))
    flight = read(written(pa.Table.from_pandas(frame, preserve_index=False)))
    assert seconds(flight)[1] - seconds(flight)[0] == pytest.approx(0.01, abs=1e-6)


def test_a_time_in_two_possible_units_is_asked_for() -> None:
    blob = written(pa.table({"t": list(range(300)), "u": [k / 3 for k in range(300)]}))
    with pytest.raises(FormatError, match=r"299 s at 1 Hz in s, or 0\.299 s at 1,000 Hz in ms"):
        read(blob)
    assert seconds(read(blob, time_unit="ms"))[-1] == pytest.approx(0.299)
    field = pa.field("t", pa.int64(), metadata={"units": "ms"})
    stated = pa.table([list(range(300)), [1.0] * 300], schema=pa.schema([field, ("u", pa.float64())]))
    assert seconds(read(written(stated)))[-1] == pytest.approx(0.299)


def test_stamps_keep_all_their_digits_and_gaps_cost_their_row() -> None:
    stamps = [1_700_000_000_000_000_001 + 10_000_003 * k for k in range(50)]
    times: list[int | None] = [*stamps[:20], None, *stamps[20:]]
    flight = read(written(pa.table({"time_ns": times, "u": [1.5] * 51})))
    assert flight["table"]["time_ns"].to_pylist() == stamps
    assert flight.damage.undecoded == {"table": 1}


def test_types_become_plain_and_the_rest_is_named() -> None:
    count = 40
    table = pa.table(
        {
            "time_s": [k / 10 for k in range(count)],
            "mode": pa.array(["HOVER"] * count).dictionary_encode(),
            "pose": [{"x": float(k), "q": [0.5, 0.5]} for k in range(count)],
            "volts": pa.array(list(range(count))).cast(pa.decimal128(25, 3)),
            "note": pa.array([None] * count, pa.null()),
            "late": pa.array(range(count), pa.duration("ms")),
            "tags": pa.array([[("a", 1)]] * count, pa.map_(pa.string(), pa.int64())),
        }
    )
    flight = read(written(table))
    got = flight["table"]
    assert got.column_names[2:] == ["time_s", "mode", "pose.x", "pose.q", "volts", "note", "late"]
    assert got["mode"].to_pylist()[0] == "HOVER"
    assert got["pose.x"].to_pylist()[3] == 3.0
    assert got["pose.q"].to_pylist()[3] == [0.5, 0.5]
    assert got["volts"].to_pylist()[3] == 3.0
    assert got["late"].to_pylist()[3] == 3_000_000
    assert flight.damage.undecoded == {"table.tags": count}


def test_a_damaged_column_costs_itself_and_a_damaged_time_its_row_group() -> None:
    blob = sample.build()
    whole = read(blob)["table"].to_pandas()
    for name, rows in (("v_x", 400), ("t_s", 300)):
        flight = read(damaged(blob, 1, name))
        assert flight.rows == rows
        assert flight.damage.lossy
        if name == "v_x":
            assert flight.damage.undecoded == {"table.v_x": 100}
            kept = flight["table"].to_pandas()
            assert kept["v_x"].isna().tolist() == [100 <= k < 200 for k in range(400)]
            pd.testing.assert_frame_equal(kept.drop(columns="v_x"), whole.drop(columns="v_x"))


def test_what_expands_beyond_the_limits_is_left_alone() -> None:
    blob = written(
        pa.table({"time_s": np.arange(3_000_000) / 100, "u": np.zeros(3_000_000)}), compression="zstd"
    )
    flight = read(blob, max_chunk_bytes=1 << 20)
    assert flight.rows == 0
    assert "expands to more than 1,048,576 bytes" in flight.damage.reasons["table"]


def test_a_cut_file_is_refused_with_the_reason() -> None:
    with pytest.raises(FormatError, match="footer of this parquet file is missing") as raised:
        read(sample.build()[:-100])
    assert "copy it again" in raised.value.hint


def test_a_dataset_is_no_log_and_a_log_is_no_dataset(tmp_path: Path) -> None:
    from flysid.datasetfile import write_dataset

    path = tmp_path / "pitch.parquet"
    write_dataset(path, data(1, 1, samples=400, noise=0.05, seed=1))
    with pytest.raises(FormatError, match="a dataset that flysid wrote") as raised:
        flysid.read(path)
    assert raised.value.hint == "flysid fit pitch.parquet -o RUN"
    flight = tmp_path / "flight.parquet"
    flight.write_bytes(sample.build())
    words = ["tf", str(flight), "--from", "pitch_cmd", "--to", "v_x", "-q"]
    assert CliRunner().invoke(root, words, standalone_mode=False).exception is None


@pytest.mark.skipif(not LOGS.is_dir(), reason="../shared/logs is not there")
@pytest.mark.parametrize("name", ["ardrone2_flight_nav_198hz", "ardrone2_flight_optitrack_120hz"])
def test_a_real_flight_is_what_pandas_reads_and_what_its_csv_says(name: str) -> None:
    path = LOGS / f"{name}.parquet"
    frame = pd.read_parquet(path)
    flight = flysid.read(path)
    assert detect(path.read_bytes()[:4096], "log").name == "parquet"
    assert not flight.damage.lossy
    assert flight.info["time"] == "stamp in s, by its size and steps"
    pd.testing.assert_frame_equal(flight["table"].to_pandas()[list(frame.columns)], frame)
    text = collect(memoryview(frame.to_csv(index=False).encode()), "t.csv", all_formats()["csv"], Limits())
    assert np.array_equal(text["table"]["time_ns"].to_numpy(), flight["table"]["time_ns"].to_numpy())
    for column in frame.columns:
        assert field_unit(text["table"].schema.field(column)) == field_unit(
            flight["table"].schema.field(column)
        )


def test_no_damage_to_the_footer_ends_the_process() -> None:
    """A damaged statistic of a column made Arrow's C++ end the process."""
    code = (
        "from flysid.errors import FormatError\n"
        "from tests.format_trials import read\n"
        "from tests.samplelogs import parquet\n"
        "blob = parquet.build()\n"
        "footer = int.from_bytes(blob[-8:-4], 'little')\n"
        "for at in range(len(blob) - 8 - footer, len(blob) - 8, 23):\n"
        "    for bit in (64,):\n"
        "        try:\n"
        "            read('parquet', blob[:at] + bytes([blob[at] ^ bit]) + blob[at + 1 :])\n"
        "        except FormatError:\n"
        "            pass\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-500:]


def test_times_of_day_and_minutes_are_times() -> None:
    ticks = pa.array([43_200_000_000 + 20_000 * k for k in range(200)]).cast(pa.time64("us"))
    table = pa.table({"time": ticks, "x": range(200)})
    assert seconds(read(written(table)))[:2] == pytest.approx([43_200.0, 43_200.02])
    minutes = pa.table({"time_min": [k / 6000 for k in range(200)], "x": range(200)})
    assert seconds(read(written(minutes)))[:2] == pytest.approx([0.0, 0.01])


@pytest.mark.parametrize(
    "times", [list(range(200, 0, -1)), [f"at {k // 60:02} past {k % 60:02}" for k in range(200)]]
)
def test_a_time_that_cannot_be_used_is_said(times: list[object]) -> None:
    """Before, rows of a log at 100 Hz counted as 1 s each without a word."""
    flight = read(written(pa.table({"time": times, "x": range(200)})))
    assert flight.damage.undecoded == {"table.time": 200}
    assert "rows count as 1 s each" in flight.damage.reasons["table.time"]


def test_rows_that_are_late_are_counted() -> None:
    seconds_of = [i / 10 if i != 10 else 0.3 for i in range(40)]
    blob = written(pa.table({"time_s": seconds_of, "x": range(40)}), row_group_size=10)
    assert read(blob).damage.out_of_order == {"table": 1}


def text_times(count: int) -> list[str]:
    return [f"10:00:{k // 50:02d}.{k % 50 * 20:03d}" for k in range(count)]


def test_text_of_numbers_in_columns_of_one_name_is_read_as_numbers() -> None:
    cells = [pa.array([f"{k},5" for k in range(100)]), pa.array([f"{2 * k},5" for k in range(100)])]
    table = pa.Table.from_arrays([pa.array(text_times(100)), *cells], ["Time", "x", "x"])
    got = read(written(table))["table"]
    assert got["x"].to_pylist() == [k + 0.5 for k in range(100)]
    assert got["x_"].to_pylist() == [2 * k + 0.5 for k in range(100)]


def test_a_damaged_column_in_the_first_rows_leaves_the_time_and_numbers_beside_it() -> None:
    table = pa.table(
        {
            "Date": ["2025-04-17"] * 200,
            "Time": text_times(200),
            "x": [f"{k},5" for k in range(200)],
            "y": [f"word {k * k}" for k in range(200)],
        }
    )
    options = {"row_group_size": 100, "write_page_checksum": True}
    blob = written(table, **options)
    intact = read(blob)["table"].to_pandas()
    flight = read(damaged(blob, 0, "y"))
    assert flight.damage.undecoded == {"table.y": 100}
    pd.testing.assert_frame_equal(flight["table"].to_pandas().drop(columns="y"), intact.drop(columns="y"))
    for name in ("Date", "Time"):
        late = read(damaged(blob, 1, name))
        assert late.damage.undecoded == {"table": 100}
        assert late.damage.reasons == {"table": "row group 1: its time cannot be read"}


def test_text_that_is_no_utf8_is_a_cell_that_is_no_number() -> None:
    cells = [b"\xff\xfe" if k == 700 else b"%d,5" % k for k in range(1000)]
    text = pa.array(cells, pa.binary()).view(pa.string())
    flight = read(written(pa.table({"time_s": np.arange(1000) / 50, "x": text})))
    assert flight.damage.undecoded == {"table.x": 1}
    assert flight["table"]["x"].to_pylist() == [None if k == 700 else k + 0.5 for k in range(1000)]
