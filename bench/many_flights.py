"""Folders of many flights and logs of few rows: CPU seconds and memory of the commands, start-up included.

    python -m bench.bench_ingest --folder [-n 3]
    python -m bench.many_flights FLIGHTS

The flights are copies of one of 34 streams; the logs are pieces of 43 kB of the same real flight. Ends with 1
where the median of a goal is passed.
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from bench.harness import LOGS, ROOT
from flysid import manifest, store
from flysid.catalogue import catalogue
from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.opening import open_log
from flysid.ingest.formats.registry import detect
from flysid.ingest.lake.batch import Job, hash_one, ingest_one
from flysid.parts import exhaust

FLIGHTS = 10_000
LOGS_AGAIN = 300
SMALL_LOGS = 40
SIZE = 44_000
OPEN = "import sys, flysid; flysid.open(sys.argv[1])"


@dataclass(frozen=True)
class Goal:
    """A command, and what it may take."""

    name: str
    arguments: tuple[str, ...]
    cpu_s: float
    peak_mb: float


def main(times: int, flights: int = FLIGHTS) -> int:
    """Make the folder, run every command `times` times, print a line for each."""
    source = LOGS / "tlog" / "sitl_copter_98s.tlog"
    if not source.exists():
        print("skipped: ../shared/logs is not there", file=sys.stderr)
        return 0
    folder = Path(tempfile.mkdtemp(prefix="flysid-bench-"))
    try:
        logs = folder / "logs"
        data = folder / "data"
        logs.mkdir()
        blob = source.read_bytes()
        for k in range(LOGS_AGAIN):
            (logs / f"{k:03}.tlog").write_bytes(blob[:SIZE] + bytes(k))
        missed = small_logs(sorted(logs.iterdir())[:SMALL_LOGS], folder / "small")
        copy_flight(next((folder / "small" / "flights").iterdir()), data, flights)
        began = time.process_time()
        catalogue(data)
        print(f"the catalogue of {flights:,} flights made anew: {time.process_time() - began:.2f} CPU s")
        run(("-m", "flysid", "ingest", str(logs), "-q", "-o", str(data)))
        for goal in goals(data, logs, f"copy{flights // 2:05}"):
            missed |= measured(goal, times)
        return int(missed)
    finally:
        shutil.rmtree(folder)


def goals(data: Path, logs: Path, flight: str) -> list[Goal]:
    """What a folder of ten thousand flights may cost."""
    verb = ("-m", "flysid")
    return [
        Goal("ls", (*verb, "ls", str(data)), 2.0, 200),
        Goal("show FLIGHT", (*verb, "show", str(data), flight), 2.0, 200),
        Goal("flysid.open", ("-c", OPEN, str(data)), 1.0, 150),
        Goal(
            f"ingest, {LOGS_AGAIN} unchanged", (*verb, "ingest", str(logs), "-q", "-o", str(data)), 2.0, 200
        ),
    ]


def small_logs(logs: list[Path], data: Path) -> bool:
    """Logs read, and read and written, in this process, in turns; True where the goal is missed."""
    store.create_data_folder(data)
    jobs = [job for path in logs if isinstance(job := hash_one(path, Limits()), Job)]
    read = []
    whole = []
    for job in jobs:
        began = time.process_time()
        with open_log(job.path) as log:
            exhaust(log.read(detect(log.head, log.name), Limits()), lambda _: None)
        between = time.process_time()
        assert ingest_one(job, data, Limits(), replace=False).flight is not None
        read.append(between - began)
        whole.append(time.process_time() - between)
    cpu_s = statistics.median(whole)
    print(f"one log of {SIZE / 1000:.0f} kB: {1e3 * statistics.median(read):.0f} ms of CPU to read, ", end="")
    print(f"{1e3 * cpu_s:.0f} ms to read and write   (goal 40 ms)")
    return cpu_s > 0.04


def copy_flight(flight: Path, data: Path, count: int) -> None:
    """A folder of `count` flights of one content; their tables are links to the same files."""
    store.create_data_folder(data)
    text = (flight / manifest.MANIFEST_FILE).read_text("utf-8")
    sha256 = manifest.read_manifest(flight).source.sha256
    for k in range(count):
        own = f"{k:064x}"[::-1]
        copy = data / manifest.FLIGHTS / f"copy{k:05}-{own[:8]}"
        copy.mkdir()
        for table in flight.glob("*.parquet"):
            os.link(table, copy / table.name)
        (copy / manifest.MANIFEST_FILE).write_text(
            text.replace(flight.name, copy.name).replace(sha256, own), "utf-8"
        )


def measured(goal: Goal, times: int) -> bool:
    """Print the medians of a command; True where its goal is missed."""
    runs = [run(goal.arguments) for _ in range(times)]
    cpu_s, peak_mb = (statistics.median(values) for values in zip(*runs, strict=True))
    print(
        f"{goal.name:24} {cpu_s:6.2f} CPU s {peak_mb:5.0f} MB   (goal {goal.cpu_s:g} s, {goal.peak_mb:g} MB)",
        flush=True,
    )
    return bool(cpu_s > goal.cpu_s or peak_mb > goal.peak_mb)


def run(arguments: tuple[str, ...]) -> tuple[float, float]:
    """CPU seconds of a command and the processes that it starts, and its peak memory in MB."""
    child = subprocess.Popen([sys.executable, *arguments], cwd=ROOT, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    assert child.returncode in (0, 3), arguments
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


if __name__ == "__main__":
    sys.exit(main(3, int(sys.argv[1]) if len(sys.argv) > 1 else FLIGHTS))
