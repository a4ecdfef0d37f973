"""Row 24: `flysid record` at three rates, with small buffers, killed, on disks that stall or are full."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests import link_trials


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per trial."""
    seconds = 60.0 if budget.seconds is None else min(60.0, budget.seconds / 10)
    trials: dict[str, Callable[[Path], Outcome]] = {
        "rate 1000": lambda folder: link_trials.steady(folder, 1_000, seconds, 60.0),
        "rate 5000": lambda folder: link_trials.steady(folder, 5_000, seconds, 15.0),
        "rate 20000": lambda folder: link_trials.steady(folder, 20_000, seconds, 6.0),
        "buffer": lambda folder: link_trials.small_buffer(folder, 20_000, seconds),
        "rotation by size": lambda folder: link_trials.rotated(folder, 5_000, seconds, "1MB"),
        "rotation by time": lambda folder: link_trials.rotated(folder, 5_000, seconds, "2s"),
        "full disk": lambda folder: link_trials.full_disk(folder, "1m", 20_000),
        "stalled disk": lambda folder: link_trials.stalled_disk(folder, 5_000, 10.0),
        "kill": lambda folder: link_trials.killed(folder, 100, 5_000, budget.clock()),
    }
    for name in budget.chosen(list(trials)):
        with tempfile.TemporaryDirectory() as folder:
            try:
                yield trials[name](Path(folder))
            except PermissionError as error:
                yield Outcome(name, remark=f"not tried: {error}")


CAMPAIGN = Campaign(24, "recording links", run)
