"""The store: whole or absent, safe names, sorted rows, versions."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid import flightwriter, store
from flysid.errors import StoreError, UsageError, WriteError
from flysid.flight import BOOT, TIME, ClockMap, Damage, Region, Source, field_metadata
from flysid.ingest.formats.base import StreamPart, Summary

ROOT = Path(__file__).resolve().parents[2]
SOURCE = Source("flight 7.tlog", "tlog", 3, "ab" * 32)


def table(times: Sequence[int], boot: int = 0, first: float = 0.0) -> pa.Table:
    """time_ns, boot and a column x that numbers the rows."""
    schema = pa.schema(
        [
            pa.field(TIME, pa.int64()),
            pa.field(BOOT, pa.int32()),
            pa.field("x", pa.float64(), metadata=field_metadata("m", 0.01, {1: "ONE"}, "a thing")),
        ],
        metadata={"time_source": "time_boot_ms"},
    )
    rows = [list(times), [boot] * len(times), [first + i for i in range(len(times))]]
    return pa.table(rows, schema=schema)


def parts(
    *items: tuple[str, pa.Table], summary: Summary | None = None
) -> Generator[StreamPart, None, Summary]:
    for stream, rows in items:
        yield StreamPart(stream, rows)
    return summary or Summary()


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return store.create_data_folder(tmp_path / "data")


def test_a_flight_comes_back_as_it_was(data: Path) -> None:
    summary = Summary(
        Damage(bytes_skipped=3, regions=(Region(1, 4, "x"),), region_count=1, undecoded={"a": 2}),
        (ClockMap(0, 0, 30, 1_700_000_000_000_000_000, 1.001, 5),),
        {"autopilot": "px4"},
    )
    written = store.write_flight(data, SOURCE, parts(("1.1/A", table([10, 20, 30])), summary=summary))
    assert store.list_flights(data) == [written]
    flight = store.read_flight(data, written.id)
    assert flight["A"].equals(table([10, 20, 30]), check_metadata=True)
    assert (flight.damage, flight.clocks, flight.info) == (summary.damage, summary.clocks, summary.info)
    entry = written.stream("A")
    assert (entry.rows, entry.first_ns, entry.last_ns, entry.boots) == (3, 10, 30, (0,))
    assert entry.rate_hz == pytest.approx(2 / 20e-9)
    column = entry.columns[2]
    assert (column.unit, column.scale, column.enum, column.description) == (
        "m",
        0.01,
        {"1": "ONE"},
        "a thing",
    )


def test_rows_are_sorted_by_boot_and_time_across_parts(data: Path) -> None:
    late = [
        ("s", table([5, 9, 7], boot=1)),
        ("s", table([50, 40], boot=0, first=10)),
        ("s", table([1], boot=1)),
    ]
    flight = store.write_flight(data, SOURCE, parts(*late))
    rows = store.read_stream(data, flight.id, "s").to_pydict()
    assert list(zip(rows[BOOT], rows[TIME], strict=True)) == [
        (0, 40),
        (0, 50),
        (1, 1),
        (1, 5),
        (1, 7),
        (1, 9),
    ]
    assert rows["x"] == [11, 10, 0, 0, 2, 1]


@pytest.mark.parametrize("fits", [True, False], ids=["sorted at the end", "too large to sort"])
def test_overlapping_row_groups_are_sorted_on_disk_or_on_reading(
    data: Path, monkeypatch: pytest.MonkeyPatch, fits: bool
) -> None:
    monkeypatch.setattr(flightwriter, "BUFFER_BYTES", 100)
    if not fits:
        monkeypatch.setattr(flightwriter, "SORT_BYTES", 0)
    pieces = [("s", table(range(1000 - 100 * k, 1100 - 100 * k))) for k in range(10)]
    flight = store.write_flight(data, SOURCE, parts(*pieces))
    assert flight.stream("s").is_sorted == fits
    assert store.read_stream(data, flight.id, "s", [TIME])[TIME].to_pylist() == list(range(100, 1100))


def test_a_stream_of_any_size_that_is_nearly_sorted_is_merged(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flightwriter, "BUFFER_BYTES", 500)
    monkeypatch.setattr(flightwriter, "SORT_BYTES", 12_000)
    rng = np.random.default_rng(3)
    times = (np.arange(5000) * 10 + rng.integers(-400, 400, 5000)).tolist()  # 120 kB, ten times the bound
    pieces = [("s", table(times[k : k + 50])) for k in range(0, 5000, 50)]
    flight = store.write_flight(data, SOURCE, parts(*pieces))
    assert flight.stream("s").is_sorted
    assert store.read_stream(data, flight.id, "s", [TIME])[TIME].to_pylist() == sorted(times)


HOSTILE = [
    "../x",
    "/etc/passwd",
    "a\0b",
    "x" * 300,
    "a\nb",
    "",
    ".",
    "..",
    "A",
    "a",
    "con",
    "é",
    "e\u0301",
    "a/b",
    "a_b",
]


def test_hostile_stream_keys_stay_inside_and_apart(data: Path) -> None:
    flight = store.write_flight(data, SOURCE, parts(*[(key, table([1])) for key in HOSTILE]))
    folder = data / "flights" / flight.id
    files = sorted(p.name for p in folder.iterdir() if p.suffix == ".parquet")
    assert files == sorted(s.file for s in flight.streams)
    assert len({f.casefold() for f in files}) == len(HOSTILE)
    assert all(len(f.encode()) < 200 for f in files)
    assert {s.stream for s in store.read_manifest(folder).streams} == set(HOSTILE)


@given(st.lists(st.text(max_size=120), max_size=12, unique=True))
@settings(max_examples=30, deadline=None)
def test_slugs_are_plain_file_names_and_never_clash(names: list[str]) -> None:
    taken: set[str] = set()
    for name in names:
        safe = store.slug(name, taken)
        assert safe.casefold() not in taken
        assert safe.isascii()
        assert 0 < len(safe) <= 120
        assert not safe.startswith(".")
        assert not set(safe) & set('/\\:*?"<>|\0\n ')
        taken.add(safe.casefold())


def test_a_failing_reader_leaves_nothing(data: Path) -> None:
    def failing() -> Generator[StreamPart, None, Summary]:
        yield StreamPart("s", table([1]))
        raise StoreError("broken")

    with pytest.raises(StoreError, match="broken"):
        store.write_flight(data, SOURCE, failing())
    assert list((data / "flights").iterdir()) == []


def test_a_folder_without_manifest_is_invisible_and_cleaned(data: Path) -> None:
    flight = store.write_flight(data, SOURCE, parts(("s", table([1]))))
    (data / "flights" / "half").mkdir()
    (data / "flights" / "half" / "s.parquet").write_bytes(b"PAR1")
    (data / "flights" / ".incoming-x-1").mkdir()
    assert [m.id for m in store.list_flights(data)] == [flight.id]
    assert store.clean(data) == 2
    assert [p.name for p in (data / "flights").iterdir()] == [flight.id]


def test_an_ingested_flight_is_kept_unless_replaced(data: Path) -> None:
    first = store.write_flight(data, SOURCE, parts(("s", table([1]))))
    assert store.write_flight(data, SOURCE, parts(("s", table([1, 2])))) == first
    second = store.write_flight(data, SOURCE, parts(("s", table([1, 2]))), replace=True)
    assert [m.rows for m in store.list_flights(data)] == [second.rows] == [2]
    assert len(list((data / "flights").iterdir())) == 1


def test_another_log_with_the_same_short_hash_gets_its_own_folder(data: Path) -> None:
    other = Source(SOURCE.name, "tlog", 3, "ab" * 31 + "cd")
    ids = {store.write_flight(data, s, parts(("s", table([1])))).id for s in (SOURCE, other)}
    assert len(ids) == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": 2}, "newer flysid"),
        ({"version": "1"}, "damaged"),
        ({"format": "else"}, "not a flysid-flight"),
        ({"streams": 3}, "damaged manifest"),
    ],
)
def test_manifests_of_other_versions_or_damaged_are_refused(
    data: Path, change: dict[str, object], words: str
) -> None:
    flight = store.write_flight(data, SOURCE, parts(("s", table([1]))))
    path = data / "flights" / flight.id / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(StoreError, match=words):
        store.list_flights(data)


def test_a_newer_folder_names_the_upgrade(data: Path) -> None:
    (data / "flysid-data.json").write_text('{"format": "flysid-data", "version": 99}')
    with pytest.raises(StoreError, match="upgrade"):
        store.list_flights(data)


def test_a_manifest_cannot_point_outside_its_folder(data: Path) -> None:
    flight = store.write_flight(data, SOURCE, parts(("s", table([1]))))
    path = data / "flights" / flight.id / "manifest.json"
    path.write_text(path.read_text().replace('"s.parquet"', '"../../x.parquet"'))
    with pytest.raises(StoreError, match="leads out of the folder"):
        store.read_stream(data, flight.id, "s")


def test_names_that_are_not_there_get_the_nearest(data: Path) -> None:
    flight = store.write_flight(data, SOURCE, parts(("1.1/ATTITUDE", table([1]))))
    with pytest.raises(UsageError, match="ATTITUDE"):
        store.read_stream(data, flight.id, "ATTITUD")
    with pytest.raises(UsageError, match=r"no column 'y'.*x"):
        store.read_stream(data, flight.id, "ATTITUDE", ["y"])
    with pytest.raises(UsageError, match=flight.id):
        store.read_stream(data, "flight_8", "ATTITUDE")
    assert store.find_flight(data, "flight_7").id == flight.id
    with pytest.raises(UsageError, match="the name of the flight is empty"):
        store.find_flight(data, "")


def test_a_folder_that_a_killed_writer_began_is_finished(tmp_path: Path) -> None:
    data = tmp_path / "data"
    (data / "flights").mkdir(parents=True)
    (data / ".flysid-data.json.4711").write_text("{")
    assert store.create_data_folder(data) == data
    assert (data / "flysid-data.json").is_file()


def test_a_folder_with_other_things_is_not_taken_over(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="not empty"):
        store.create_data_folder(tmp_path)
    with pytest.raises(UsageError, match="no such folder"):
        store.list_flights(tmp_path / "nowhere")
    with pytest.raises(UsageError, match="not an ingested folder"):
        store.list_flights(tmp_path)


def test_two_writers_at_once_are_refused(data: Path) -> None:
    with store.locked(data):
        code = f"from pathlib import Path; from flysid.store import *\nwith locked(Path({str(data)!r})): pass"
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
        )
    assert "another flysid is writing" in done.stderr
    with store.locked(data):
        pass


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser writes anywhere")
def test_a_read_only_folder_names_the_path(data: Path) -> None:
    (data / "flights").chmod(0o500)
    try:
        with pytest.raises(WriteError, match="cannot be written") as caught:
            store.write_flight(data, SOURCE, parts(("s", table([1]))))
    finally:
        (data / "flights").chmod(0o700)
    assert caught.value.exit_code == 1


def test_a_full_disk_names_the_path_and_leaves_nothing(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pyarrow.parquet.ParquetWriter.write_table", full)
    with pytest.raises(WriteError, match="No space left"):
        store.write_flight(data, SOURCE, parts(("s", table([1]))))
    assert list((data / "flights").iterdir()) == []


KILLED = """
import sys, time
from pathlib import Path
from flysid import store, flightwriter
from tests.flysid.test_store import SOURCE, parts, table
flightwriter.BUFFER_BYTES = 1000
def slow():
    for k in range(1000):
        yield from parts(("s", table(range(100 * k, 100 * k + 100))))
        if k == 20:
            print("half", flush=True)
            time.sleep(600)
    return (yield from parts())
store.write_flight(Path(sys.argv[1]), SOURCE, slow())
"""


def test_a_killed_writer_leaves_no_visible_flight(data: Path) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(data)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "half\n"
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    assert store.list_flights(data) == []
    assert store.clean(data) == 1
    assert store.write_flight(data, SOURCE, parts(("s", table([1])))).rows == 1
