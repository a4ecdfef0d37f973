"""Large tables of many flights, and vehicles that are forgotten."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import flysid
from flysid.errors import StoreError, UsageError
from flysid.fleet import compaction
from flysid.fleet.compaction import compact, files_of, find_unreferenced
from flysid.fleet.ingest_many import Threads, find, ingest
from flysid.fleet.lakes import create_lake
from flysid.fleet.reading import Settings
from flysid.fleet.upkeep import check
from flysid.ingest.lake.flighttable import rebuild
from flysid.place import Place
from tests.flysid.fleet.fleet_logs import fill, run, table


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of its own for every test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def lake_of(bucket: str, count: int) -> Place:
    """A lake of small flights of two vehicles."""
    fill(f"{bucket}/in", count)
    return brought_up(bucket)


def brought_up(bucket: str) -> Place:
    place = create_lake(f"{bucket}/lake")
    settings = Settings(str(place), bounds=None, vehicle_in=r"v\d+")
    list(ingest(find([f"{bucket}/in"], str(place)), settings, Threads(1)))
    return place


def rows_in(place: Place, addresses: list[str]) -> pa.Table:
    tables = [pq.read_table(pa.BufferReader(place.read(a.removeprefix(f"{place}/")))) for a in addresses]
    return pa.concat_tables(tables)


def text_of(content: bytes) -> str:
    """All that an object says. Parquet is unpacked: compressed bytes hide words."""
    if not content.startswith(b"PAR1"):
        return content.decode()
    file = pq.ParquetFile(pa.BufferReader(content))
    groups = [file.metadata.row_group(number).to_dict() for number in range(file.num_row_groups)]
    return f"{file.schema_arrow.metadata} {groups} {file.read().to_pylist()}"


def test_compacted_tables_hold_every_row_once_and_say_whose_it_is(bucket: str) -> None:
    place = lake_of(bucket, 5)
    before = rows_in(place, files_of(place, "table"))
    assert len(files_of(place, "table")) == 5
    done = compact(place)
    assert (done.written, done.unchanged, done.parts, done.rows) == (1, 0, 1, 300)
    [part] = files_of(place, "table")
    after = rows_in(place, [part])
    for column in ("command", "response", "time_ns"):
        assert sum(after[column].to_pylist()) == sum(before[column].to_pylist())
    assert after["vehicle"].to_pylist() == ["v000"] * 180 + ["v001"] * 120
    assert after.schema.field("command").metadata == before.schema.field("command").metadata
    assert check(place).is_whole
    again = compact(place)
    assert (again.written, again.unchanged) == (0, 1)
    assert len(files_of(place, "table", "vehicle = 'v001'")) == 2


def test_a_late_flight_is_read_at_once_and_compacted_later(bucket: str) -> None:
    place = lake_of(bucket, 2)
    compact(place)
    Place(bucket).put("in/v000/late.csv", table(77))
    brought_up(bucket)
    assert len(files_of(place, "table")) == 2  # the part, and the late flight's own table
    assert rows_in(place, [files_of(place, "table")[1]]).num_rows == 60
    compact(place)
    assert [rows_in(place, [a]).num_rows for a in files_of(place, "table")] == [180]
    assert len(find_unreferenced(place)) == 1
    run("fleet", "check", str(place), "--repair", "--older", "0s", "-q")
    assert find_unreferenced(place) == []


def test_where_parts_hold_every_flight_no_row_of_the_catalogue_is_read(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = lake_of(bucket, 2)
    compact(place)

    def read(*_: Any) -> None:
        raise AssertionError("the catalogue's rows were read")

    with monkeypatch.context() as patch:
        patch.setattr(compaction, "select", read)
        assert len(files_of(place, "table")) == 1
        assert files_of(place, "nothing") == []
    place.delete([f.key for f in place.list("catalog/flights")])
    rebuild(place, check(place).flights[:1])  # as many commits as before, of another content
    monkeypatch.setattr(compaction, "select", read)
    with pytest.raises(AssertionError):
        files_of(place, "table")


def test_damage_to_the_list_of_parts_is_named(bucket: str) -> None:
    place = lake_of(bucket, 1)
    place.put(compaction.PARTS, b'{"parts": 7}')
    with pytest.raises(StoreError, match="damaged"):
        files_of(place, "table")


def test_columns_of_other_units_are_never_mixed(bucket: str) -> None:
    Place(bucket).put("in/v000/a.csv", table(1))
    Place(bucket).put("in/v000/b.csv", table(2).replace(b"response\n", b"response [deg]\n"))
    place = brought_up(bucket)
    assert compact(place).parts == 2


def test_a_compaction_that_is_interrupted_leaves_the_old_parts(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = lake_of(bucket, 2)
    compact(place)
    old = files_of(place, "table")
    Place(bucket).put("in/v000/late.csv", table(77))
    brought_up(bucket)

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(compaction, "_list", interrupted)
    with pytest.raises(KeyboardInterrupt):
        compact(place)
    files = files_of(place, "table")
    assert files[:1] == old
    assert sum(rows_in(place, [file]).num_rows for file in files) == 180


def test_a_table_that_is_gone_is_named(bucket: str) -> None:
    place = lake_of(bucket, 2)
    place.delete([next(f.key for f in place.list("flights") if f.key.endswith(".parquet"))])
    with pytest.raises(StoreError, match="damaged or missing"):
        compact(place)


def test_a_vehicle_that_is_forgotten_is_nowhere_in_the_lake(store: str) -> None:
    # Not v001: parquet cuts a long maximum short and raises its last letter, which makes v001 of v000.
    place = lake_of(store, 4)
    Place(store).put("in/v000/copy.csv", table(0))
    brought_up(store)
    compact(place)
    gone = [f for f in flysid.open(str(place)).facts if f.info["vehicle_name"] == "v000"]
    assert len(gone) == 2
    assert any("v000" in text_of(place.read(found.key)) for found in place.list("catalog"))
    done = run("fleet", "forget", str(place), "--vehicle", "v000", "--yes")
    assert done.exception is None or done.exit_code == 0, done.output
    assert "would bring them back" in done.stderr
    assert "former versions that the bucket keeps" in done.stderr
    words = [word for f in gone for word in (f.sha256, f.id, f.sha256[:16], "v000")]
    for found in place.list():
        content = found.key + text_of(place.read(found.key))
        assert not any(word in content for word in words), found.key
    state = check(place)
    assert state.is_whole, state
    assert len(state.flights) == 2
    assert rows_in(place, files_of(place, "table")).num_rows == 120
    assert isinstance(run("fleet", "forget", str(place), "--vehicle", "v000", "--yes").exception, UsageError)
