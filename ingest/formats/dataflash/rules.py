"""Is there a message at this place, and is it really several? The rules of `frames`, byte by byte.

Python runs them as they stand, on a memoryview and a list of rows; `kernel` compiles them as they stand, on
arrays. Hence plain loops, and -1 where a time is not known.

DataFlash has no checksum, and the bytes A3 95 followed by a known id stand inside sound messages by chance
(in TimeUS alone every 65 ms). So a message that another one follows is believed, whatever it holds. It gives
way only where it is impossible itself: its time is out of order with its neighbours', and the headers inside
lead exactly to its end by messages whose times are in order. Where its FMT contradicts itself its length may
be wrong, and headers inside count that lead to its end, or to two messages in a row.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flysid.ingest.formats.common.clock import BACK_STEP_NS, IntArray
from flysid.ingest.formats.dataflash.layouts import (
    CHARACTERS,
    FIRST_OF_NAMES,
    FMT_ID,
    HEADER_BYTES,
    IDS,
    Definition,
    Definitions,
    packed_length,
)

HEAD = b"\xa3\x95"
FIRST, SECOND = HEAD
LOOK_AROUND = 64
TICKS_NS = {"TimeUS": 1000, "TimeMS": 1_000_000}
NO_TIME = -1
LAST_NS = 1 << 62  # 146 years: later times count as this one, which is in no order
LENGTH, CLOCK, CLOCK_BYTES, TICK, DOUBTFUL = range(5)
"""The columns of an id's row: bytes of a message (0: unknown id); where its time stands, in how many bytes
(0: it states none), nanoseconds of a count; whether its FMT contradicts itself: its length may be wrong.
"""
UNKNOWN = [0] * 5
FORMAT = HEADER_BYTES + 6  # where the format of a FMT begins, behind type, length and name
FORMAT_CHARACTERS = 16
SIZES = np.full(IDS, -1, dtype=np.int64)
SIZES[list("".join(CHARACTERS).encode())] = [packed_length(c) - HEADER_BYTES for c in CHARACTERS]
Bytes = Any  # a memoryview, or an array of bytes
Rows = Any  # of the 256 ids: lists, or an array


@dataclass(frozen=True)
class Ids:
    """What the message ids mean at the moment.

    Attributes
    ----------
    lengths : (256,) bytes of a message; 0 where unknown.
    rows : of every id; see `LENGTH`.
    table : (256, 5) the same.
    """

    lengths: IntArray = field(default_factory=lambda: np.zeros(IDS, dtype=np.int64))
    rows: list[list[int]] = field(default_factory=lambda: [UNKNOWN] * IDS)
    table: IntArray = field(default_factory=lambda: np.zeros((IDS, len(UNKNOWN)), dtype=np.int64))

    def learn(self, number: int, definition: Definition) -> None:
        """An id has been defined; a small log consists of definitions, so that each costs its own."""
        self.lengths[number] = definition.length
        layout = definition.layout
        row = [definition.length, 0, 0, 0, int(layout is None)]
        names = () if layout is None else layout.dtype.names or ()
        for label, tick in TICKS_NS.items():
            if layout is not None and label in names and layout.dtype[label].kind == "u":
                kind, at = layout.dtype.fields[label][:2]  # type: ignore[index]
                row = [definition.length, at + HEADER_BYTES, kind.itemsize, tick, 0]
                break
        self.rows[number] = row
        self.table[number] = row


def meaning(definitions: Definitions) -> Ids:
    """The ids as they are defined now."""
    ids = Ids()
    for number, index in definitions.current.items():
        ids.learn(number, definitions.items[index])
    return ids


# ------------------------------------------------------------------------------------------------ bytes


def is_mark(data: Bytes, at: int) -> bool:
    """Do the two bytes that begin a header stand at `at`?"""
    return bool(at + 1 < len(data) and data[at] == FIRST and data[at + 1] == SECOND)


def length_at(data: Bytes, at: int, end: int, ids: Rows) -> int:
    """Bytes of the message whose header stands at `at`, before `end`; 0 without a header or a known id."""
    if at + HEADER_BYTES > end or not is_mark(data, at):
        return 0
    return int(ids[data[at + 2]][LENGTH])


def stated_ns(data: Bytes, at: int, ids: Rows) -> int:
    """The time of the message at `at`."""
    row = ids[data[at + 2]]
    first = at + row[CLOCK]
    last = first + row[CLOCK_BYTES]
    if row[CLOCK_BYTES] == 0 or last > len(data):
        return NO_TIME
    most = LAST_NS // row[TICK]
    count = 0
    for place in range(last - 1, first - 1, -1):
        count = count * 256 + int(data[place])
        if count > most:
            return LAST_NS
    return int(count * row[TICK])


def next_ns(data: Bytes, at: int, ids: Rows) -> int:
    """The time that the first of the messages from `at` on states, as far as they follow each other."""
    for _ in range(LOOK_AROUND):
        length = length_at(data, at, len(data), ids)
        if length == 0:
            return NO_TIME
        time_ns = stated_ns(data, at, ids)
        if time_ns != NO_TIME:
            return time_ns
        at += length
    return NO_TIME


def could_define(data: Bytes, at: int) -> bool:
    """Has the FMT at `at` a name, and a format as long as it states? See `layouts.is_consistent`."""
    if at + FORMAT + FORMAT_CHARACTERS > len(data) or not FIRST_OF_NAMES[data[at + HEADER_BYTES + 2]]:
        return False
    total = HEADER_BYTES
    for place in range(at + FORMAT, at + FORMAT + FORMAT_CHARACTERS):
        if data[place] == 0:
            break
        if SIZES[data[place]] < 0:
            return False
        total += SIZES[data[place]]
    return bool(total == data[at + HEADER_BYTES + 1])


# ------------------------------------------------------------------------------------------------ times


def is_in_order(time_ns: int, before: int, behind: int) -> bool:
    """Whether a time is in order with those of the messages before and behind; a second late is in order.

    It lies between them. Between two boots (the time behind is the earlier one) it follows the first, or it
    leads to the second.
    """
    first = before if before != NO_TIME else max(behind, 0)
    last = behind if behind != NO_TIME else first
    follows = time_ns >= first - BACK_STEP_NS
    leads = time_ns <= last + BACK_STEP_NS
    return time_ns < LAST_NS and ((follows and leads) if first <= last else (follows or leads))


def is_impossible(time_ns: int, before: int, behind: int) -> bool:
    """Whether a time is out of order with those that are known: at a log's ends only one is."""
    if before == NO_TIME:
        return behind != NO_TIME and time_ns > behind + BACK_STEP_NS
    if behind == NO_TIME:
        return time_ns < before - BACK_STEP_NS
    return not is_in_order(time_ns, before, behind)


