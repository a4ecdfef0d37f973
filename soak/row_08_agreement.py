"""Row 8: every real log in `../shared/logs` against another reader of its format, field by field.

That is the library of the format's makers where there is one. Of Crazyflie no real log is at hand; a decoder
of the published layout reads the sample. Packed logs and captures are compared with what is in them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from soak import Budget, Campaign, Outcome
from tests.ingest.formats import (
    test_blackbox,
    test_captures,
    test_crazyflie,
    test_dataflash,
    test_mavlogdump,
    test_packed,
    test_parquetlog,
    test_tlog,
    test_ulog,
)

# frames that pymavlink loses stand in test_tlog.py; these are the logs in which it loses none
TLOGS = ("sitl_copter_500s", "sitl_copter_98s", "sitl_mavlink_flood", "sitl_vtol_v1")
BINS = ("copter_437s.bin", "pymavlink_test.BIN", "sitl_copter_49s.BIN")
DAMAGED = "corrupt_"
PRINTED_BINS = ("pymavlink_test.BIN", "copter_437s.bin")
TABLES = ("ardrone2_flight_nav_198hz", "ardrone2_flight_optitrack_120hz")
BLACKBOX_BYTES = 1 << 20  # of each: the other decoder reads half a megabyte a second


def subjects() -> Iterator[tuple[str, list[Callable[[], None]]]]:
    """A library, and one comparison per log."""
    yield "tlog, pymavlink", [partial(test_tlog.test_every_field_is_what_pymavlink_reads, n) for n in TLOGS]
    yield (
        "DataFlash, pymavlink",
        [partial(test_dataflash.test_every_field_is_what_dfreader_reads, n) for n in BINS],
    )
    logs = [p for p in test_ulog.REAL if not p.name.startswith(DAMAGED)]
    yield "ULog, pyulog", [partial(test_ulog.test_real_logs_equal_pyulog_bit_for_bit, p) for p in logs]
    yield (
        "blackbox, betaflight-chirp-core",
        [partial(test_blackbox.compare_with_chirp_core, p, BLACKBOX_BYTES) for p in test_blackbox.REAL],
    )
    yield (
        "crazyflie, plain decoder",
        [partial(test_crazyflie.test_every_event_is_what_a_plain_decoder_reads, v) for v in (1, 2)],
    )
    yield (
        "mavlogdump, pymavlink",
        [
            test_mavlogdump.test_every_field_of_a_telemetry_log_is_what_the_log_itself_says,
            *(
                partial(test_mavlogdump.test_every_field_of_a_dataflash_log_is_what_the_log_itself_says, n)
                for n in PRINTED_BINS
            ),
        ],
    )
    yield (
        "parquet, pandas",
        [
            partial(test_parquetlog.test_a_real_flight_is_what_pandas_reads_and_what_its_csv_says, n)
            for n in TABLES
        ],
    )
    yield "pcap and pcapng, the log itself", [partial(test_captures.compare_with_the_log, n) for n in TLOGS]
    yield "packed, the log itself", [partial(test_packed.compare_with_the_log, p) for p in test_packed.REAL]


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
