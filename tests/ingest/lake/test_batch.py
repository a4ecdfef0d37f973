"""Many logs at once: found, recognised, read in parallel; one bad file never stops the rest."""

from __future__ import annotations

import hashlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from flysid import store
from flysid.errors import UsageError, WriteError
from flysid.ingest.formats import registry
from flysid.ingest.formats.base import Limits
from flysid.ingest.lake import batch
from flysid.ingest.lake.batch import Result, ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.workers import Bounds
from tests.samplelogs import dataflash, tlog

ROOT = Path(__file__).resolve().parents[3]


def write_logs(folder: Path, count: int) -> list[Path]:
    """Tlogs that differ in their last heartbeat."""
    folder.mkdir(parents=True, exist_ok=True)
    mav = tlog.sender(7)
    paths = []
    for i in range(count):
        extra = tlog.stamped(tlog.EPOCH_US + 9_000_000, tlog.frame(mav, mav.heartbeat_encode(2, 3, 0, i, 4)))
        paths.append(folder / f"flight{i:03}.tlog")
        paths[-1].write_bytes(tlog.build() + extra)
    return paths


def run(*given: Path | str, data: Path, jobs: int = 1, force: bool = False) -> list[Result]:
    return list(
        ingest_logs(find_logs(given), data, jobs=jobs, force=force, bounds=None if jobs == 1 else Bounds())
    )


def tree_hash(data: Path) -> str:
    """Of all visible files, names and contents."""
    digest = hashlib.sha256()
    for path in sorted(p for p in data.rglob("*") if p.is_file() and not p.name.startswith(".")):
        digest.update(str(path.relative_to(data)).encode() + path.read_bytes())
    return digest.hexdigest()


def test_files_folders_and_patterns_name_logs(tmp_path: Path) -> None:
    write_logs(tmp_path / "a", 3)
    write_logs(tmp_path / "a" / "deep", 1)
    (tmp_path / "a" / "notes.md").write_text("no log")
    (tmp_path / "a" / ".hidden.tlog").write_text("no log")
    assert len(find_logs([tmp_path / "a"]).paths) == 4
    assert len(find_logs([str(tmp_path / "a" / "*.tlog")]).paths) == 3
    assert len(find_logs([str(tmp_path / "**" / "*.tlog"), tmp_path / "a" / "flight000.tlog"]).paths) == 4
    assert find_logs([tmp_path / "a" / "notes.md"]).paths == (tmp_path / "a" / "notes.md",)


@pytest.mark.parametrize("missing", ["nowhere", "nowhere/*.tlog", "empty"])
def test_what_is_not_there_is_the_users_fault(tmp_path: Path, missing: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError):
        find_logs([str(tmp_path / missing)])


def test_one_and_two_workers_write_the_same_bytes(tmp_path: Path) -> None:
    write_logs(tmp_path / "logs", 3)
    for jobs in (1, 2):
        results = run(tmp_path / "logs", data=tmp_path / f"data{jobs}", jobs=jobs)
        assert all(r.flight for r in results)
    assert tree_hash(tmp_path / "data1") == tree_hash(tmp_path / "data2")


def test_unchanged_logs_are_known_by_content_not_by_name(tmp_path: Path) -> None:
    first, second = write_logs(tmp_path, 2)
    run(first, data=tmp_path / "data")
    first.rename(tmp_path / "renamed.tlog")
    results = run(tmp_path / "renamed.tlog", second, data=tmp_path / "data")
    assert sorted((r.path.name, r.unchanged) for r in results) == [
        ("flight001.tlog", False),
        ("renamed.tlog", True),
    ]
    forced = run(second, data=tmp_path / "data", force=True)
    assert [r.unchanged for r in forced] == [False]
    assert len(store.list_flights(tmp_path / "data")) == 2


def test_the_same_log_twice_in_one_run_is_read_once(tmp_path: Path) -> None:
    (log,) = write_logs(tmp_path, 1)
    (tmp_path / "copy.tlog").write_bytes(log.read_bytes())
    results = run(log, tmp_path / "copy.tlog", data=tmp_path / "data")
    assert sum(r.flight is not None and not r.unchanged for r in results) == 1
    assert [m.source.name for m in store.list_flights(tmp_path / "data")] == [log.name]


def make_bad_files(folder: Path) -> set[str]:
    """Ten things that look like logs by their names, and are none."""
    (folder / "empty.tlog").write_bytes(b"")
    (folder / "text.tlog").write_text("hello\n" * 100)
    (folder / "zeros.bin").write_bytes(bytes(4000))
    (folder / "picture.bin").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 4)
    os.mkfifo(folder / "pipe.tlog")
    (folder / "loop.tlog").symlink_to(folder / "loop.tlog")
    (folder / "gone.tlog").symlink_to(folder / "not there")
    (folder / "random.ulg").write_bytes(hashlib.sha256(b"x").digest() * 50)
    (folder / "words.mcap").write_text("MCAP, by name only\n" * 20)
    plug = socket.socket(socket.AF_UNIX)
    plug.bind(os.path.relpath(folder / "socket.tlog"))
    plug.close()
    return {p.name for p in folder.iterdir() if not p.name.startswith("flight")}


