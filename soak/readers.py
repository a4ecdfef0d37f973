"""What campaigns over all log formats share: an outcome per format, its memory, equal shares of the time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from soak import Budget, Outcome, peak_memory
from tests.format_trials import CARRIED, FORMATS, Ask, at_risk, intact, records_of

MEMORY_MB = 512
HANG_S = 5.0


def each_format(
    budget: Budget, trials: Callable[[str, Ask], Outcome], names: Sequence[str] = (*FORMATS, *CARRIED)
) -> Iterator[Outcome]:
    """Run trials on every format; memory above 512 MB and trials above 5 s are failures too."""
    names = budget.chosen(names)
    for name, share in zip(names, budget.shares(max(1, len(names))), strict=False):
        for record in records_of(name):  # what the judge needs is no part of the reader's memory
            at_risk(name, record.start)
        intact(name)
        memory = Outcome(name)
        with peak_memory(memory):
            outcome = trials(name, share.clock())
        outcome.peak_mb = memory.peak_mb
        if (outcome.peak_mb or 0) > MEMORY_MB:
            outcome.failures.append(f"{outcome.peak_mb:.0f} MB of memory")
        if (outcome.slowest_s or 0) > HANG_S:
            outcome.failures.append(f"a trial took {outcome.slowest_s:.1f} s")
        yield outcome
