"""Finding DataFlash messages in bytes.

    message   A3 95, id u8, body whose length the id's FMT states

There is no checksum. A message is accepted only where another header (or the end of the file) follows at
its stated length, or where what follows is plainly the next message with its header damaged; a FMT also where
it agrees with itself. Headers inside it count only where it is impossible itself (`rules`). Behind damage it
must also state a time in order with its neighbours', if any: a header by chance inside a message whose own
header is lost could pass for one. Everything else is skipped up to the next message that can be accepted, and
counted.
Trailing 00 or FF is padding, not loss.

Cost: headers are found by comparing whole batches; a clean stretch is one array comparison.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.flight import Damage, Region
from flysid.ingest.formats.common.clock import IntArray
from flysid.ingest.formats.common.windows import windows
from flysid.ingest.formats.dataflash.layouts import (
    FMT_ID,
    HEADER_BYTES,
    IDS,
    Definitions,
    is_consistent,
    may_define,
    stated_definition,
)
from flysid.ingest.formats.dataflash.rules import (
    HEAD,
    LOOK_AROUND,
    NO_TIME,
    Ids,
    is_message,
    is_several,
    length_at,
    meaning,
    stated_ns,
)

LOOK_AHEAD = 4096
FIRST_STRETCH = 512
FIRST_HEADS = 8  # most damage costs a message or two: these few are sooner asked than compared
HEAD_BLOCK = 1 << 18
MIN_PADDING = 16
COMPILE_AFTER = 10_000  # looks: Python spends 0.2 to 1 s on them, and 0.5 s on loading the compiled rules
ROOM = 1 << 14  # messages and losses that the compiled rules note at a time
CodeArray = npt.NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class Messages:
    """Messages of a batch in file order: offsets in `buffer`, and the index of each one's definition."""

    buffer: npt.NDArray[np.uint8]
    start: IntArray
    code: CodeArray

    def __len__(self) -> int:
        return len(self.start)


@dataclass(eq=False)
class _Batch:
    """The bytes of a batch and every place where a header could be."""

    data: memoryview
    raw: npt.NDArray[np.uint8]
    heads: IntArray
    ids: npt.NDArray[np.uint8]
    limit: int
    is_last: bool
    end: int  # where the content ends: before trailing padding
    before_ns: int  # what the last message stated, of earlier batches or of those looked at
    starts: list[IntArray] = field(default_factory=list)  # messages accepted so far
    looked_at: int = 0  # of `starts`
    looks: int = 0  # at headers one by one, since the log began

    def last_ns(self, ids: Ids) -> int:
        """The time that the last message so far stated; garbage asks for it at every other byte."""
        left = LOOK_AROUND
        for some in reversed(self.starts[self.looked_at :]):
            for at in some[::-1][:left].tolist():
                if (time_ns := stated_ns(self.data, at, ids.rows)) != NO_TIME:
                    self.before_ns = time_ns
                    left = 0
                    break
            left -= len(some)
            if left <= 0:
                break
        self.looked_at = len(self.starts)
        return self.before_ns


def _room() -> tuple[IntArray, IntArray]:
    """Where compiled rules note messages, and losses."""
    return np.empty(ROOM, dtype=np.int64), np.empty((ROOM, 2), dtype=np.int64)


