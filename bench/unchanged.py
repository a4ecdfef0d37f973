"""`flysid ingest` over 50 logs that it has ingested before: wall time of the command, start-up included.

    python -m bench.bench_ingest --unchanged

The logs are 50 different pieces of 650 kB of a real flight. Ends with 1 where the median passes 2 s.
"""

from __future__ import annotations

import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.harness import LOGS, ROOT

COUNT = 50
SIZE = 650_000
PROMISED_S = 2.0


def main(times: int) -> int:
    """Ingest, then measure the same command again."""
    source = LOGS / "tlog" / "sitl_copter_500s.tlog"
    if not source.exists():
        print("skipped: ../shared/logs is not there", file=sys.stderr)
        return 0
    folder = Path(tempfile.mkdtemp())
    try:
        blob = source.read_bytes()
        (folder / "logs").mkdir()
        for k in range(COUNT):
            at = k * (len(blob) - SIZE) // COUNT
            (folder / "logs" / f"{k:02}.tlog").write_bytes(blob[at : at + SIZE])
        run(folder, "first time")
        walls = [run(folder, "unchanged") for _ in range(times)]
    finally:
        shutil.rmtree(folder)
    return int(statistics.median(walls) > PROMISED_S)


def run(folder: Path, label: str) -> float:
    """One run of the command; its wall time in s."""
    command = [sys.executable, "-m", "flysid", "ingest", str(folder / "logs"), "-o", str(folder / "data")]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"{COUNT} logs, {label:10} {wall:6.2f} s wall {cpu:6.2f} CPU s   {done.stderr.splitlines()[-1]}")
    return wall
