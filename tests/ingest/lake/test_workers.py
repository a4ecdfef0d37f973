"""Tasks within bounds: whatever a task does to its process costs no other task, and is named."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from collections import deque
from functools import partial
from pathlib import Path

import pytest

from flysid import store
from flysid.cli.bounds import MEMORY, TIME, quantity
from flysid.errors import WriteError
from flysid.ingest.formats.base import Limits, Parts
from flysid.ingest.formats.mavlink import reader
from flysid.ingest.lake import batch
from flysid.ingest.lake.workers import Bounds, Lost, anonymous_bytes, ended_how, run_bounded
from tests.hostile_tasks import act, read_or_act
from tests.samplelogs import mcap, tlog

ROOT = Path(__file__).resolve().parents[3]
TIGHT = Bounds(memory_bytes=300 * 10**6, seconds=3.0)
LINUX = pytest.mark.skipif(not anonymous_bytes(os.getpid()), reason="memory is watched on Linux only")
WHY = {
    "endless": "took longer than 3 s",
    "grows": "needs more memory than 0.3 GB",
    "crash": "crashed (SIGSEGV)",
    "killed": "was killed by the system",
    "exit": "ended with code 9",
}


def outcomes(kinds: list[str], bounds: Bounds, workers: int = 2) -> dict[str, str | Lost]:
    return dict(run_bounded(act, kinds, workers, bounds))


@LINUX
def test_what_ends_a_worker_is_named_and_costs_one_task() -> None:
    found = outcomes(["first", "crash", "killed", "exit", "huge", "last"], TIGHT)
    assert {k: v for k, v in found.items() if isinstance(v, str)} == {
        "first": "first",
        "huge": "refused",
        "last": "last",
    }
    for kind in ("crash", "killed", "exit"):
        lost = found[kind]
        assert isinstance(lost, Lost)
        assert WHY[kind] in lost.reason


def test_bounds_can_be_lifted() -> None:
    assert outcomes(["a", "b"], Bounds(None, None), workers=1) == {"a": "a", "b": "b"}


def test_what_a_task_raises_ends_the_run() -> None:
    with pytest.raises(WriteError, match="disk full") as raised:
        outcomes(["raise"], TIGHT)
    assert raised.value.path == "there"


@LINUX
def test_one_hostile_log_does_not_take_the_batch_down(tmp_path: Path) -> None:
    for name in (*WHY, "good", "better"):
        (tmp_path / f"{name}.tlog").write_bytes(tlog.build() + name.encode())
    hashed = [batch.hash_one(path, Limits()) for path in sorted(tmp_path.glob("*.tlog"))]
    jobs = deque[batch.Task](job for job in hashed if isinstance(job, batch.Job))
    data = store.create_data_folder(tmp_path / "data")
    done = list(batch._done(partial(read_or_act, data=data), jobs, 2, TIGHT, data))
    results = [found for _, found in done if isinstance(found, batch.Result)]
    reasons = {r.path.stem: r.reason for r in results}
    assert set(reasons) == {*WHY, "good", "better"}
    assert {name: r for name, r in reasons.items() if WHY.get(name, "") not in r} == {}
    assert sorted(m.source.name for m in store.list_flights(data)) == ["better.tlog", "good.tlog"]
    assert len(list((data / "flights").iterdir())) == 2, "what lost workers had begun is gone"


@pytest.mark.parametrize("begun", [False, True], ids=["at once", "amid its parts"])
def test_a_log_that_memory_is_too_small_for_is_named_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begun: bool
) -> None:
    read = reader.read

    def starved(*_: object) -> Parts:
        if begun:
            yield from read(memoryview(tlog.build()), "a.tlog", Limits())
        raise MemoryError

    (tmp_path / "a.tlog").write_bytes(tlog.build())
    job = batch.hash_one(tmp_path / "a.tlog", Limits())
    assert isinstance(job, batch.Job)
    monkeypatch.setattr(reader, "read", starved)
    data = store.create_data_folder(tmp_path / "data")
    result = batch.ingest_one(job, data, Limits(), replace=False)
    assert (result.flight, result.reason) == (None, batch.NO_MEMORY)
    assert not list((data / "flights").iterdir())


@LINUX
def test_workers_do_not_outlive_their_parent() -> None:
    code = (
        "import multiprocessing as m\n"
        "from flysid.ingest.lake.workers import *\n"
        "from tests.hostile_tasks import act\n"
        "if __name__ == '__main__':\n"
        "    run = run_bounded(act, ['first', 'endless'], 1, Bounds())\n"
        "    print(next(run), m.active_children()[0].pid, flush=True)\n"
        "    next(run)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, cwd=ROOT, env=environment
    ) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline().split()[-1])
        assert Path(f"/proc/{pid}").exists()
        parent.kill()
    deadline = time.monotonic() + 60
    while Path(f"/proc/{pid}/statm").exists() and _is_running(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not _is_running(pid)


def _is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(
    ("text", "units", "value"),
    [
        ("2GB", MEMORY, 2e9),
        ("1.5 GiB", MEMORY, 1.5 * 2**30),
        ("10min", TIME, 600),
        ("90", TIME, 90),
        ("none", TIME, None),
    ],
)
def test_quantities_have_units(text: str, units: dict[str, float], value: float | None) -> None:
    assert quantity(text, units) == value


@pytest.mark.parametrize(
    "arguments", [["--max-memory", "2 apples"], ["--max-memory", "1MB"], ["--max-time", "-3s"]]
)
def test_bounds_that_are_none_are_refused(arguments: list[str]) -> None:
    command = [sys.executable, "-m", "flysid", "ingest", "x.tlog", *arguments]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert found.returncode == 2
    assert "Error" in found.stderr


@LINUX
def test_the_command_names_the_bound(tmp_path: Path) -> None:
    sample = ROOT / "sample_logs" / "01-steps-seed2.tlog"
    (tmp_path / "a.tlog").write_bytes(sample.read_bytes() * 20)
    command = [sys.executable, "-m", "flysid", "ingest", "a.tlog", "--max-time", "1ms"]
    found = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert found.returncode == 1
    assert "took longer than 0.001 s" in found.stderr


@LINUX
def test_a_file_of_33_kB_that_expands_to_1_GiB_is_refused_within_the_bound(tmp_path: Path) -> None:
    """What it would take is 2 GB with the format's own library; here 300 MB are enough to skip it."""
    import zstandard

    from tests.samplelogs.mcap import record

    size = 1 << 30
    packer = zstandard.ZstdCompressor(level=3).compressobj(size=size)
    zeros = bytes(1 << 24)
    packed = b"".join(packer.compress(zeros) for _ in range(size // len(zeros))) + packer.flush()
    head = (
        struct.pack("<QQQI", 0, 1, size, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed))
    )
    log = mcap.build()

    bomb = log[: mcap.records(log)[2].start] + record(6, head + packed) + log[mcap.records(log)[2].start :]

    assert len(bomb) < 60_000
    (tmp_path / "bomb.mcap").write_bytes(bomb)
    command = [
        sys.executable,
        "-m",
        "flysid",
        "ingest",
        "bomb.mcap",
        "--max-memory",
        "300MB",
        "--max-time",
        "1min",
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert found.returncode == 3, found.stderr
    assert f"chunk declares {size} bytes" in found.stderr
    assert "120 records" in found.stderr


def test_tasks_may_be_added_while_the_run_goes_on() -> None:
    tasks = deque(["first", "second"])
    seen = []
    for task, _ in run_bounded(act, tasks, 2, Bounds()):
        seen.append(task)
        if len(seen) == 2:
            tasks.append("third")
    assert sorted(seen) == ["first", "second", "third"]


def test_a_file_that_is_cut_while_it_is_read_is_named_as_the_reason() -> None:
    assert "cut short" in ended_how(-signal.SIGBUS)