# --------------------------------------------------------------------------------------------- messages


def is_followed(data: Bytes, content_end: int, is_last: bool, end: int, ids: Rows) -> bool:
    """Does a message, the end, or a message with one damaged header byte begin at `end`?"""
    if end >= content_end or is_mark(data, end):
        return True
    if end + HEADER_BYTES > len(data):
        return bool(is_last and end + 1 == len(data) and data[end] == FIRST)
    if data[end] == FIRST or data[end + 1] == SECOND:
        length = ids[data[end + 2]][LENGTH]
        return bool(length > 0 and (end + length >= content_end or is_mark(data, end + length)))
    return False


def is_several(data: Bytes, start: int, end: int, ids: Rows, before: int) -> bool:
    """Are the bytes of the message at `start`, behind one of the time `before`, really several messages?"""
    is_doubtful = ids[data[start + 2]][DOUBTFUL] != 0
    behind = NO_TIME
    if not is_doubtful:
        time_ns = stated_ns(data, start, ids)
        if time_ns == NO_TIME:
            return False
        behind = next_ns(data, end, ids)
        if behind == NO_TIME or not is_impossible(time_ns, before, behind):
            return False
    for at in range(start + 1, end - HEADER_BYTES + 1):
        if length_at(data, at, end, ids) and leads_on(data, at, end, ids, before, behind, is_doubtful):
            return True
    return False