@dataclass
class Walker:
    """Walks messages batch by batch; keeps the definitions and the account of lost bytes."""

    definitions: Definitions = field(default_factory=Definitions)
    bytes_skipped: int = 0
    region_count: int = 0
    regions: list[Region] = field(default_factory=list)
    truncated: bool = False
    padding: int = 0
    unknown: dict[int, int] = field(default_factory=dict)
    _lost_at: int | None = None
    _reason: str = ""
    _last_ns: int = NO_TIME
    _looks: int = 0
    _room: tuple[IntArray, IntArray] = field(default_factory=_room)
    _ids: Ids = field(init=False)
    _codes: CodeArray = field(init=False)  # (256,) the definition of every id

    def __post_init__(self) -> None:
        self._ids = meaning(self.definitions)
        self._codes = np.zeros(IDS, dtype=np.uint16)
        for number, index in self.definitions.current.items():
            self._codes[number] = index

    def walk(self, content: memoryview, base: int, limit: int) -> tuple[Messages, int]:
        """Messages that start in content[:limit], and where in the file the next batch begins.

        `content` must reach LOOK_AHEAD bytes beyond `limit`, except at the end, where limit == len(content).
        """
        batch = _prepare(content, limit, self._last_ns)
        batch.looks = self._looks
        data = content
        ids, codes = self._ids, self._codes
        kinds: list[CodeArray] = []
        position = self._search(batch, base, 0, ids) if self._lost_at is not None else 0
        while position < min(limit, batch.end) and self._lost_at is None:
            if _is_costly(batch):
                position = self._leap(batch, base, position, ids)
                if self._lost_at is not None:
                    position = self._search(batch, base, position, ids)
                    continue
            elif not _is_definition(batch, position):
                position = _clean_stretch(batch, position, ids)
            if position >= min(limit, batch.end):
                break
            if self._accepts(batch, position, ids):
                batch.starts.append(np.array([position], dtype=np.int64))
                number = data[position + 2]
                if number == FMT_ID:
                    kinds.extend(codes[batch.raw[found + 2]] for found in batch.starts[len(kinds) : -1])
                    self._define(data, position)
                    kinds.append(codes[[number]])
                position += int(ids.lengths[number])
            else:
                self._note_reason(data, position, ids.lengths)
                self._lost_at = base + position
                position = self._search(batch, base, position + 1, ids)
        if batch.is_last:
            self.padding, position = len(data) - max(position, batch.end), len(data)
        kinds.extend(codes[batch.raw[found + 2]] for found in batch.starts[len(kinds) :])
        start = np.concatenate(batch.starts) if batch.starts else np.empty(0, np.int64)
        code = np.concatenate(kinds) if kinds else np.empty(0, np.uint16)
        self._last_ns = batch.last_ns(ids)
        self._looks = batch.looks
        return Messages(batch.raw, start, code), base + position

    @property
    def lengths(self) -> IntArray:
        """(256,) bytes of a message of each id, as it is defined now; 0 where unknown."""
        return self._ids.lengths

    def damage(self) -> Damage:
        """What was lost so far."""
        return Damage(self.bytes_skipped, tuple(self.regions), self.region_count, truncated=self.truncated)

    def _accepts(self, batch: _Batch, at: int, ids: Ids) -> bool:
        """Is there a whole message at `at`, by what follows it, or a FMT that agrees with itself?"""
        data = batch.data
        length = length_at(data, at, len(data), ids.rows)
        if length == 0 or at + length > len(data):
            return False
        if data[at + 2] == FMT_ID and is_consistent(*stated_definition(data, at)):
            return True
        is_lost = self._lost_at is not None
        before = batch.last_ns(ids)
        return is_message(data, batch.end, batch.is_last, at, ids.rows, before, is_lost)

    def _define(self, data: memoryview, at: int) -> None:
        """Take in the FMT at `at`."""
        stated = stated_definition(data, at)
        if self.definitions.add(*stated):
            number = stated[0]
            index = self.definitions.current[number]
            self._ids.learn(number, self.definitions.items[index])
            self._codes[number] = index

    def _note_reason(self, data: memoryview, at: int, lengths: IntArray) -> None:
        if data[at : at + 2] != HEAD or at + 2 >= len(data):
            self._reason = "no message header"
        elif lengths[data[at + 2]] == 0:
            self._reason = f"no format known for message {data[at + 2]}"
            self.unknown[data[at + 2]] = self.unknown.get(data[at + 2], 0) + 1
        else:
            self._reason = "message not followed by another"

    def _search(self, batch: _Batch, base: int, begin: int, ids: Ids) -> int:
        """Go on at the next acceptable message from `begin` on, or at the end of the batch."""
        for at in () if _is_costly(batch) else _likely(batch, begin, ids.lengths):
            batch.looks += 1
            if self._accepts(batch, at, ids):
                self._close(base + at, self._reason)
                return at
            if _is_costly(batch):
                begin = at + 1
                break
        while _is_costly(batch) and begin < batch.limit:
            begin = self._leap(batch, base, begin, ids)
            if self._lost_at is None:
                return begin
            if begin < batch.limit and self._accepts(batch, begin, ids):
                self._close(base + begin, self._reason)
                return begin
            begin += 1
        if not batch.is_last:
            return batch.limit
        lost = (self._lost_at or 0) - base
        self.truncated = _is_cut(batch, max(lost, 0), ids.lengths)
        end = len(batch.data) if self.truncated else batch.end
        self._close(base + end, "cut off inside a message" if self.truncated else self._reason)
        return end

    def _leap(self, batch: _Batch, base: int, begin: int, ids: Ids) -> int:
        """Go on by compiled rules from `begin`: to a FMT that may count, or to the end of what is at hand."""
        position = begin
        is_full = True
        starts, losses = self._room
        while is_full:
            began = batch.limit if self._lost_at is None else self._lost_at - base
            position, batch.before_ns, lost_at, messages, lost = _compiled_walk()(
                batch.raw,
                (position, batch.limit, batch.end),
                batch.is_last,
                batch.last_ns(ids),
                began,
                ids.table,
                (starts, losses),
            )
            batch.starts.append(starts[:messages].copy())
            batch.looked_at = len(batch.starts)
            self._note_losses(batch, base, losses[:lost], ids)
            if lost_at == batch.limit:
                self._lost_at = None
            elif self._lost_at is None:
                self._note_reason(batch.data, lost_at, ids.lengths)
                self._lost_at = base + lost_at
            is_full = ROOM in (messages, lost)
        return position

    def _note_losses(self, batch: _Batch, base: int, losses: IntArray, ids: Ids) -> None:
        """Note (n, 2) losses that are over: first byte and end."""
        if self._lost_at is not None and len(losses):
            self._close(base + int(losses[0, 1]), self._reason)
            losses = losses[1:]
        room = max(0, Damage.MAX_REGIONS - len(self.regions))
        for first, end in losses[:room].tolist():
            self._note_reason(batch.data, first, ids.lengths)
            self._lost_at = base + first
            self._close(base + end, self._reason)
        rest = losses[room:]
        if not len(rest):
            return
        self.bytes_skipped += int((rest[:, 1] - rest[:, 0]).sum())
        self.region_count += len(rest)
        is_mark = (batch.raw[rest[:, 0]] == HEAD[0]) & (batch.raw[rest[:, 0] + 1] == HEAD[1])
        numbers = batch.raw[rest[is_mark, 0] + 2]
        counts = np.bincount(numbers[ids.lengths[numbers] == 0], minlength=IDS)
        for number in np.flatnonzero(counts).tolist():
            self.unknown[number] = self.unknown.get(number, 0) + int(counts[number])

    def _close(self, end: int, reason: str) -> None:
        start = self._lost_at
        self._lost_at = None
        if start is None or start >= end:
            return
        self.bytes_skipped += end - start
        self.region_count += 1
        if len(self.regions) < Damage.MAX_REGIONS:
            self.regions.append(Region(start, end, reason))


