"""Files and folders that are there whole or not at all; one writer at a time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from flysid import files, store
from flysid.errors import WriteError
from flysid.files import new_file, replacing_folder
from tests.flysid.test_store import SOURCE, parts, table

ROOT = Path(__file__).resolve().parents[2]
OTHER = """
import sys
from pathlib import Path
from flysid.files import new_file, replacing_folder
with (replacing_folder if sys.argv[1] == "folder" else new_file)(Path(sys.argv[2])) as incoming:
    print("begun", flush=True)
    sys.stdin.readline()
    (incoming / "whose" if sys.argv[1] == "folder" else incoming).write_text("the other's")
"""


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_two_that_write_to_one_place_do_not_mix(tmp_path: Path, kind: str) -> None:
    out = tmp_path / "out"
    making = replacing_folder if kind == "folder" else new_file
    command = [sys.executable, "-c", OTHER, kind, str(out)]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "begun\n"
        with pytest.raises(WriteError, match="another flysid is writing") as refused, making(out):
            pass
        assert str(refused.value.path) == str(out)
        other.communicate("go on\n")
        assert other.returncode == 0
    written = out / "whose" if kind == "folder" else out
    assert written.read_text() == "the other's"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_a_killed_writer_left_is_no_obstacle(tmp_path: Path, kind: str) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-c", OTHER, kind, str(out)]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "begun\n"
        other.kill()
    assert (tmp_path / ".out.lock").exists()
    with (replacing_folder if kind == "folder" else new_file)(out) as incoming:
        (incoming / "a" if kind == "folder" else incoming).write_text("mine")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


class Recorder:
    """What was asked to reach the disk, in order, and what stood in the flight's folder at that time."""

    def __init__(self, flights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.flights = flights
        self.seen: list[tuple[str, list[str]]] = []
        fsync = os.fsync
        whole = files.sync_file_system
        rename = Path.rename

        def noted_fsync(handle: int) -> None:
            self._note("fsync " + Path(os.readlink(f"/proc/self/fd/{handle}")).name)
            fsync(handle)

        def noted_whole(handle: int) -> None:
            self._note("syncfs")
            whole(handle)

        def noted_rename(path: Path, target: Path) -> Path:
            self._note("rename")
            return rename(path, target)

        monkeypatch.setattr(os, "fsync", noted_fsync)
        monkeypatch.setattr(files, "sync_file_system", noted_whole)
        monkeypatch.setattr(Path, "rename", noted_rename)

    def _note(self, what: str) -> None:
        self.seen.append((what, sorted(p.name for p in self.flights.glob(".incoming-*/*"))))


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="not Linux")
@pytest.mark.parametrize("at_once", [True, False], ids=["whole file system", "file by file"])
def test_a_flight_is_on_the_disk_before_it_is_visible(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_once: bool
) -> None:
    data = store.create_data_folder(tmp_path / "data")
    if at_once and not files.syncs_whole(data):
        pytest.skip("this file system is flushed file by file")
    if not at_once:
        monkeypatch.setattr(files, "syncs_whole", lambda _: False)
    recorder = Recorder(data / "flights", monkeypatch)
    names = [f"s{k}" for k in range(45)]
    store.write_flight(data, SOURCE, parts(*[(name, table([1, 2])) for name in names]))
    whole = sorted(["manifest.json", *(f"{name}.parquet" for name in names)])
    syncs = [what for what, _ in recorder.seen]
    if at_once:
        assert syncs == ["syncfs", "rename", "fsync flights"]
    else:
        folder = f"fsync .incoming-flight_7-abababab-{os.getpid()}"
        assert sorted(syncs[:-3]) == sorted(f"fsync {name}" for name in whole)
        assert syncs[-3:] == [folder, "rename", "fsync flights"]
    assert all(files == whole for what, files in recorder.seen if what != "fsync flights")


def test_a_disk_that_fails_on_the_way_is_named_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(_: int) -> None:
        raise OSError(5, "Input/output error")

    data = store.create_data_folder(tmp_path / "data")
    monkeypatch.setattr(files, "sync_file_system", failing)
    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(WriteError, match="Input/output error"):
        store.write_flight(data, SOURCE, parts(("s", table([1]))))
    assert list((data / "flights").iterdir()) == []
