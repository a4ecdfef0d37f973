"""What benchmark cases are made of, and how one measurement is taken.

Every measurement is one fresh process: it imports what it needs, then runs the reader once. CPU seconds and
the peak of resident memory are taken around that run; imports are counted only where a case is cold.
"""

from __future__ import annotations

import importlib
import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOGS = ROOT.parent / "shared" / "logs"
WORK = ROOT / ".bench"


@dataclass(frozen=True)
class Case:
    """One file and those who read it.

    Attributes
    ----------
    name : what is read, e.g. "tlog 150 MB to Arrow".
    file : name of the benchmark file in `.bench`.
    build : writes that file.
    ours : "module:function" that reads a path, ours.
    peers : label -> ("module:function", the ratio to reach).
    cold : count the imports too (a small log from a cold start).
    needs : the log it is built from, below `../shared/logs`.
    """

    name: str
    file: str
    build: Callable[[Path], None]
    ours: str
    peers: dict[str, tuple[str, float]]
    needs: str
    cold: bool = False


@dataclass(frozen=True)
class Measured:
    """CPU seconds and peak memory above the interpreter, in MB."""

    cpu_s: float
    peak_mb: float


def measure(target: str, path: Path, *, cold: bool, times: int) -> Measured:
    """The median of `times` runs, each in a process of its own."""
    runs = [_run_once(target, path, cold) for _ in range(times)]
    return Measured(statistics.median(r.cpu_s for r in runs), statistics.median(r.peak_mb for r in runs))


def _run_once(target: str, path: Path, cold: bool) -> Measured:
    command = [sys.executable, "-m", "bench.harness", target, str(path), "cold" if cold else "warm"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{target} on {path.name} failed:\n{done.stderr[-2000:]}")
    return Measured(**json.loads(done.stdout.splitlines()[-1]))


def resident_mb() -> float:
    """Largest resident memory of this program so far, in MB.

    Linux hands `ru_maxrss` on from the process that started this one, so its own mark is asked for first.
    """
    status = Path("/proc/self/status")
    if status.exists():
        marks = [text.split()[1] for text in status.read_text().splitlines() if text.startswith("VmHWM:")]
        if marks:
            return int(marks[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(target: str, path: str, mode: str) -> None:
    """One measurement, printed as JSON."""
    base_mb = resident_mb()
    began = time.process_time()
    module, _, function = target.partition(":")
    run = getattr(importlib.import_module(module), function)
    if hasattr(run, "prepare"):
        run.prepare()
    if mode == "warm":
        base_mb = resident_mb()
        began = time.process_time()
    kept = run(Path(path))
    cpu_s = time.process_time() if mode == "cold" else time.process_time() - began
    del kept
    print(json.dumps({"cpu_s": cpu_s, "peak_mb": resident_mb() - base_mb}))


if __name__ == "__main__":
    main(*sys.argv[1:4])