def leads_on(data: Bytes, at: int, end: int, ids: Rows, before: int, behind: int, is_doubtful: bool) -> bool:
    """Do messages lead from `at` to `end`, their times rising from one neighbour's to the other's?

    Inside a message of a doubtful length two messages are enough, or one that reaches the end.
    """
    last = max(before, 0)
    is_rising = behind != NO_TIME
    count = 0
    while count < LOOK_AROUND:
        length = length_at(data, at, end, ids)
        if length == 0:
            break
        if not (data[at + 2] == FMT_ID and could_define(data, at)):
            time_ns = stated_ns(data, at, ids)
            is_rising = is_rising and last <= time_ns <= behind
            if not (is_rising or is_doubtful):
                return False
            last = time_ns
        at += length
        count += 1
    if is_doubtful:
        return at == end or count > 1
    return at == end and is_rising


def is_message(
    data: Bytes, content_end: int, is_last: bool, at: int, ids: Rows, before: int, is_behind_damage: bool
) -> bool:
    """Is there a whole message at `at`, by what follows it?"""
    length = length_at(data, at, len(data), ids)
    end = at + length
    if length == 0 or end > len(data) or not is_followed(data, content_end, is_last, end, ids):
        return False
    time_ns = stated_ns(data, at, ids) if is_behind_damage else NO_TIME
    if time_ns != NO_TIME and not is_in_order(time_ns, before, next_ns(data, end, ids)):
        return False
    return not is_several(data, at, end, ids, before)


def is_asked_about(data: Bytes, content_end: int, is_last: bool, at: int, ids: Rows) -> bool:
    """Does a header of a FMT stand at `at` that would count? What it defines is for `frames` to take in."""
    if not is_mark(data, at) or at + HEADER_BYTES > len(data) or data[at + 2] != FMT_ID:
        return False
    end = at + ids[FMT_ID][LENGTH]
    return bool(
        end <= len(data) and (could_define(data, at) or is_followed(data, content_end, is_last, end, ids))
    )


def walk(
    data: Bytes, span: tuple[int, int, int], is_last: bool, before: int, lost_at: int, ids: Rows, out: Any
) -> tuple[int, int, int, int, int]:
    """Note messages and losses, up to a FMT, the limit, or the end of the room for them.

    Parameters
    ----------
    span : where to begin, the limit, and where the content ends.
    lost_at : where the loss began that is going on; the limit where there is none.
    out : (n,) room for the places of messages, and (m, 2) for losses: first byte and end.

    Returns
    -------
    Where it stopped, the last time, where the loss that goes on began, the counts of messages and of losses.
    """
    at, limit, content_end = span
    starts, losses = out
    messages = 0
    lost = 0
    while messages < len(starts) and lost < len(losses):
        if lost_at != limit:
            while at < limit:
                if data[at] == FIRST and is_mark(data, at):  # a call at every byte takes longer than all else
                    if is_asked_about(data, content_end, is_last, at, ids):
                        return at, before, lost_at, messages, lost
                    if is_message(data, content_end, is_last, at, ids, before, True):
                        break
                at += 1
            if at >= limit:
                return at, before, lost_at, messages, lost
            losses[lost][0] = lost_at
            losses[lost][1] = at
            lost += 1
            lost_at = limit
        if at >= min(limit, content_end) or is_asked_about(data, content_end, is_last, at, ids):
            break
        if is_message(data, content_end, is_last, at, ids, before, False):
            starts[messages] = at
            messages += 1
            time_ns = stated_ns(data, at, ids)
            before = before if time_ns == NO_TIME else time_ns
            at += ids[data[at + 2]][LENGTH]
        else:
            lost_at = at
            at += 1
    return at, before, lost_at, messages, lost
