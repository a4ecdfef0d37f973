"""`python -m tests.doors.hover_file FILE`: three flights of `bench.structured`, all axes in each."""

from __future__ import annotations

import sys
from dataclasses import replace

from bench.structured import flown
from flysid.datasetfile import write_dataset

SEEDS = (1, 2, 3)
APART_NS = 10**12

if __name__ == "__main__":
    data = [flown(seed) for seed in SEEDS]
    segments = [
        replace(segment, flight=f"flight-{seed}", t0_ns=n * APART_NS)
        for seed, one in zip(SEEDS, data, strict=True)
        for n, segment in enumerate(one.segments)
    ]
    write_dataset(sys.argv[1], replace(data[0], segments=tuple(segments)))
