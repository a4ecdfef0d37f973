"""Rows that came late, with no round of the loop missing, cut no segment; missing rows do."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa

from flysid.ingest.align.late import late_rows
from flysid.ingest.align.resample import spans_between_gaps

MS = 1_000_000


def log(time_ms: list[int], rounds: list[int], counter: str = "loopIteration") -> Any:
    """A log of one stream."""
    table = pa.table({"time_ns": np.array(time_ms) * MS, counter: rounds})
    return SimpleNamespace(
        rows={"main": len(time_ms)},
        columns=lambda _: table.column_names,
        table=lambda _, names: table.select(names),
    )


def test_a_round_that_came_late_is_no_gap() -> None:
    time = [0, 2, 4, 64, 66, 68]
    late = late_rows(log(time, [0, 2, 4, 6, 8, 10]), "main")
    assert late.tolist() == [4 * MS]
    stamps = np.array(time) * MS
    assert spans_between_gaps(stamps, 10 * MS, late_ns=late) == [(0, 68 * MS + 1)]
    assert len(spans_between_gaps(stamps, 10 * MS)) == 2


def test_missing_rounds_a_restart_and_a_standstill_are_gaps() -> None:
    assert len(late_rows(log([0, 2, 4, 64, 66, 68], [0, 2, 4, 40, 42, 44]), "main")) == 0
    assert len(late_rows(log([0, 2, 4, 64, 66, 68], [10, 12, 14, 0, 2, 4]), "main")) == 0
    assert len(late_rows(log([0, 2, 4, 904, 906, 908], [0, 2, 4, 6, 8, 10]), "main")) == 0


def test_a_log_without_a_counter_has_no_late_rows() -> None:
    assert len(late_rows(log([0, 2, 4, 64, 66], [0, 2, 4, 6, 8], "number"), "main")) == 0
    assert len(late_rows(log([0], [0]), "main")) == 0
    assert len(late_rows(log([0, 2], [0, 2]), "other")) == 0
