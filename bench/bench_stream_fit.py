"""Models fitted from a dataset on disk: peak of memory against rows, and the numbers of a fit in memory.

    python -m bench.bench_stream_fit [ROWS [ROWS_PER_SEGMENT]]

Writes a dataset of ROWS samples (100 million by default, about 1.5 GB) and one of a hundredth in a temporary
folder; fits each in a process of its own. Prints CPU seconds and the peak of that process's memory, libraries
included; fails above 300 MB and the bare interpreter, or where the small fit is 1e-9 off the one in memory.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.bench_model import ROOT, siso
from flysid.dataset import Dataset, Segment, Signal
from flysid.datasetfile import open_dataset, write_dataset
from flysid.model.arx import ARX
from flysid.model.fir import FIR
from flysid.model.iv import IV
from flysid.model.statespace import StateSpace

LIMIT_MB = 300.0
HEAD = Dataset(0.01, (Signal("u"),), (Signal("y"),), (), "bench")
FITS: dict[str, Any] = {
    "ARX(4,4)": ARX(na=4, nb=4, nk=1, refine=False),
    "FIR(50)": FIR(taps=50),
    "IV4(4,4)": IV(na=4, nb=4, nk=1),
    "state space, order 4": StateSpace(order=4, method="pbsid", past=10, refine=False),
}


def segments(rows: int, size: int) -> Iterator[Segment]:
    for number in range(0, rows, size):
        u, y = siso(min(size, rows - number), seed=number)
        yield Segment(u, y, t0_ns=number * 10**9, flight=f"flight-{number}")


def coefficients(model: Any) -> Any:
    """Numbers that do not hang on a choice of coordinates."""
    if hasattr(model, "flat"):
        return model.flat
    s = model.realisation
    return np.stack([s.c @ np.linalg.matrix_power(s.a, i) @ np.hstack([s.b, s.k]) for i in range(8)])


def peak_mb() -> float:
    """Of this program alone: `ru_maxrss` would start with the parent's."""
    status = Path("/proc/self/status").read_text("ascii")
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def one(name: str, path: str, compare: bool) -> dict[str, float]:
    """CPU seconds, peak megabytes and the largest relative difference to the fit in memory."""
    began = time.process_time()
    model = FITS[name].fit(open_dataset(path))
    found = {"s": time.process_time() - began, "mb": peak_mb(), "off": 0.0}
    if compare:
        disk = coefficients(model)
        memory = coefficients(FITS[name].fit(open_dataset(path).read()))
        found["off"] = float(np.abs(disk - memory).max() / np.abs(memory).max())
    return found


def bare_mb() -> float:
    """Peak of an interpreter that does nothing."""
    code = "print(int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0]) / 1024)"
    return float(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)


def main(rows: int = 100_000_000, size: int = 1_000_000) -> int:
    worst = 0.0
    off = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for count in (rows // 100, rows):
            path = Path(folder) / f"{count}.parquet"
            began = time.process_time()
            write_dataset(path, HEAD, segments(count, size))
            print(
                f"{count:,} rows written, {path.stat().st_size / 1e6:,.0f} MB, "
                f"{time.process_time() - began:.0f} s"
            )
            for name in FITS:
                command = [sys.executable, "-m", "bench.bench_stream_fit", "--one", name, str(path)]
                command += ["compare"] * (count < rows)
                done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
                if done.returncode:
                    raise SystemExit(f"{name} failed:\n{done.stderr[-2000:]}")
                found = json.loads(done.stdout.splitlines()[-1])
                worst = max(worst, found["mb"])
                off = max(off, found["off"])
                print(
                    f"  {name:22s} {found['s']:7.2f} CPU s {found['mb']:7.1f} MB  off {found['off']:.1e}",
                    flush=True,
                )
    above = worst - bare_mb()
    print(f"peak {above:.0f} MB above the bare interpreter (limit {LIMIT_MB:.0f}), ", end="")
    print(f"largest difference {off:.1e} (limit 1e-9)")
    return int(above > LIMIT_MB or off > 1e-9)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(one(sys.argv[2], sys.argv[3], "compare" in sys.argv)))
    else:
        sys.exit(main(*(int(a) for a in sys.argv[1:3])))
