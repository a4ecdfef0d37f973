"""Tables in text, against pandas."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.cases_bags import PARQUET, TARGET_BYTES
from bench.harness import LOGS, Case

HERE = "bench.cases_tables"


def build(path: Path, damaged: bool = False) -> None:
    """The real AR.Drone flight over and over as pandas writes it; `damaged`: every thousandth line is cut."""
    import pandas as pd

    flight = pd.read_parquet(LOGS / PARQUET).select_dtypes("number")
    stamp = flight.pop("stamp")
    flight.insert(0, "time_s", stamp - stamp.iloc[0])
    with path.open("w", encoding="utf-8") as out:
        turn = 0
        while out.tell() < TARGET_BYTES:
            part = flight.assign(time_s=flight["time_s"] + 75.0 * turn).to_csv(index=False, header=turn == 0)
            lines = part.splitlines(keepends=True)
            if damaged:
                lines[500::1000] = [line[: len(line) // 2] + "\n" for line in lines[500::1000]]
            out.writelines(lines)
            turn += 1


def build_damaged(path: Path) -> None:
    """The same with broken lines in every batch."""
    build(path, damaged=True)


def peer_pandas(path: Path) -> Any:
    """pandas.read_csv, lines with too few cells filled up without a word."""
    import pandas as pd

    return pd.read_csv(path)


def _prepare() -> None:
    import pandas

    del pandas


peer_pandas.prepare = _prepare  # type: ignore[attr-defined]

OURS = "bench.readers:flysid_tables"
PEERS = {"pandas": (f"{HERE}:peer_pandas", 0.5)}
CASES = (
    Case("CSV, 150 MB, to Arrow tables", "large.csv", build, OURS, PEERS, needs=PARQUET),
    Case(
        "CSV, 150 MB, damaged",
        "damaged.csv",
        build_damaged,
        OURS,
        {"pandas": (PEERS["pandas"][0], 0.1)},
        needs=PARQUET,
    ),
)
