"""10,000 segments and 100 million rows: written, streamed, indexed and grouped in bounded memory.

    python -m bench.bench_dataset_stream [SEGMENTS [ROWS_PER_SEGMENT]]

Prints rows, file size, CPU seconds and the peak of memory, and fails above 1 GB or on any difference.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from flysid.dataset import Dataset, Segment, Signal
from flysid.datasetfile import open_dataset, write_dataset

LIMIT_MB = 1000.0


def segments(count: int, rows: int, first: int = 0) -> Iterator[Segment]:
    """A command in steps and an output with the resolution of a log, different in every segment."""
    for i in range(first, count):
        rng = np.random.default_rng(i)
        u = np.asarray(np.repeat(rng.integers(-200, 200, size=rows // 50 + 1), 50)[:rows] * 0.1)
        y = 0.01 * np.round(100 * (np.cumsum(u - u.mean()) * 1e-3 + rng.normal(scale=0.02, size=rows)))
        yield Segment(
            u.astype(np.float64),
            y.astype(np.float64),
            t0_ns=i * 10**12,
            flight=f"flight-{i // 10}",
            marks={"mode": "LOITER"},
        )


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    count, rows = (int(a) for a in (*sys.argv[1:], "10000", "10000")[:2])
    head = Dataset(0.02, (Signal("u", "deg", 0.1),), (Signal("y", "m/s", 0.01),), (), "bench")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.parquet"
        started = time.process_time()
        written = write_dataset(path, head, segments(count, rows))
        print(
            f"written   {written:,} rows, {path.stat().st_size / 1e6:,.0f} MB, "
            f"{time.process_time() - started:.1f} CPU s, peak {peak_mb():.0f} MB"
        )
        started = time.process_time()
        total = 0
        number = 0
        power = 0.0
        for segment in open_dataset(path):
            number += 1
            total += len(segment)
            power += float(segment.y[:, 0] @ segment.y[:, 0])
        print(
            f"streamed  {total:,} rows in {number:,} segments, "
            f"{time.process_time() - started:.1f} CPU s, peak {peak_mb():.0f} MB"
        )
        started = time.process_time()
        file = open_dataset(path)
        groups = file.group_by("flight")
        picked = [int(k) for k in np.random.default_rng(0).integers(0, count, size=20)]
        wrong = sum(
            not np.array_equal(file.segment(k).y, next(iter(segments(k + 1, rows, k))).y) for k in picked
        )
        last = sum(len(y) for _, _, y in groups[f"flight-{(count - 1) // 10}"].blocks())
        print(
            f"indexed   {len(file.entries):,} segments in {len(groups):,} groups, 20 segments at random, one "
            f"group of {last:,} rows, {time.process_time() - started:.1f} CPU s, peak {peak_mb():.0f} MB"
        )
    expected = sum(float(s.y[:, 0] @ s.y[:, 0]) for s in segments(min(count, 20), rows))
    if total != count * rows or number != count or wrong or peak_mb() > LIMIT_MB or power < expected:
        sys.exit("FAILED")


if __name__ == "__main__":
    main()
