"""What a hostile file may take: time for garbage, memory for few bytes that stand for many."""

from __future__ import annotations

import io
import random
import time
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import flysid
from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.parquet import reader
from soak import Outcome, peak_memory
from tests.command import call
from tests.forged_logs import FORGED, PARQUET, table_of
from tests.format_trials import module_of, read, sample
from tests.marked_garbage import MARKS, Garbage, marked, runs_of, seconds_a_mb

RESYNCHRONISE = (
    "tlog",
    "pcap",
    "pcapng",
    "dataflash",
    "ulog",
    "blackbox",
    "navdata",
    "crazyflie",
    "mcap",
    "rosbag",
)
GARBAGE: dict[str, Callable[[int], bytes]] = {
    "random": random.Random(20_261).randbytes,
    "zeros": bytes,
    "ones": lambda count: b"\xff" * count,
}
MEGABYTES = 0.4
MOST_S = 0.05  # of processor time, a megabyte
MOST_MB = 400


@pytest.mark.parametrize("kind", GARBAGE)
@pytest.mark.parametrize("name", RESYNCHRONISE)
def test_garbage_between_records_costs_little(name: str, kind: str) -> None:
    blob = sample(name)
    middle = len(blob) // 2
    garbage = GARBAGE[kind](int(MEGABYTES * 1e6))
    intact = read(name, blob)
    whole = min(_cpu_s(name, blob) for _ in range(3))
    damaged = min(_cpu_s(name, blob[:middle] + garbage + blob[middle:]) for _ in range(3))
    assert (damaged - whole) / MEGABYTES < MOST_S
    assert read(name, blob + garbage).rows >= intact.rows - 1


def _cpu_s(name: str, blob: bytes) -> float:
    began = time.process_time()
    read(name, blob)
    return time.process_time() - began


# ------------------------------------------------------------------------------------------------ memory


@pytest.mark.parametrize("kind", PARQUET)
def test_few_bytes_that_stand_for_many_are_read_within_bounds(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "forged.parquet"
    path.write_bytes(PARQUET[kind]())
    done = call("ingest", path, "-o", "data", "--max-memory", "500MB", cwd=tmp_path)
    assert done.returncode == (0 if kind == "a number" else 3), done.stderr
    assert kind == "a number" or "expands to more than 200 times" in done.stderr
    (facts,) = flysid.open(tmp_path / "data").facts
    assert facts.rows == pq.ParquetFile(path).metadata.num_rows


def test_the_reader_of_tables_takes_a_few_stretches_of_memory(tmp_path: Path) -> None:
    for kind, build in PARQUET.items():
        path = tmp_path / f"{kind}.parquet"
        path.write_bytes(build())
        blob = path.read_bytes()
        outcome = Outcome(kind)
        with peak_memory(outcome):
            for _ in reader.read(memoryview(blob), path.name, Limits()):
                pass
        assert (outcome.peak_mb or 0) < MOST_MB, outcome


@pytest.mark.parametrize("kind", ["mcap, fields that change", "mavlogdump, fields that change"])
def test_fields_that_change_from_message_to_message_take_little_memory(kind: str, tmp_path: Path) -> None:
    suffix, build = FORGED[kind]
    path = tmp_path / f"forged{suffix}"
    path.write_bytes(build())
    outcome = Outcome(kind)
    with peak_memory(outcome):
        flight = flysid.read(path)
    assert (outcome.peak_mb or 0) < MOST_MB, outcome
    assert flight.damage.undecoded


def test_text_that_many_rows_share_is_kept_where_it_is_not_beyond_all_measure(tmp_path: Path) -> None:
    words = ["GUIDED", "AUTO", None, "a longer word " * 9]
    column = pa.array([words[k % 4] for k in range(40_000)])
    (tmp_path / "modes.parquet").write_bytes(table_of(40_000, column))
    table = flysid.read(tmp_path / "modes.parquet")["table"]
    assert table["x"].to_pylist() == column.to_pylist()
    assert table["x"].type == pa.string()


def test_text_of_times_and_numbers_is_judged_within_bounds() -> None:
    """The rows by which a table is understood are spelt out as text."""
    count = 2000
    long = pa.DictionaryArray.from_arrays(pa.array([0] * count), pa.array(["1" * 1_000_000]))
    lists = pa.array([[1.0] * 40_000] * 200 + [[]] * (count - 200))
    times = pa.array([f"2025-04-17 10:00:{k // 50:02d}.{k % 50 * 20:03d}" for k in range(count)])
    sink = io.BytesIO()
    table = pa.Table.from_arrays([times, long, lists], ["Date", "x", "lists"])
    pq.write_table(table, sink, compression="zstd")
    outcome = Outcome("text")
    with peak_memory(outcome):
        for _ in reader.read(memoryview(sink.getvalue()), "t.parquet", Limits()):
            pass
    assert (outcome.peak_mb or 0) < MOST_MB, outcome


@pytest.mark.parametrize("garbage", [marked, runs_of])
@pytest.mark.parametrize("name", MARKS)
def test_garbage_dense_with_beginnings_of_records_costs_little(name: str, garbage: Garbage) -> None:
    """The soak holds it to `MOST_S`; beside other tests it may take twice as long."""
    best = min(seconds_a_mb(name, int(MEGABYTES * 1e6), random.Random(20_262), garbage) for _ in range(3))
    assert best < 2.0 * MOST_S


def test_letters_that_begin_frames_are_not_all_followed() -> None:
    """Each I behind a header may begin a frame of 40 fields, and half a second a megabyte went into them."""
    blob = sample("blackbox")
    middle = len(blob) // 2
    letters = b"I" * int(MEGABYTES * 1e6)
    read("blackbox", blob)
    spent = min(_cpu_s("blackbox", blob[:middle] + letters + blob[middle:]) for _ in range(3))
    assert spent / MEGABYTES < 2.0 * MOST_S
    intact = read("blackbox", blob)
    few = read("blackbox", blob[:middle] + b"I" * 100 + blob[middle:])
    assert few.rows >= intact.rows - module_of("blackbox").at_risk(blob, middle)
