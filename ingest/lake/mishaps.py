"""What goes wrong in a flight so that its rest tells nothing of the vehicle: crash, dead motor, failsafe.

The log's own words, its attitude, and its sensors: a log that breaks off after an impact states nothing.
"""

from __future__ import annotations

from flysid.ingest.align.resample import FOREVER
from flysid.ingest.align.signals import Log
from flysid.ingest.lake.attitude_lost import failures
from flysid.ingest.lake.clocked import ClockedLog
from flysid.ingest.lake.crash import Crash, find_crash
from flysid.ingest.lake.failures import Mishap


def mishaps(log: Log) -> list[Mishap]:
    """All that spoils a flight, in order of boot and time."""
    stated = [found for found in failures(log) if found.spoils]
    flight = ClockedLog(log)
    crash = find_crash(flight)
    if crash is None:
        return stated
    felt = _as_mishap(crash, flight)
    if any(m.ends and m.boot == felt.boot and m.span[0] <= felt.span[0] for m in stated):
        return stated
    return sorted([*stated, felt], key=lambda m: (m.boot, m.span))


def _as_mishap(crash: Crash, flight: ClockedLog) -> Mishap:
    """From where it began to the end of its boot."""
    boot, begin_ns = flight.clock.place(crash.begins_s)
    return Mishap(boot, (begin_ns, FOREVER), f"crash: {crash.words}", ends=True)
