"""`python -m tests.doors.hover_file FILE`: two flights an axis of `bench.structured`, as a dataset file."""

from __future__ import annotations

import sys
from dataclasses import replace

from bench.structured import flown
from flysid.datasetfile import write_dataset

if __name__ == "__main__":
    first = flown(1)
    second = [replace(segment, flight=f"{segment.flight} again") for segment in flown(2).segments]
    write_dataset(sys.argv[1], replace(first, segments=(*first.segments, *second)))
