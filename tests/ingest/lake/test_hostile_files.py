"""One hostile file in a folder of sound logs, of every kind: the sound logs are ingested all the same."""

from __future__ import annotations

import os
import random
import zlib
from pathlib import Path

import pytest

import flysid
from flysid.errors import FormatError
from flysid.ingest.formats import registry
from flysid.ingest.lake import finding
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from tests.command import call
from tests.hostile_files import TABLE, kinds, lay, named, parquet_twice
from tests.ingest.lake.sound_logs import SOUND, write_sound

SEED = 20_260


def ingested(found: finding.FoundLogs, data: Path) -> set[str]:
    """Names of the logs that became flights."""
    results = list(ingest_logs(found, data, bounds=None))
    assert all(result.reason for result in results if result.skipped)
    return {result.path.name for result in results if not result.skipped}


@pytest.mark.parametrize("kind", kinds())
def test_a_hostile_file_costs_no_sound_log(kind: str, tmp_path: Path) -> None:
    sound = write_sound(tmp_path / "logs")
    hostile = lay(kind, tmp_path / "logs", random.Random(SEED + zlib.crc32(os.fsencode(kind))))
    names = {path.name for path in sound}
    assert names <= ingested(find_logs([tmp_path / "logs"]), tmp_path / "data")
    assert set(sound) <= set(find_logs([*sound, hostile]).paths)


@pytest.mark.parametrize(
    "kind", ["zip, name empty name", "parquet, a column twice", "loop.bin", "unreadable", "db3, odd schema"]
)
def test_it_costs_none_in_worker_processes_either(kind: str, tmp_path: Path) -> None:
    sound = write_sound(tmp_path / "logs")
    hostile = lay(kind, tmp_path / "logs", random.Random(SEED))
    for k, given in enumerate(([tmp_path / "logs"], [*sound, hostile])):
        done = call("ingest", *given, "-o", f"data{k}", cwd=tmp_path)
        assert done.returncode in (0, 3), done.stderr
        assert {path.stem for path in sound} <= {line.rpartition("-")[0] for line in done.stdout.split()}


def test_a_log_that_vanishes_after_it_was_found_is_named(tmp_path: Path) -> None:
    sound = write_sound(tmp_path / "logs")
    found = find_logs([tmp_path / "logs"])
    sound[3].unlink()
    results = {result.path.name: result.reason for result in ingest_logs(found, tmp_path / "data")}
    assert len(results) == SOUND
    assert [name for name, reason in results.items() if reason] == [sound[3].name]
    assert "No such file" in results[sound[3].name]


def test_a_reader_that_breaks_at_the_first_bytes_costs_only_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sound = write_sound(tmp_path / "logs")
    (tmp_path / "logs" / "unnamed").write_bytes(b"\1\2\3" * 99)

    def broken(head: bytes, name: str) -> float:
        raise RecursionError(f"{name}, {len(head)} bytes")

    monkeypatch.setattr(finding, "confidence_of", broken)
    found = find_logs([tmp_path / "logs"])
    assert len(found.paths) == len(sound)
    (unread,) = found.unread
    assert "damaged or hostile: its reader stopped with RecursionError: unnamed, 297 bytes" in unread.reason


def test_what_nobody_foresaw_is_an_error_of_the_file_in_python_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (log, *_) = write_sound(tmp_path)

    def broken(*_: object) -> object:
        raise IndexError("list index out of range")

    monkeypatch.setattr(registry, "detect", broken)
    with pytest.raises(FormatError, match="IndexError: list index out of range") as raised:
        flysid.read(log)
    assert raised.value.path == str(log)
    assert raised.value.hint


# ------------------------------------------------------------------------------------------- in every verb


@pytest.fixture(params=["empty name", "twice"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Two sound logs and a file that ended every verb: an archive, a table."""
    write_sound(tmp_path / "logs", 2)
    if request.param == "twice":
        (tmp_path / "logs" / "twice.parquet").write_bytes(parquet_twice())
    else:
        (tmp_path / "logs" / "forged.zip").write_bytes(named(b""))
    return tmp_path / "logs"


@pytest.mark.parametrize("words", [["doctor"], ["ingest", "-o", "data"], ["doctor", "--json"]])
def test_verbs_that_take_a_folder_go_on(folder: Path, words: list[str], tmp_path: Path) -> None:
    done = call(*words, folder, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    for name in ("sound00", "sound01"):
        assert name in done.stdout


def test_columns_of_one_name_are_all_read(tmp_path: Path) -> None:
    (tmp_path / "twice.parquet").write_bytes(parquet_twice())
    shown = call("show", "twice.parquet", "table", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    table = flysid.read(tmp_path / "twice.parquet")["table"]
    assert table["x"].to_pylist() == [1.0, 2.0, 3.0]
    assert table["x_"].to_pylist() == [4.0, 5.0, 6.0]
    assert table["s.a"].to_pylist() == [7, 8, 9]
    assert table["s.a_"].to_pylist() == [10, 11, 12]


def test_a_name_in_another_encoding_is_read(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"fl\xfcg.csv")
    path.write_bytes(TABLE)
    done = call("ingest", tmp_path, "-o", "data", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [facts.log for facts in flysid.open(tmp_path / "data").facts] == ["fl\ufffdg.csv"]


def test_a_member_of_an_archive_with_a_name_longer_than_any_path_is_read(tmp_path: Path) -> None:
    (tmp_path / "long.zip").write_bytes(named(b"n" * 5000 + b".csv"))
    done = call("ingest", "long.zip", "-o", "data", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(flysid.open(tmp_path / "data").facts) == 2
