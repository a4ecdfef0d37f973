"""From event to event through a Crazyflie log, and back into step behind damage.

Events carry no mark and no checksum of their own: one begins where the one before ends. An event counts where
the head behind it is sound, too: a known kind, and a time that goes on from the last one.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flysid.ingest.formats.common.clock import BACK_STEP_NS, JUMP_NS, BoolArray, IntArray
from flysid.ingest.formats.common.windows import words_from
from flysid.ingest.formats.crazyflie.layouts import ID_BYTES, TIME_BYTES, TIME_NS, Header

WINDOW_BYTES = 1 << 16
LATEST_NS = 1 << 62


@dataclass(frozen=True)
class LostBytes:
    """Bytes [start, end) that are no event, and why."""

    start: int
    end: int
    reason: str


@dataclass(frozen=True, eq=False)
class Events:
    """Events in order: (n,) where each begins, its kind, and its time in ns."""

    at: IntArray
    kind: IntArray
    time_ns: IntArray


def walk(
    view: memoryview, header: Header, stop: int, batch: int, checksum: int = 0
) -> Iterator[Events | LostBytes]:
    """The events up to `stop` in batches of about `batch` bytes, and what is lost between them.

    The last `checksum` bytes may be no event.
    """
    return _Walk(view, header, stop, (stop, stop - checksum)).run(batch)


class _Walk:
    def __init__(self, view: memoryview, header: Header, stop: int, ends: tuple[int, ...]) -> None:
        self.view = view
        self.stop = stop
        self.ends = ends
        self.start = header.end
        self.sizes = {kind: header.size_of(kind) for kind in header.kinds}
        sizes = set(self.sizes.values())
        self.spans = sizes | {one + other for one in sizes for other in sizes}  # one event, or two
        self.head = struct.Struct("<HI" if TIME_BYTES[header.version] == 4 else "<HQ")
        self.unit_ns = TIME_NS[header.version]
        self.ids = np.array(sorted(self.sizes), dtype=np.uint16)

    def run(self, batch: int) -> Iterator[Events | LostBytes]:
        found: list[tuple[int, int, int]] = []
        at = self.start
        due = at + batch
        last: int | None = None
        while at < self.stop:
            kind, time_ns, end = self.event(at)
            is_timely = end > 0 and timely(time_ns, last)
            if is_timely and (end in self.ends or self.is_head(end, time_ns)):
                found.append((at, kind, time_ns))
                last = time_ns
                at = end
            elif end and not is_timely and (end in self.ends or self.is_head(end, last)) and last is not None:
                yield from _hand_on(found)
                yield LostBytes(at, end, "an event out of time")
                at = end
            else:
                ahead = self.in_step(at + 1, last)
                follows = ahead == self.stop or (ahead - end in self.spans and self.is_head(ahead, time_ns))
                if is_timely and ahead >= end and follows:
                    found.append((at, kind, time_ns))
                    last = time_ns
                    at = end
                yield from _hand_on(found)
                if ahead > at:
                    yield LostBytes(at, ahead, "no event")
                at = max(at, ahead)
            if at >= due:
                yield from _hand_on(found)
                due = at + batch
        yield from _hand_on(found)

    def event(self, at: int) -> tuple[int, int, int]:
        """(kind, ns, end) of the event at a place; end 0 where there is none."""
        if at + self.head.size > self.stop:
            return 0, 0, 0
        kind, count = self.head.unpack_from(self.view, at)
        end = at + self.sizes.get(kind, self.stop + 1)
        return (kind, count * self.unit_ns, end) if end <= self.stop else (0, 0, 0)

    def is_head(self, at: int, last: int | None) -> bool:
        """Whether a known kind and a timely time stand here; the event itself may be cut."""
        if at + self.head.size > self.stop:
            return False
        kind, count = self.head.unpack_from(self.view, at)
        return kind in self.sizes and timely(count * self.unit_ns, last)

    def is_chain(self, at: int, last: int | None) -> bool:
        """Whether an event stands here and two heads follow it, or one and the log's end.

        One head is too little behind damage: a byte out of step, a time is 256 times as large, which may be
        within the hour, and then no true event goes on from it.
        """
        _, time_ns, end = self.event(at)
        if not end or not timely(time_ns, last):
            return False
        for _ in range(2):
            if end in self.ends:
                return True
            if not self.is_head(end, time_ns):
                return False
            _, time_ns, after = self.event(end)
            if not after:
                return True  # cut by the log's end
            end = after
        return True

    def in_step(self, start: int, last: int | None) -> int:
        """The first place from `start` on where events follow each other or the log ends."""
        for begin in range(start, self.stop, WINDOW_BYTES):
            piece = self.view[begin : min(begin + WINDOW_BYTES + 1, self.stop)]
            window = np.frombuffer(piece, dtype=np.uint8)
            if len(window) < ID_BYTES:
                break
            pairs = window[:-1].astype(np.uint16) | window[1:].astype(np.uint16) << 8
            places = begin + np.flatnonzero(np.isin(pairs, self.ids))
            for place in places[self.is_timely(places, last)].tolist():
                if self.is_chain(place, last):
                    return int(place)
        return self.stop

    def is_timely(self, places: IntArray, last: int | None) -> BoolArray:
        """(n,) whether times that could go on from the last one stand behind the ids at these places."""
        low = words_from(self.view, places + ID_BYTES, "<").astype(np.uint64)
        if self.head.size > ID_BYTES + 4:
            low |= words_from(self.view, places + ID_BYTES + 4, "<").astype(np.uint64) << np.uint64(32)
        first = 1 if last is None else max(0, last - BACK_STEP_NS)
        final = LATEST_NS if last is None else last + JUMP_NS
        return np.asarray((low >= first // self.unit_ns) & (low <= final // self.unit_ns), dtype=bool)


def timely(time_ns: int, last: int | None) -> bool:
    """Whether a time goes on from the last one: at most a second back, at most an hour ahead.

    The first is not 0: the deck starts after the vehicle, and zeros are what an unwritten page holds.
    """
    return 0 < time_ns < LATEST_NS if last is None else -BACK_STEP_NS <= time_ns - last <= JUMP_NS


def _hand_on(found: list[tuple[int, int, int]]) -> Iterator[Events]:
    """What was found so far, as arrays; the list is empty afterwards."""
    if found:
        at, kind, time_ns = (np.array(values, dtype=np.int64) for values in zip(*found, strict=True))
        found.clear()
        yield Events(at, kind, time_ns)
