"""Whether one file goes on where another ends, by the times of their messages.

A recorder that splits its files goes on at once: from the last message of one file to the first of the next
is no longer than from message to message inside. Files of two flights, or of two recorders at work at a
time, are further apart, or overlap.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

LAST_NS = (1 << 63) - 1  # what an array holds


@dataclass(frozen=True)
class Heard:
    """When the messages of a file were recorded.

    Attributes
    ----------
    topics : names of their topics.
    first_ns, last_ns : time of the earliest and of the latest message.
    pause_ns : the longest time without a message in between.
    """

    topics: frozenset[str]
    first_ns: int
    last_ns: int
    pause_ns: int


def heard(messages: Iterable[tuple[str, int]]) -> Heard | None:
    """What topics and times of recording, in ns, come to; None where there is no message."""
    topics: set[str] = set()
    times = array("q")
    for topic, log_ns in messages:
        topics.add(topic)
        times.append(min(log_ns, LAST_NS))
    if not times:
        return None
    every = np.sort(np.frombuffer(times, dtype=np.int64))
    pause = int(np.diff(every).max()) if len(every) > 1 else 0
    return Heard(frozenset(topics), int(every[0]), int(every[-1]), pause)


def goes_on(before: Heard, after: Heard) -> bool:
    """Whether `after` was recorded by the recorder of `before`, right behind it."""
    apart = abs(after.first_ns - before.last_ns)
    return apart <= max(before.pause_ns, after.pause_ns) and bool(before.topics & after.topics)
