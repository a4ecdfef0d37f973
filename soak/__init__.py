"""Long campaigns, one module `row_<number>_<words>.py` per row of the catalogue in `docs/reliability.md`.

A module offers `CAMPAIGN = Campaign(row=..., name=..., run=...)`; nothing else registers it. `run` takes a
Budget and yields one Outcome per subject (a format, a verb, a fault). It stops where the budget's time is
up and says how many trials it made. `python -m soak` runs campaigns, each in a process of its own, and
writes their outcomes into that page.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")


@dataclass(frozen=True)
class Budget:
    """What a campaign may spend.

    Attributes
    ----------
    seconds : wall time of the whole campaign; None for as long as its full size takes.
    subjects : try these only; all where there are none.
    seed : of a campaign that draws a fresh one otherwise; the others have one of their own.
    """

    seconds: float | None = None
    subjects: tuple[str, ...] = ()
    seed: int | None = None

    def chosen(self, names: Sequence[str]) -> list[str]:
        """Those of the subjects' names that shall be tried."""
        return [name for name in names if not self.subjects or name in self.subjects]

    def shares(self, count: int) -> list[Budget]:
        """The budget in `count` equal parts, one per subject."""
        return [Budget(None if self.seconds is None else self.seconds / count)] * count

    def clock(self) -> Callable[[], bool]:
        """A question that begins now: is there time left?"""
        if self.seconds is None:
            return lambda: True
        stop = time.monotonic() + self.seconds
        return lambda: time.monotonic() < stop


@dataclass
class Outcome:
    """What became of one subject; becomes one line of the table.

    Attributes
    ----------
    subject : what was tried, e.g. the name of a format.
    trials : how often.
    kept, lost : rows over all trials; None where the campaign does not count rows.
    raised : trials that ended in an error that flysid raises on purpose.
    failures : what should not have been, one text each; none means that the promise held.
    peak_mb : largest resident memory above the start of the campaign, in MB.
    slowest_s : wall time of the slowest trial.
    remark : anything else worth a line.
    """

    subject: str
    trials: int = 0
    kept: int | None = None
    lost: int | None = None
    raised: int = 0
    failures: list[str] = field(default_factory=list)
    peak_mb: float | None = None
    slowest_s: float | None = None
    remark: str = ""

    def keep(self, kept: int, of: int) -> None:
        """Count rows kept in a trial, and those lost of the `of` that the intact subject has."""
        self.kept = (self.kept or 0) + kept
        self.lost = (self.lost or 0) + max(0, of - kept)

    def judge(
        self,
        seeds: Iterable[int],
        goes_on: Callable[[], bool],
        draw: Callable[[int], T],
        faults: Callable[[T], Iterable[str]],
        rows: Callable[[T], int],
    ) -> None:
        """Draw and judge a subject of each seed while there is time: all of its rows are kept, or none."""
        for seed in seeds:
            if not goes_on():
                break
            drawn = draw(seed)
            with self.trial():
                found = list(faults(drawn))
            self.failures += [f"seed {seed}: {fault}" for fault in found]
            self.keep(0 if found else rows(drawn), rows(drawn))

    @contextmanager
    def trial(self) -> Iterator[None]:
        """Count and time one trial."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.trials += 1
            self.slowest_s = max(self.slowest_s or 0.0, time.perf_counter() - began)


@dataclass(frozen=True)
class Campaign:
    """A long test: the row of the catalogue that it answers, its name, and what to run."""

    row: int
    name: str
    run: Callable[[Budget], Iterator[Outcome]]


@contextmanager
def peak_memory(outcome: Outcome) -> Iterator[None]:
    """Note the largest resident memory inside the block, above what was resident at its start (Linux)."""
    if not _CLEAR.exists():
        yield
        return
    _CLEAR.write_text("5")  # forget the peak so far
    base = _kilobytes("VmRSS")
    try:
        yield
    finally:
        outcome.peak_mb = max(outcome.peak_mb or 0.0, (_kilobytes("VmHWM") - base) / 1024)


def _kilobytes(name: str) -> int:
    lines = _STATUS.read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name + ":"))
