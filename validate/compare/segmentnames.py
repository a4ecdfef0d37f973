"""Names of held-out segments: the flight, and the time in it."""

from __future__ import annotations

import re
from collections import Counter

from flysid.dataset import Dataset, Segment

BEGIN = "begin_s"
"""Mark of a segment: vehicle time at which its flight began, in seconds."""
_HASH = re.compile(r"-[0-9a-f]{8}(?=$|#)")


def segment_names(data: Dataset) -> tuple[str, ...]:
    """A name for every segment: its flight, and its time in the flight where the flight has several.

    The hash that ends a flight's id is left out where the rest names one flight only.

    >>> data = Dataset.from_arrays([[0.0] * 4] * 2, [[0.0] * 4] * 2, 0.1)
    >>> segment_names(data)
    ('segment-0', 'segment-1')
    """
    short = {flight: _HASH.sub("", flight) for flight in data.flights}
    taken = Counter(short.values())
    several = Counter(s.flight for s in data.segments)
    names = []
    for i, segment in enumerate(data.segments):
        name = short[segment.flight] if taken[short[segment.flight]] == 1 else segment.flight
        name = name or f"flight {i + 1}"
        names.append(name if several[segment.flight] == 1 else f"{name} {clock(_time_s(segment, data))}")
    repeated = Counter(names)
    return tuple(n if repeated[n] == 1 else f"{n} ({i + 1})" for i, n in enumerate(names))


def clock(seconds: float) -> str:
    """ "12:30": minutes and seconds since the beginning of a flight."""
    whole = round(max(0.0, seconds))
    return f"{whole // 60}:{whole % 60:02d}"


def _time_s(segment: Segment, data: Dataset) -> float:
    return segment.t0_ns * 1e-9 - begin_s(segment, data)


def begin_s(segment: Segment, data: Dataset) -> float:
    """Vehicle time at which a segment's flight began; its first segment's where the data do not say."""
    begin = segment.marks.get(BEGIN)
    if isinstance(begin, float):
        return begin
    return min(s.t0_ns for s in data.segments if s.flight == segment.flight) * 1e-9
