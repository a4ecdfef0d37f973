"""Row 7: coverage-guided fuzzing of every reader, checksums repaired; an hour for each unless told otherwise.

Each reader is fuzzed in a process of its own, so that a crash of compiled code is a failure like others.
Inputs that fail are left in `.bench/fuzz`; each becomes a small test before it is deleted.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from soak.fuzz_reader import FOUND, last_input
from soak.readers import HANG_S, MEMORY_MB
from tests.format_trials import CARRIED, FORMATS

HOUR_S = 3600.0
GRACE_S = 120.0
ROOT = Path(__file__).resolve().parents[1]


def fuzz_apart(name: str, seconds: float) -> Outcome:
    """The outcome of one reader; where its process dies or hangs, a failure that names the input."""
    FOUND.mkdir(parents=True, exist_ok=True)
    words = [sys.executable, "-m", "soak.fuzz_child", name, str(seconds), str(time.time_ns())]
    try:
        done = subprocess.run(
            words, cwd=ROOT, capture_output=True, text=True, timeout=seconds + GRACE_S, check=False
        )
        if done.returncode == 0:
            return Outcome(**json.loads(done.stdout))
        fault = f"ended with {done.returncode}: {done.stderr[-300:]}"
    except subprocess.TimeoutExpired:
        fault = "hangs"
    kept = last_input(name).rename(FOUND / f"{name}-fatal-{time.time_ns()}")
    return Outcome(name, failures=[f"{kept.name}: {fault}"])


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format; memory above 512 MB and trials above 5 s are failures too."""
    names = budget.chosen([*FORMATS, *CARRIED])
    each = HOUR_S if budget.seconds is None else budget.seconds / max(1, len(names))
    for name in names:
        outcome = fuzz_apart(name, each)
        if (outcome.peak_mb or 0) > MEMORY_MB:
            outcome.failures.append(f"{outcome.peak_mb:.0f} MB of memory")
        if (outcome.slowest_s or 0) > HANG_S:
            outcome.failures.append(f"a trial took {outcome.slowest_s:.1f} s")
        outcome.remark += f", {each / 60:.3g} min"
        yield outcome


CAMPAIGN = Campaign(7, "coverage-guided fuzzing", run)
