"""What ArduPilot calls the field that tells instances apart, for logs and tables that state no units."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from flysid.flight import KEY_IF_SEVERAL

INSTANCE_NAMES = ("I", "Instance", "Inst", "IMU", "C")
"""IMU in VIBE, C of the cores of an estimator. It stands behind the time."""
TIMES = ("TimeUS", "TimeMS")


def table_key(names: Sequence[str]) -> dict[str, str]:
    """The key of a table that was printed of one message, as schema metadata; empty where it has none."""
    found = [name for before, name in pairwise(names) if before in TIMES and name in INSTANCE_NAMES]
    return {KEY_IF_SEVERAL: found[0]} if found else {}
