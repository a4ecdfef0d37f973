"""Dates of GPS receivers that count weeks in ten bits: old ones fall back by 1,024 weeks, or 19.6 years.

No log of these formats is older than the autopilots that write them, so that an earlier date has lost as many
weeks as bring it behind that year.
"""

from __future__ import annotations

import numpy as np

from flysid.ingest.formats.common.clock import SECOND_NS, IntArray

ROLLOVER = 1024
WEEK_NS = 7 * 86_400 * SECOND_NS
OLDEST_NS = 1_230_768_000 * SECOND_NS
"""2009: ArduPilot and MAVLink are from that year, PX4 is younger."""


def weeks_lost(utc_ns: IntArray) -> int:
    """How many weeks dates lack; 0 where there are none, or where they are possible.

    Parameters
    ----------
    utc_ns : (n,) dates in nanoseconds since 1970.

    Examples
    --------
    >>> weeks_lost(np.array([1_092_700_800 * SECOND_NS]))  # in 2004
    1024
    """
    if not len(utc_ns):
        return 0
    missing_ns = OLDEST_NS - int(np.median(utc_ns))
    return -(-max(0, missing_ns) // (ROLLOVER * WEEK_NS)) * ROLLOVER


def note_of(weeks: int) -> str:
    """What to say of dates that lacked weeks."""
    return f"the GPS dates lay {weeks:,} weeks low, before any such autopilot; the weeks are added"
