"""One real flight predicts another under that one's settings, beside "nothing changed".

`python -m bench.one_flight [LOGS]`: of ../shared/logs/blackbox, every ordered pair of flights of one
vehicle that differ in the gains of an axis: all of hiro's, and greenreaper's that follow each other.
Printed per pair: the median error over the band that both flights know, dB, of the prediction and of the
first flight's own response; by how much the response was predicted to change, and to what it was known; the
share of lines whose measured response lies in the interval. Then the medians over all pairs, and over those
whose change is known.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from flysid.errors import DataError
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.workers import Bounds
from flysid.loops.known_axis import KnownAxis
from flysid.loops.stick_response import closed_loop

LOGS = Path("../shared/logs/blackbox")
AXES = ("roll", "pitch")


def read(paths: list[Path], folder: Path) -> list[Any]:
    """Logs in the order of their names."""
    list(ingest_logs(find_logs(paths, Bounds()), folder, bounds=Bounds()))
    return sorted(open_lake(folder).logs, key=lambda log: str(log.name))


def known(log: Any, axis: str) -> KnownAxis | None:
    """None where the flight does not determine the loop."""
    try:
        return KnownAxis.of([log], axis)
    except DataError:
        return None


def pairs(flights: list[KnownAxis], *, all_of_them: bool) -> Iterator[tuple[KnownAxis, KnownAxis]]:
    """Those whose gains differ."""
    found = itertools.permutations(flights, 2) if all_of_them else itertools.pairwise(flights)
    return ((a, b) for a, b in found if a.last.controller.gains != b.last.controller.gains)


def compare(first: KnownAxis, later: KnownAxis) -> dict[str, float]:
    """Errors of one pair."""
    low, high = max(first.f[0], later.f[0]), min(first.f[-1], later.f[-1])
    at, of = ((own.f >= low) & (own.f <= high) for own in (later, first))
    law = later.last.controller
    true = later.answers(law)[0][at]  # under its own law: as it was measured
    told, draws = (part[..., of] for part in first.answers(law))
    before = first.answers(first.last.controller)[0][of]
    loop = later.last.loop
    lines = np.isin(loop.f, later.f[at])
    measured = closed_loop(loop.mean)[lines]
    reach = np.quantile(np.abs(draws + closed_loop(loop.draws)[:, lines] - measured - told), 0.95, axis=0)
    ends = np.quantile(20.0 * np.log10(np.abs(draws)), (0.025, 0.975), axis=0)
    return {
        "predicted": _decibels(told / true),
        "unchanged": _decibels(before / true),
        "moved": _decibels(told / before),
        "known to": float(0.5 * np.median(np.ptp(ends, axis=0))),
        "held": float(np.mean(np.abs(measured - told) <= reach)),
    }


def _decibels(ratio: Any) -> float:
    return float(np.median(np.abs(20.0 * np.log10(np.abs(ratio)))))


def main(where: Path) -> None:
    """Print the pairs and their medians."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("hiro", "greenreaper"):
            logs = read(sorted(where.glob(f"{name}_*")), Path(folder) / name)
            for axis in AXES:
                flights = [own for log in logs if (own := known(log, axis)) is not None]
                for first, later in pairs(flights, all_of_them=name == "hiro"):
                    found = compare(first, later)
                    rows.append(found)
                    gains = " -> ".join(
                        ",".join(f"{v:g}" for v in own.last.controller.gains.values())
                        for own in (first, later)
                    )
                    print(f"{name} {axis} {gains}: " + ", ".join(f"{k} {v:.2f}" for k, v in found.items()))
    for words, kept in (
        ("all", rows),
        ("change known", [row for row in rows if row["moved"] >= row["known to"]]),
        ("change not known", [row for row in rows if row["moved"] < row["known to"]]),
    ):
        if kept:
            medians = ", ".join(f"{k} {np.median([row[k] for row in kept]):.2f}" for k in kept[0])
            wins = sum(row["predicted"] < row["unchanged"] for row in kept)
            print(f"{words}: {len(kept)} pairs, median {medians}; nearer than nothing changed: {wins}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else LOGS)
