"""Row 8: every real log in `../shared/logs` against the library of the format's makers, field by field."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from soak import Budget, Campaign, Outcome
from tests.ingest.formats import test_dataflash, test_tlog, test_ulog

# frames that pymavlink loses stand in test_tlog.py; these are the logs in which it loses none
TLOGS = ("sitl_copter_500s", "sitl_copter_98s", "sitl_mavlink_flood", "sitl_vtol_v1")
BINS = ("copter_437s.bin", "pymavlink_test.BIN", "sitl_copter_49s.BIN")
DAMAGED = "corrupt_"


def subjects() -> Iterator[tuple[str, list[Callable[[], None]]]]:
    """A library, and one comparison per log."""
    yield "tlog, pymavlink", [partial(test_tlog.test_every_field_is_what_pymavlink_reads, n) for n in TLOGS]
    yield (
        "DataFlash, pymavlink",
        [partial(test_dataflash.test_every_field_is_what_dfreader_reads, n) for n in BINS],
    )
    logs = [p for p in test_ulog.REAL if not p.name.startswith(DAMAGED)]
    yield "ULog, pyulog", [partial(test_ulog.test_real_logs_equal_pyulog_bit_for_bit, p) for p in logs]


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per library; random messages against the others' decoders are in the tests."""
    goes_on = budget.clock()
    for name, comparisons in subjects():
        outcome = Outcome(name)
        for compare in comparisons if test_tlog.LOGS.is_dir() else ():
            if not goes_on():
                break
            with outcome.trial():
                try:
                    compare()
                except AssertionError as error:
                    outcome.failures.append(str(error)[:200])
        yield outcome


CAMPAIGN = Campaign(8, "agreement on real logs", run)
