"""CPU seconds of `flysid fit` and `flysid demo` on one core: `python -m bench.fit_seconds [NAME...]`.

On a busy machine CPU seconds grow, too: every row stands beside those of a fixed loop, before and after it.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from bench.harness import LOGS, ROOT
from flysid.model.threads import on_one_thread

FLYSID = (sys.executable, "-m", "flysid")
DT = 0.02


def lag(rows: int) -> Callable[[Path], list[str]]:
    """`flysid fit` of a table: a lag with a bend in front of it, one input, 2 % of noise."""

    def command(folder: Path) -> list[str]:
        rng = np.random.default_rng(1)
        u = np.repeat(rng.uniform(-1.0, 1.0, rows // 25 + 1), 25)[:rows]
        y = np.zeros(rows)
        for k in range(2, rows):
            y[k] = 1.9 * y[k - 1] - 0.905 * y[k - 2] + 0.005 * np.tanh(1.5 * u[k - 1])
        y += 0.02 * y.std() * rng.normal(size=rows)
        path = folder / "lag.csv"
        columns = np.column_stack([DT * np.arange(rows), u, y])
        np.savetxt(path, columns, delimiter=",", header="time_s,u,y", comments="", fmt="%.6f")
        return ["fit", str(path), "--from", "u", "--to", "y"]

    return command


def log(name: str, recipe: str) -> Callable[[Path], list[str]]:
    """`flysid fit` of a real log."""
    return lambda _: ["fit", str(LOGS / name), "--recipe", recipe]


CASES: Mapping[str, Callable[[Path], list[str]]] = {
    "px4": log("ulog/quad_position_76s.ulg", "px4-attitude"),
    "ardupilot": log("dataflash/copter_437s.bin", "ardupilot-attitude"),
    "csv": lag(1_200),
    "1e3": lag(1_000),
    "1e4": lag(10_000),
    "1e5": lag(100_000),
    "demo": lambda _: ["demo"],
}


@on_one_thread
def loop_s() -> float:
    """CPU seconds of a fixed piece of work like a fit's: small arrays, and a QR that fills the cache."""
    matrix = np.random.default_rng(0).normal(size=(4000, 12))
    begin = time.process_time()
    for _ in range(100):
        np.linalg.qr(matrix, mode="r")
        for row in matrix[:200]:
            np.sqrt(row * row + 1.0).sum()
    return time.process_time() - begin


def line(name: str) -> str:
    """One row: CPU and wall seconds of the command, and of the loop beside it."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        words = CASES[name](folder)
        target = [] if words[0] == "demo" else ["-o", str(folder / "run"), "-j", "1"]
        beside = [loop_s()]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        begin = time.perf_counter()
        done = subprocess.run(
            [*FLYSID, *words, *target, "--quiet"],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT)},  # this checkout, wherever flysid is installed from
            capture_output=True,
            text=True,
        )
        wall = time.perf_counter() - begin
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        beside.append(loop_s())
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    failed = f"  exit {done.returncode}: {done.stderr[-200:]}" if done.returncode else ""
    return f"{name:10s} {cpu:7.1f} s CPU, {wall:7.1f} s wall; loop {beside[0]:.2f}, {beside[1]:.2f} s{failed}"


def main() -> None:
    """Print a line per case; one core, so that no command starts processes whose time is not seen here."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    for name in sys.argv[1:] or CASES:
        print(line(name), flush=True)


if __name__ == "__main__":
    main()
