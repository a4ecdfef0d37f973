"""An MCAP file as blocks of messages, front to back, through damage, with everything lost counted.

The index at the end is never needed: it is missing from cut files and wrong in damaged ones. It only serves
to know schemas and channels before the first message (their own record may be in a lost chunk).

Per chunk: check the declared size, expand, check the CRC, find the messages by the message indexes behind
the chunk where they agree with it (no loop over messages), else record by record. A chunk that fails is
skipped alone. Where a record does not hold together, the next one that does is searched from one byte on.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from functools import cached_property

import numpy as np
from mcap.opcode import Opcode

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common.compression import CompressionError
from flysid.ingest.formats.common.gather import Index
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.mcap.chunks import (
    Block,
    Contents,
    bind,
    check_bounds,
    checksum_fails,
    crc32,
    expand,
    expand_cut,
    find_indexed,
    walk,
)
from flysid.ingest.formats.mcap.records import (
    FIRST_PRIVATE,
    HEAD,
    HEAD_BYTES,
    LAST_KNOWN,
    MAGIC,
    U16,
    U32,
    U64,
    ChunkHead,
    Registry,
    chunk_head,
    is_cut_off,
    known_fields,
    message_offsets,
    next_record,
    record_end,
    string_pairs,
    strings,
)

Steps = Generator[Block, None, int]

MAX_INFO = 200
FREE_EXPANSION_BYTES = 256 << 20
SUMMARY_SEARCH_BYTES = 4 << 20
_DATA_END_HEAD = HEAD.pack(Opcode.DATA_END, 4)


class McapReader:
    """Blocks of one file. `registry` and `info` fill, and `place` advances, while `blocks` is consumed."""

    def __init__(self, view: memoryview, limits: Limits, tally: Tally) -> None:
        self.view = view
        self.registry = Registry()
        self.info: dict[str, str] = {}
        self.published = 0  # messages that have the time of their publishing only
        self.place = 0
        self._limits = limits
        self._tally = tally
        self._limit = len(view)
        self._expanded = 0
        self._chunked = False
        self._seen = self._stated = 0
        self._last = -1  # start of the record before, where it carries no checksum
        self._trusted: dict[tuple[int, int], bytes] = {}
        self._proven_from = self._limit  # up to the end, a checksum says that nothing is damaged

    def blocks(self) -> Iterator[Block]:
        """Messages in file order, in blocks of at most one chunk or `batch_bytes` of plain records."""
        self._read_summary()
        at = 0
        while at < self._limit:
            self.place = at
            end = self._record_end(at)
            if end < 0:
                at = yield from self._recover(at)
                continue
            op = self.view[at]
            self._last = -1 if op in (Opcode.CHUNK, Opcode.MESSAGE) else at
            if op == Opcode.CHUNK:
                at = yield from self._count(self._chunk(at, end))
            elif op == Opcode.MESSAGE:
                at = yield from self._count(self._plain(at))
            else:
                self._other(op, at + HEAD_BYTES, end)
                at = end
        if not self._tally.freeze().lossy and (
            self._limit == len(MAGIC) or self.view[self._limit - len(MAGIC) :] != MAGIC
        ):
            self._tally.truncated = True  # between two records: the recorder never closed the file
        if self._seen < self._stated and not self._tally.freeze().lossy:
            self._tally.undecode("(messages counted in the summary only)", self._stated - self._seen)

    def _record_end(self, at: int) -> int:
        """`record_end`, which believes any length in what its checksums prove intact."""
        end = record_end(self.view, at, self._limit)
        if end >= 0 or not (at >= self._proven_from or self._is_intact):
            return end
        return record_end(self.view, at, self._limit, intact=True)

    @cached_property
    def _is_intact(self) -> bool:
        """Whether the checksums of the data and of the summary are stated and right."""
        footer = self._footer()
        if footer < 0:
            return False
        (start,) = U64.unpack_from(self.view, footer + HEAD_BYTES)
        (crc,) = U32.unpack_from(self.view, footer + HEAD_BYTES + 16)
        data_end = (start or footer) - len(_DATA_END_HEAD) - 4
        if not len(MAGIC) <= data_end < footer:
            return False
        head = self.view[data_end : data_end + len(_DATA_END_HEAD)]
        (data_crc,) = U32.unpack_from(self.view, data_end + HEAD_BYTES)
        is_right = not start or (crc and crc32(self.view[start : footer + HEAD_BYTES + 16]) == crc)
        return bool(
            head == _DATA_END_HEAD and is_right and data_crc and crc32(self.view[:data_end]) == data_crc
        )

    def _footer(self) -> int:
        """Where the footer lies that the file ends with; -1 without one."""
        at = self._limit - len(MAGIC) - HEAD_BYTES - 20
        is_footer = at >= len(MAGIC) and self.view[at] == Opcode.FOOTER
        return at if is_footer and record_end(self.view, at, self._limit) == self._limit - len(MAGIC) else -1

    def _count(self, steps: Steps) -> Steps:
        while True:
            try:
                block = next(steps)
            except StopIteration as stop:
                return int(stop.value)
            self._seen += len(block.at)
            self.published += block.published
            yield block

    def _read_summary(self) -> None:
        """Definitions repeated behind the data, where the footer and its checksum can be believed."""
        at = self._footer()
        if at < 0:
            return
        (start,) = U64.unpack_from(self.view, at + HEAD_BYTES)
        (crc,) = U32.unpack_from(self.view, at + HEAD_BYTES + 16)
        starts = [start, *self._behind_data_end(at)] if start else []
        for start in starts:
            covered = self.view[start : at + HEAD_BYTES + 16]
            if len(MAGIC) <= start < at and (not crc or crc32(covered) == crc):
                self._define_all(start, at, bool(crc))
                self._proven_from = start if crc else self._limit
                return
        self._tally.bad_checksums += 1 if starts else 0

    def _behind_data_end(self, footer: int) -> Iterator[int]:
        """Where the summary may start if bytes were lost or inserted before it: behind a data-end record."""
        tail = bytes(self.view[max(0, footer - SUMMARY_SEARCH_BYTES) : footer])
        place = tail.rfind(_DATA_END_HEAD)
        for _ in range(8):
            if place < 0:
                return
            yield footer - len(tail) + place + len(_DATA_END_HEAD) + 4
            place = tail.rfind(_DATA_END_HEAD, 0, place)

    def _define_all(self, start: int, stop: int, checked: bool) -> None:
        while (end := record_end(self.view, start, stop, intact=checked)) > 0:
            op = self.view[start]
            body = start + HEAD_BYTES
            if op in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(op, body, end)
                if checked and end >= body + 2:
                    number = U16.unpack_from(self.view, body)[0]
                    self._trusted[op, number] = known_fields(self.view, op, body, end)
            start = end

    def _define_plain(self, op: int, body: int, end: int) -> None:
        """A definition outside chunks has no checksum: where it contradicts one that has, that one stands."""
        trusted = self._trusted.get((op, U16.unpack_from(self.view, body)[0]))
        if trusted is not None and trusted != known_fields(self.view, op, body, end):
            self._tally.bad_checksums += 1
        else:
            self._define(op, body, end)

    def _define(self, op: int, body: int, end: int) -> None:
        try:
            self.registry.define(op, bytes(self.view[body:end]))
        except ValueError:
            self._tally.undecode("schema" if op == Opcode.SCHEMA else "channel")

    def _other(self, op: int, body: int, end: int) -> None:
        if op in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define_plain(op, body, end)
        elif op == Opcode.HEADER:
            pairs = zip(("profile", "library"), strings(bytes(self.view[body:end]), 2), strict=True)
            self.info.update({key: text for key, text in pairs if text})
        elif op == Opcode.METADATA and len(self.info) < MAX_INFO:
            self.info.update(string_pairs(bytes(self.view[body:end])))
        elif op == Opcode.STATISTICS:
            (self._stated,) = U64.unpack_from(self.view, body)
        elif LAST_KNOWN < op < FIRST_PRIVATE:
            self._tally.undecode(f"(record 0x{op:02X})")
        elif op == Opcode.DATA_END:
            self._check_data(body)

    def _check_data(self, body: int) -> None:
        """The checksum of the data section; where chunks carry their own, theirs say more."""
        (crc,) = U32.unpack_from(self.view, body)
        if crc and not self._chunked and crc32(self.view[: body - HEAD_BYTES]) != crc:
            self._tally.bad_checksums += 1

    def _chunk(self, at: int, end: int) -> Steps:
        """Read the chunk at `at`; returns where to go on."""
        self._chunked = True
        head = chunk_head(self.view, at + HEAD_BYTES, end)
        assert head is not None  # record_end looked
        offsets, after = self._message_indexes(end)
        try:
            data = self._expand(head)
        except CompressionError as error:
            followed = after == self._limit or self._record_end(after) > 0
            resume = after if followed else self._next(at + 1)
            self._tally.skip(at, min(end, resume), str(error))
            if not followed:
                self._tally.skip(min(end, resume), resume, "no record here")
            return resume
        found = (find_indexed(data, offsets) if len(offsets) else None) or walk(data, 0, len(data))
        if found.stop != len(data):
            self._tally.skip(head.data_at, head.data_end, "records in the chunk do not fit it")
        yield bind(data, found, self.registry)
        return after

    def _expand(self, head: ChunkHead) -> bytes | memoryview:
        check_bounds(head, self._limits)
        self._expanded += head.size
        if self._expanded > max(FREE_EXPANSION_BYTES, self._limits.max_ratio * len(self.view)):
            raise CompressionError("the chunks of the file expand beyond the allowed ratio")
        data = expand(self.view, head)
        if checksum_fails(head, data):
            self._tally.bad_checksums += 1
            raise CompressionError("chunk checksum failed")
        return data

    def _message_indexes(self, at: int) -> tuple[Index, int]:
        """Offsets from all message indexes that follow at `at`, and where they end."""
        parts = []
        while at < self._limit and self.view[at] == Opcode.MESSAGE_INDEX:
            end = self._record_end(at)
            if end < 0:
                break
            self._last = at
            parts.append(message_offsets(self.view, at + HEAD_BYTES))
            at = end
        return (np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)), at

    def _plain(self, at: int) -> Steps:
        """Read messages outside chunks from `at` on; returns where to go on."""
        piece = self.view[at : min(self._limit, at + self._limits.batch_bytes)]
        found = walk(piece, 0, len(piece), self.registry)
        if found.stop == 0:
            return (yield from self._lone(at))
        resume = at + found.stop
        if resume < self._limit and self._record_end(resume) < 0:
            found, resume = self._doubt_last(found, at)
        yield bind(piece[: found.stop], found, self.registry)
        return resume

    def _lone(self, at: int) -> Steps:
        """One message that `walk` will not take: of an unknown channel, or larger than a batch."""
        end = record_end(self.view, at, self._limit)
        found = Contents(np.zeros(1, dtype=np.int64), (), end - at)
        yield bind(self.view[at:end], found, self.registry)
        return end

    def _doubt_last(self, found: Contents, base: int) -> tuple[Contents, int]:
        """After messages comes no record: was it the last one's length that lied, or is this garbage?

        `base` is where the places in `found` count from. Returns the messages to keep and where to go on.
        """
        last = base + int(found.messages[-1])
        stop = base + found.stop
        resume = self._next(last + 1)
        if resume >= stop:
            if is_cut_off(self.view, stop, self._limit) and resume >= self._limit:
                return found, stop
            self._tally.skip(stop, resume, "no record here")
            return found, resume
        self._tally.skip(last, resume, "record of a wrong length")
        return Contents(found.messages[:-1], (), found.stop), resume

    def _next(self, at: int) -> int:
        return next_record(self.view, at, self._limit, self.registry)

    def _recover(self, at: int) -> Steps:
        """No sound record at `at`: it is damaged, or the file is cut here. Returns where to go on."""
        cut_chunk = self._cut_chunk(at)
        if cut_chunk is None and self._last >= 0 and (inside := self._next(self._last + 1)) < at:
            self._tally.skip(self._last, inside, "record of a wrong length")
            return inside
        resume = self._limit if cut_chunk else self._next(at + 1)
        if resume < self._limit or not is_cut_off(self.view, at, self._limit):
            self._tally.skip(at, resume, "no record here")
            return resume
        self._tally.truncated = True
        kept = at
        if cut_chunk is not None:
            data = expand_cut(self.view, cut_chunk, self._limits)
            found = walk(data, 0, len(data))
            kept = cut_chunk.data_at if len(found.messages) else at
            yield bind(data, found, self.registry)
        self._tally.skip(kept, self._limit, "the file ends inside this record")
        return self._limit

    def _cut_chunk(self, at: int) -> ChunkHead | None:
        """The head of the chunk at `at` if its two lengths agree that the end of the file cuts it."""
        if self.view[at] != Opcode.CHUNK or not is_cut_off(self.view, at, self._limit):
            return None
        body = at + HEAD_BYTES
        if body + 60 > self._limit:
            return None
        head = chunk_head(self.view, body, body + U64.unpack_from(self.view, at + 1)[0])
        if head is None or (head.data_end < self._limit and self._next(head.data_end) < self._limit):
            return None  # records follow its data: the length of the whole is wrong
        return head
