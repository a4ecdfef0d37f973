"""Is one message really several? What headers inside a message decide, and what they do not.

DataFlash has no checksum, and the bytes A3 95 followed by a known id stand inside sound messages by chance
(in TimeUS alone every 65 ms). So a message that another one follows is believed, whatever it holds. It gives
way only where it is impossible itself: its time is out of order with its neighbours', and the headers inside
lead exactly to its end by messages whose times are in order. Where its FMT contradicts itself its length may
be wrong, and headers inside count that lead to its end, or to two messages in a row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from flysid.ingest.formats.common.clock import BACK_STEP_NS, IntArray
from flysid.ingest.formats.dataflash.layouts import (
    FMT_ID,
    IDS,
    Definition,
    Definitions,
    is_consistent,
    stated_definition,
)

HEAD = b"\xa3\x95"
LOOK_AROUND = 64
TICKS_NS = {"TimeUS": 1000, "TimeMS": 1_000_000}


@dataclass(frozen=True)
class Ids:
    """What the message ids mean at the moment.

    Attributes
    ----------
    lengths : (256,) bytes of a message; 0 where unknown.
    clocks : where a message of an id states its time: offset, bytes, nanoseconds of a count.
    doubtful : ids whose FMT contradicts itself: their length may be wrong.
    """

    lengths: IntArray
    clocks: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    doubtful: set[int] = field(default_factory=set)

    def learn(self, number: int, definition: Definition) -> None:
        """An id has been defined; a small log consists of definitions, so that each costs its own."""
        self.lengths[number] = definition.length
        self.doubtful.discard(number)
        self.clocks.pop(number, None)
        layout = definition.layout
        if layout is None:
            self.doubtful.add(number)
            return
        names = layout.dtype.names or ()
        for label, tick in TICKS_NS.items():
            if label in names and layout.dtype[label].kind == "u":
                kind, at = layout.dtype.fields[label][:2]  # type: ignore[index]
                self.clocks[number] = at + 3, kind.itemsize, tick
                break


def meaning(definitions: Definitions) -> Ids:
    """The ids as they are defined now."""
    ids = Ids(np.zeros(IDS, dtype=np.int64))
    for number, index in definitions.current.items():
        ids.learn(number, definitions.items[index])
    return ids


@dataclass(frozen=True)
class Neighbours:
    """Times that the messages before and behind a place state; None where none does.

    A time is in order where it lies between them; between two boots (the time behind is the earlier one),
    where it follows the first or leads to the second.
    """

    before: int | None
    behind: int | None

    def admit(self, time_ns: int) -> bool:
        """Whether a time is in order, but for the second that messages may be late."""
        before, behind = self._ends()
        follows = time_ns >= before - BACK_STEP_NS
        leads = time_ns <= behind + BACK_STEP_NS
        return (follows and leads) if before <= behind else (follows or leads)

    def contradict(self, time_ns: int) -> bool:
        """Whether a time is out of order with those that are known: at a log's ends only one is."""
        if self.before is None:
            return self.behind is not None and time_ns > self.behind + BACK_STEP_NS
        if self.behind is None:
            return time_ns < self.before - BACK_STEP_NS
        return not self.admit(time_ns)

    def _ends(self) -> tuple[int, int]:
        before = self.before if self.before is not None else self.behind or 0
        return before, self.behind if self.behind is not None else before


def stated_ns(data: memoryview, at: int, ids: Ids) -> int | None:
    """The time of the message at `at`; None where it states none."""
    clock = ids.clocks.get(data[at + 2])
    if clock is None or at + clock[0] + clock[1] > len(data):
        return None
    return int.from_bytes(data[at + clock[0] : at + clock[0] + clock[1]], "little") * clock[2]


def last_ns(data: memoryview, starts: Sequence[IntArray], ids: Ids) -> int | None:
    """The time that the last of the messages at `starts` states, of the last LOOK_AROUND."""
    left = LOOK_AROUND
    for some in reversed(starts):
        for at in some[::-1][:left].tolist():
            if (time_ns := stated_ns(data, at, ids)) is not None:
                return time_ns
        left -= len(some)
        if left <= 0:
            break
    return None


def next_ns(data: memoryview, at: int, ids: Ids) -> int | None:
    """The time that the first of the messages from `at` on states, as far as they follow each other."""
    for place in _chain(data, at, len(data), ids):
        if (time_ns := stated_ns(data, place, ids)) is not None:
            return time_ns
    return None


def _chain(data: memoryview, at: int, end: int, ids: Ids) -> Iterator[int]:
    """Places of messages that follow each other from `at` on, LOOK_AROUND at most."""
    for _ in range(LOOK_AROUND):
        if at + 3 > end or data[at : at + 2] != HEAD or not ids.lengths[data[at + 2]]:
            return
        yield at
        at += int(ids.lengths[data[at + 2]])


def is_several(
    data: memoryview, span: tuple[int, int], heads: IntArray, ids: Ids, near: Callable[[], Neighbours]
) -> bool:
    """Whether the bytes of one message are really several.

    Parameters
    ----------
    span : where it begins and ends.
    heads : where headers stand inside it.
    near : finds the times around it, where they are needed.
    """
    start, end = span
    is_doubtful = data[start + 2] in ids.doubtful
    own_ns = stated_ns(data, start, ids)
    if not is_doubtful and own_ns is None:
        return False
    around = near()
    if not is_doubtful and own_ns is not None and not around.contradict(own_ns):
        return False
    for at in heads.tolist():
        inner = list(_chain(data, at, end, ids))
        reaches = bool(inner) and inner[-1] + int(ids.lengths[data[inner[-1] + 2]]) == end
        if is_doubtful and (reaches or len(inner) > 1):
            return True
        if reaches and _are_in_order(data, inner, ids, around):
            return True
    return False


def _are_in_order(data: memoryview, inner: list[int], ids: Ids, near: Neighbours) -> bool:
    """Whether all of these messages state times that rise from one neighbour to the other, or are FMTs."""
    last = near.before or 0
    behind = near.behind
    for at in inner:
        if data[at + 2] == FMT_ID and is_consistent(*stated_definition(data, at)):
            continue
        time_ns = stated_ns(data, at, ids)
        if time_ns is None or time_ns < last or (behind is not None and time_ns > behind):
            return False
        last = time_ns
    return behind is not None