@pytest.mark.parametrize("jobs", [1, 2])
def test_bad_files_are_named_and_the_rest_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jobs: int
) -> None:
    monkeypatch.chdir(tmp_path)
    write_logs(tmp_path / "l", 6)
    (tmp_path / "l" / "flight.bin").write_bytes(dataflash.build())
    bad = make_bad_files(tmp_path / "l")
    results = run(tmp_path / "l", data=tmp_path / "data", jobs=jobs)
    skipped = {r.path.name: r.reason for r in results if r.skipped}
    assert set(skipped) == bad
    assert len(bad) == 10
    assert all(skipped.values())
    assert len(store.list_flights(tmp_path / "data")) == 7


def test_a_reader_that_breaks_costs_only_its_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs = write_logs(tmp_path, 2)

    def detect(head: bytes, name: str) -> object:
        if name == logs[0].name:
            raise ZeroDivisionError("a bug")
        return original(head, name)

    original = registry.detect
    monkeypatch.setattr("flysid.ingest.formats.registry.detect", detect)
    results = run(*logs, data=tmp_path / "data")
    (reason,) = [r.reason for r in results if r.skipped]
    assert "damaged or hostile: its reader stopped with ZeroDivisionError: a bug" in reason
    assert len(store.list_flights(tmp_path / "data")) == 1


def test_a_folder_that_cannot_be_written_stops_the_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pyarrow.parquet.ParquetWriter.write_table", full)
    with pytest.raises(WriteError, match="No space left"):
        run(*write_logs(tmp_path / "logs", 2), data=tmp_path / "data")
    monkeypatch.undo()
    assert len(run(tmp_path / "logs", data=tmp_path / "data")) == 2


def test_a_log_that_is_still_growing_is_left_alone(tmp_path: Path) -> None:
    (log,) = write_logs(tmp_path, 1)
    prepared = batch.hash_one(log, Limits())
    assert isinstance(prepared, batch.Job)
    log.write_bytes(log.read_bytes() + b"more")
    data = store.create_data_folder(tmp_path / "data")
    result = batch.ingest_one(prepared, data, Limits(), replace=False)
    assert "changed while it was being read" in result.reason


def test_a_killed_ingest_goes_on_where_it_was(tmp_path: Path) -> None:
    write_logs(tmp_path / "logs", 8)
    command = [sys.executable, "-m", "flysid", "ingest", str(tmp_path / "logs"), "-j", "1", "-q", "-o"]
    whole = subprocess.run([*command, str(tmp_path / "whole")], cwd=ROOT, capture_output=True, check=True)
    assert len(whole.stdout.splitlines()) == 8
    data = tmp_path / "data"
    child = subprocess.Popen([*command, str(data)], cwd=ROOT, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not list((data / "flights").glob("[!.]*")):
        time.sleep(0.005)
    child.send_signal(signal.SIGKILL)
    child.wait()
    assert all(m.rows for m in store.list_flights(data))
    subprocess.run([*command, str(data)], cwd=ROOT, capture_output=True, check=True)
    assert tree_hash(data) == tree_hash(tmp_path / "whole")


CUT = """
import sys, threading, time
from pathlib import Path
from flysid.ingest.formats.base import Limits
from flysid.ingest.lake.batch import hash_one
path = Path(sys.argv[1])
with path.open("wb") as file:
    file.write(b"log")
    file.truncate(1 << 34)
found = []
hashing = threading.Thread(target=lambda: found.append(hash_one(path, Limits())))
hashing.start()
time.sleep(0.1)
assert hashing.is_alive()
with path.open("r+b") as file:
    file.truncate(10)
hashing.join()
print(found[0].size)
"""


def test_a_log_that_is_cut_while_it_is_hashed_ends_no_process(tmp_path: Path) -> None:
    command = [sys.executable, "-c", CUT, str(tmp_path / "a.tlog")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert 0 < int(done.stdout) < 1 << 34


def test_of_copies_the_first_is_read_however_many_workers_there_are(tmp_path: Path) -> None:
    (log,) = write_logs(tmp_path / "logs", 1)
    for name in ("a", "b", "c"):
        (tmp_path / "logs" / f"{name}.tlog").write_bytes(log.read_bytes())
    results = run(tmp_path / "logs", data=tmp_path / "data", jobs=2)
    assert [r.path.name for r in results if not r.skipped] == ["a.tlog"]
    assert sum("the same content" in r.reason for r in results) == 3