@cache
def _compiled_walk() -> Any:
    """`rules.walk`, compiled."""
    from flysid.ingest.formats.dataflash.kernel import walk

    return walk


def _is_costly(batch: _Batch) -> bool:
    """Has so much been looked at that compiled rules are worth their while?"""
    return batch.looks > (0 if _compiled_walk.cache_info().currsize else COMPILE_AFTER)


def _prepare(data: memoryview, limit: int, before_ns: int) -> _Batch:
    raw = np.frombuffer(data, dtype=np.uint8)
    is_last = limit >= len(data)
    heads = find_heads(raw)
    end = _content_end(raw) if is_last else len(raw)
    return _Batch(data, raw, heads, raw[heads + 2], limit, is_last, end, before_ns)


def find_heads(raw: npt.NDArray[np.uint8]) -> IntArray:
    """Offsets of A3 95 with an id behind it, found in blocks that stay in the processor's cache."""
    found = []
    for first in range(0, len(raw) - 2, HEAD_BLOCK):
        last = min(first + HEAD_BLOCK, len(raw) - 2)
        is_mark = (raw[first:last] == HEAD[0]) & (raw[first + 1 : last + 1] == HEAD[1])
        found.append(np.flatnonzero(is_mark) + first)
    return np.concatenate(found) if found else np.empty(0, np.int64)


