"""Rows that came late because the loop that writes them was late, and not because rows are missing.

A flight controller that numbers its rounds tells both apart: where the number goes on as it does elsewhere,
no row is missing, and nothing was measured meanwhile. Simulators on a busy machine stand still for tens of
milliseconds at a time.
"""

from __future__ import annotations

import numpy as np

from flysid.flight import TIME
from flysid.flightwriter import int_values
from flysid.ingest.align.resample import IntArray
from flysid.ingest.align.signals import Log
from flysid.ingest.align.values import column_values

COUNTER = "loopIteration"
"""The field of a blackbox that numbers the rounds of its loop."""


def late_rows(log: Log, stream: str, *, longest_s: float = 0.25) -> IntArray:
    """(L,) times (ns) of rows whose next one came late, with no round missing between them.

    `longest_s`: a longer pause is a gap whatever the rounds say: the vehicle moved on unseen.
    """
    none = np.zeros(0, dtype=np.int64)
    if stream not in log.rows or COUNTER not in log.columns(stream):
        return none
    table = log.table(stream, [TIME, COUNTER])
    time = int_values(table[TIME])
    if len(time) < 2:
        return none
    rounds = np.diff(column_values(table, COUNTER).astype(np.int64))
    passed = np.diff(time)
    usual = (rounds > 0) & (rounds <= np.median(rounds))
    late = usual & (passed > np.median(passed)) & (passed <= longest_s * 1e9)
    return np.asarray(time[:-1][late])
