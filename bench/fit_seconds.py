"""CPU seconds of commands on one core, ratios and exponents of cost: `python -m bench.fit_seconds [NAME...]`.

On a busy machine CPU seconds grow, too: every row stands beside those of a fixed loop, before and after it.
`growth` fits in this process: a refined ARX beside least squares of the same matrix, and the exponents of
cost in samples and in inputs.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from bench.harness import LOGS, ROOT
from flysid.dataset import Dataset
from flysid.filters import apply_filter
from flysid.model.arx import ARX
from flysid.model.statespace import StateSpace
from flysid.model.threads import on_one_thread

FLYSID = (sys.executable, "-m", "flysid")
DT = 0.02
POLES = np.asarray(np.poly([0.95, 0.9, 0.6]), dtype=np.float64)


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


def suggestions(name: str) -> Callable[[Path], list[str]]:
    """`flysid ls --suggest` of a real log."""
    return lambda _: ["ls", str(LOGS / name), "--suggest"]


CASES: Mapping[str, Callable[[Path], list[str]]] = {
    "px4": log("ulog/quad_position_76s.ulg", "px4-attitude"),
    "ardupilot": log("dataflash/copter_437s.bin", "ardupilot-attitude"),
    "csv": lag(1_200),
    "1e3": lag(1_000),
    "1e4": lag(10_000),
    "1e5": lag(100_000),
    "18e3": lag(18_000),
    "demo": lambda _: ["demo"],
    "reproduce": lambda _: ["reproduce", "ardrone-ts"],
    "ls px4": suggestions("ulog/quad_position_76s.ulg"),
    "ls betaflight": suggestions("blackbox/greenreaper_flight28.bfl"),
    "ls ardupilot": suggestions("dataflash/sitl_copter_49s.BIN"),
}
SAMPLES = (10_000, 100_000, 1_000_000)
INPUTS = (2, 4, 8, 16)


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
        target = ["-o", str(folder / "run"), "-j", "1"] if words[0] == "fit" else []
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


def lagged(rows: int, inputs: int) -> Dataset:
    """A noisy lag of third order, driven by several inputs that move apart."""
    rng = np.random.default_rng(rows + inputs)
    u = np.repeat(rng.normal(size=(rows // 10 + 1, inputs)), 10, axis=0)[:rows]
    y = apply_filter(np.array([0.0, 0.01]), POLES, u @ np.arange(1.0, inputs + 1.0))
    return Dataset.from_arrays(u, y + 0.05 * y.std() * rng.normal(size=rows), DT)


def fit_s(settings: ARX | StateSpace, data: Dataset) -> float:
    """CPU seconds of a fit in this process."""
    begin = time.process_time()
    settings.fit(data)
    return time.process_time() - begin


@on_one_thread
def least_squares_s(data: Dataset, order: int) -> float:
    """CPU seconds of NumPy's least squares of an ARX of one input."""
    (segment,) = data.segments
    at = len(segment) - order
    columns = [x[order - k : order - k + at, 0] for x in (segment.y, segment.u) for k in range(1, order + 1)]
    matrix = np.column_stack(columns)
    begin = time.process_time()
    np.linalg.lstsq(matrix, segment.y[order:, 0], rcond=None)
    return time.process_time() - begin


def exponent(sizes: Sequence[int], spent_s: Sequence[float]) -> float:
    """The power of its size that a cost grows with."""
    return float(np.polyfit(np.log(sizes), np.log(spent_s), 1)[0])


def growth() -> Iterator[str]:
    """Ratios to least squares, and exponents."""
    given = ARX(na=3, nb=3)
    for settings in (given, ARX(), StateSpace()):  # compiles
        settings.fit(lagged(500, 2))
    spent = []
    for rows in SAMPLES:
        data = lagged(rows, 1)
        spent.append(fit_s(given, data))
        least = least_squares_s(data, 3)
        yield f"ARX(3,3) refined, {rows:>9,} samples: {spent[-1]:.2f} s CPU, {spent[-1] / least:.0f} x lstsq"
    yield f"exponent in samples, {SAMPLES[0]:,} to {SAMPLES[-1]:,}: {exponent(SAMPLES, spent):.2f} (1.1)"
    for settings in (ARX(), StateSpace()):
        spent = [fit_s(settings, lagged(3_000, n)) for n in INPUTS]
        shown = ", ".join(f"{s:.2f}" for s in spent)
        yield (
            f"{type(settings).__name__}, {', '.join(map(str, INPUTS))} inputs, 3,000 samples: {shown} s CPU; "
            f"exponent {exponent(INPUTS, spent):.2f} (2)"
        )


def main() -> None:
    """Print a line per case; one core, so that no command starts processes whose time is not seen here."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    for name in sys.argv[1:] or (*CASES, "growth"):
        for text in growth() if name == "growth" else (line(name),):
            print(text, flush=True)


if __name__ == "__main__":
    main()
