"""Row 11: disks that are full or read-only, files and handles that are limited; then room again."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.fault_trials import full_disks, limited, read_only_disks, write_newer_logs

SIZES = [f"{kb}k" for kb in (16, 32, 48, 64, 80, 96, 112, 128, 144, 160, 192, 224, 256, 288, 320)]
LIMITS = [f"-f {kb}" for kb in (1, 4, 8, 16, 32, 48)] + [f"-n {n}" for n in (5, 8, 10, 12, 14, 16, 20, 32)]


NEWER = ", newer formats"


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per fault."""
    trials: dict[str, Callable[[Path], Outcome]] = {
        "full disk": lambda folder: full_disks(folder, SIZES),
        "read-only disk": read_only_disks,
        "ulimit": lambda folder: limited(folder, LIMITS),
        f"full disk{NEWER}": lambda folder: full_disks(
            folder, SIZES, name=f"full disk{NEWER}", write=write_newer_logs
        ),
        f"ulimit{NEWER}": lambda folder: limited(
            folder, LIMITS, name=f"ulimit{NEWER}", write=write_newer_logs
        ),
    }
    for name in budget.chosen(tuple(trials)):
        trial = trials[name]
        with tempfile.TemporaryDirectory() as folder:
            try:
                yield trial(Path(folder))
            except PermissionError:
                yield Outcome(name, remark="not tried: this user may not mount")


CAMPAIGN = Campaign(11, "no room, no rights, no handles", run)