def _content_end(raw: npt.NDArray[np.uint8]) -> int:
    """Where trailing padding (at least 16 bytes of 00 or of FF) begins."""
    for byte in (0x00, 0xFF):
        end = len(raw)
        while end:
            other = np.flatnonzero(raw[max(0, end - HEAD_BLOCK) : end] != byte)
            if len(other):
                end = max(0, end - HEAD_BLOCK) + int(other[-1]) + 1
                break
            end = max(0, end - HEAD_BLOCK)
        if len(raw) - end >= MIN_PADDING:
            return end
    return len(raw)


def _is_definition(batch: _Batch, at: int) -> bool:
    """Whether a FMT's header stands at `at`: a stretch of other messages is over before it begins."""
    head = batch.data[at : at + HEADER_BYTES]
    return bool(head[:2] == HEAD) and len(head) == HEADER_BYTES and head[2] == FMT_ID


def _clean_stretch(batch: _Batch, position: int, ids: Ids) -> int:
    """Accept messages from `position` on that follow each other exactly; returns where they end.

    Stops at a FMT, at the limit, or at damage. Headers inside a message are passed over one at a time.
    """
    lengths = ids.lengths
    index = int(np.searchsorted(batch.heads, position))
    size = FIRST_STRETCH
    while index < len(batch.heads) and batch.heads[index] == position and position < batch.limit:
        heads = batch.heads[index : index + size]
        step = lengths[batch.ids[index : index + size]]
        good = (heads[:-1] + step[:-1] == heads[1:]) & (step[:-1] > 0)
        good &= (batch.ids[index : index + len(heads) - 1] != FMT_ID) & (heads[:-1] < batch.limit)
        count = int(good.argmin()) if not good.all() else len(good)
        batch.starts.append(heads[:count])
        index += count
        position = int(batch.heads[index])
        size = min(size * 4, 1 << 20)
        if count == len(good) and count:
            continue
        number = batch.ids[index]
        end = position + int(lengths[number])
        after = int(np.searchsorted(batch.heads, end))
        inside = lengths[number] > 0 and number != FMT_ID and position < batch.limit
        if not inside or after >= len(batch.heads) or batch.heads[after] != end:
            break
        if _is_costly(batch) or _is_several(batch, position, end, ids):
            break
        batch.starts.append(batch.heads[index : index + 1])
        index = after
        position = end
        size = FIRST_STRETCH
    return position


def _is_several(batch: _Batch, start: int, end: int, ids: Ids) -> bool:
    """Are the bytes of the message at `start` really several messages? See `rules`."""
    first, last = np.searchsorted(batch.heads, (start + 1, end)).tolist()
    batch.looks += last - first
    return first < last and is_several(batch.data, start, end, ids.rows, batch.last_ns(ids))


def _likely(batch: _Batch, begin: int, lengths: IntArray) -> Iterator[int]:
    """The headers from `begin` on, before the limit, of messages that `rules.is_followed` could admit."""
    first = int(np.searchsorted(batch.heads, begin))
    final = int(np.searchsorted(batch.heads, batch.limit))
    size = len(batch.raw)
    near = min(first + FIRST_HEADS, final)
    yield from batch.heads[first:near].tolist()
    for start, stop in windows(near, final):
        heads = batch.heads[start:stop]
        ids = batch.ids[start:stop]
        length = lengths[ids]
        ends = heads + length
        at = np.minimum(ends, size - 2)  # a header that the end of the batch cuts is looked at closely
        follows = (ends >= size - 2) | (ends >= batch.end)
        follows |= (batch.raw[at] == HEAD[0]) | (batch.raw[at + 1] == HEAD[1])
        defines = ids == FMT_ID
        defines[defines] = may_define(batch.raw, heads[defines])
        yield from heads[(length > 0) & (ends <= size) & (follows | defines)].tolist()


def _is_cut(batch: _Batch, at: int, lengths: IntArray) -> bool:
    """Does the file end inside the message that begins at `at`?"""
    head = batch.data[at : at + HEADER_BYTES]
    if not head or not (HEAD + b"\xff").startswith(bytes(head[:2])):
        return False
    return len(head) < HEADER_BYTES or at + int(lengths[head[2]]) > len(batch.data)
