"""Row 36: the peak of memory of `flysid ingest` on forged logs of every carrier, under the default limits."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.forged_logs import FORGED

MOST_MB = 400
CHILD = """
import contextlib, ctypes, json, os, resource, subprocess, sys
ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER: workers outlive the command by a moment
done = subprocess.run([sys.executable, "-m", "flysid", *sys.argv[1:]], capture_output=True, text=True)
with contextlib.suppress(ChildProcessError):
    while True:
        os.wait()
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([done.returncode, done.stderr[-300:], used.ru_maxrss / 1024, used.ru_utime + used.ru_stime]))
"""


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per carrier; the largest process counts, the worker that reads or the command itself."""
    goes_on = budget.clock()
    carriers: dict[str, Outcome] = {}
    for kind, (suffix, build) in FORGED.items():
        carrier = kind.partition(",")[0]
        if not goes_on() or carrier not in budget.chosen([carrier]):
            continue
        outcome = carriers.setdefault(carrier, Outcome(carrier, peak_mb=0.0))
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder, f"forged{suffix}")
            log.write_bytes(build())
            size = log.stat().st_size
            with outcome.trial():
                code, said, peak_mb, _ = ingested(log)
        outcome.peak_mb = max(outcome.peak_mb or 0.0, peak_mb)
        outcome.raised += code == 1
        outcome.remark += f"; {kind}: {size:,} bytes" if outcome.remark else f"{kind}: {size:,} bytes"
        if peak_mb > MOST_MB:
            outcome.failures.append(f"{kind}: {peak_mb:.0f} MB")
        if code not in (0, 1, 3) or "Traceback" in said:
            outcome.failures.append(f"{kind}: exit {code}: {said}")
    yield from carriers.values()


def ingested(log: Path) -> tuple[int, str, float, float]:
    """Exit code, last words, megabytes of the largest process and seconds of CPU of `flysid ingest LOG`."""
    command = [sys.executable, "-c", CHILD, "ingest", str(log), "-o", str(log.parent / "data"), "-j", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    code, said, peak_mb, seconds = json.loads(done.stdout)
    return code, said, peak_mb, seconds


CAMPAIGN = Campaign(36, "memory of forged logs", run)
