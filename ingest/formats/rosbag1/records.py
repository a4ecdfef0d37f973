"""Records of a ROS 1 bag (format 2.0), front to back, through damage, with everything lost counted.

A record is a u32 header length, header fields (u32 length, `name=value`), a u32 data length, data. The format
is that of the ROS wiki, "Bags/Format/2.0". Nothing but a bzip2 chunk carries a checksum: a record counts as
one where its header divides into fields, its op is known and the fields that this op needs have their sizes.
A plain chunk is no more than the records in it, so its own lengths, which damage or a cut may falsify, are
not needed; the index behind the data only serves to know connections before their first message.
"""

from __future__ import annotations

import bz2
import re
import struct
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common.clock import SECOND_NS
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.rosbag1.runs import HEAD_BYTES, MessagePlace, message_run

MAGIC = b"#ROSBAG V2.0\n"


class Op(IntEnum):
    """What a record of a bag holds."""

    MESSAGE = 2
    BAG = 3
    INDEX = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7


MAX_HEADER_BYTES = 1 << 16
_LENGTHS = struct.Struct("<II")
_U32 = struct.Struct("<I")
_NEEDS: Mapping[int, Mapping[bytes, int]] = {  # size of each field; 0 for any
    Op.MESSAGE: {b"conn": 4, b"time": 8},
    Op.BAG: {b"index_pos": 8, b"conn_count": 4, b"chunk_count": 4},
    Op.INDEX: {b"ver": 4, b"conn": 4, b"count": 4},
    Op.CHUNK: {b"compression": 0, b"size": 4},
    Op.CHUNK_INFO: {b"ver": 4, b"chunk_pos": 8, b"start_time": 8, b"end_time": 8, b"count": 4},
    Op.CONNECTION: {b"conn": 4, b"topic": 0},
}
_MESSAGE = re.compile(
    rb"(?s)\x26\0\0\0(?:\x09\0\0\0conn=(.{4})|\x04\0\0\0op=(\x02)|\x0d\0\0\0time=(.{8})){3}(.{4})"
)
"""A message, most of what there is: its three fields in any order, up to its data, whose length is last."""
_START = re.compile(
    rb"(?s)..\0\0..\0\0(?:op|conn|topic|time|ver|count|size|compression|index_pos|conn_count|chunk_count"
    rb"|chunk_pos|start_time|end_time)="
)
Fields = Mapping[bytes, bytes]
Found = tuple[memoryview | bytes, "BagRecord | list[MessagePlace]"]
"""A record, or a run of messages, and the bytes it lies in."""


class ChunkError(ValueError):
    """A chunk that cannot be expanded; the message says why."""


class DamagedChunkError(ChunkError):
    """The compressed data do not hold together, or fail their checksum."""


@dataclass(frozen=True)
class BagRecord:
    """A record at [start, end), its data from `data_at`."""

    op: int
    fields: Fields
    start: int
    data_at: int
    end: int

    @property
    def connection(self) -> int:
        """The connection that a message or definition belongs to."""
        return _U32.unpack(self.fields[b"conn"])[0]  # type: ignore[no-any-return]


def place_of(message: BagRecord) -> MessagePlace:
    """A message as a run has it."""
    seconds, fraction = _LENGTHS.unpack(message.fields[b"time"])
    return MessagePlace(message.connection, seconds * SECOND_NS + fraction, message.data_at, message.end)


def split_fields(raw: bytes) -> dict[bytes, bytes] | None:
    """Fields of a header; None where they do not fill it exactly."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at + 4 <= len(raw):
        (size,) = _U32.unpack_from(raw, at)
        name, mark, value = raw[at + 4 : at + 4 + size].partition(b"=")
        at += 4 + size
        if not mark or at > len(raw):
            return None
        fields[name] = value
    return fields if at == len(raw) else None


def record_at(view: memoryview | bytes, at: int, limit: int) -> BagRecord | None:
    """The record that begins at `at`; its end may be behind `limit`. None where there is none."""
    message = _MESSAGE.match(view, at, limit)
    if message is not None and None not in message.groups():
        fields = {b"conn": message[1], b"op": b"\2", b"time": message[3]}
        return BagRecord(Op.MESSAGE, fields, at, message.end(), message.end() + _U32.unpack(message[4])[0])
    if at + 8 > limit:
        return None
    (length,) = _U32.unpack_from(view, at)
    data_at = at + 8 + length
    if not 4 < length <= MAX_HEADER_BYTES or data_at > limit:
        return None
    split = split_fields(bytes(view[at + 4 : at + 4 + length]))
    op = split.get(b"op", b"") if split is not None else b""
    needs = _NEEDS.get(op[0]) if len(op) == 1 else None
    if split is None or needs is None:
        return None
    if any(len(split.get(name, b"")) != size if size else name not in split for name, size in needs.items()):
        return None
    (size,) = _U32.unpack_from(view, data_at - 4)
    return BagRecord(op[0], split, at, data_at, data_at + size)


def next_record(view: memoryview | bytes, at: int, limit: int) -> int:
    """Where the next whole record begins at or after `at`; `limit` where there is none."""
    while (found := _START.search(view, at, limit)) is not None:
        fits = _begins_header(view, found.start(), limit)
        record = record_at(view, found.start(), limit) if fits else None
        if record is not None and (record.end <= limit or _is_plain_chunk(record)):
            return found.start()
        at = found.start() + 1
    return limit


def _begins_header(view: memoryview | bytes, at: int, limit: int) -> bool:
    """Whether the first field of a header ends in it, and the second one, too, or the header."""
    length, first = _LENGTHS.unpack_from(view, at)
    end: int = at + 4 + length
    second: int = at + 8 + first
    if second == end:
        return True
    return second + 4 <= min(end, limit) and second + 4 + int(_U32.unpack_from(view, second)[0]) <= end


def _is_plain_chunk(record: BagRecord) -> bool:
    """Whether records follow the head of a chunk as they are; a misspelt "none" is harmless so."""
    return record.op == Op.CHUNK and record.fields[b"compression"] not in (b"bz2", b"lz4")


class BagReader:
    """Messages and connections of one bag; `place` and `seen` advance while `pieces` is consumed."""

    def __init__(self, view: memoryview, limits: Limits, tally: Tally) -> None:
        self.place = 0
        self.seen = 0  # records of any kind
        self._listed = 0  # connections and chunks in the index at the end
        self._asked = -1
        self._found: BagRecord | None = None
        self._view = view
        self._limits = limits
        self._tally = tally

    def records(self) -> Iterator[tuple[memoryview | bytes, BagRecord]]:
        """Every record and the bytes it lies in (the file, or an expanded chunk)."""
        for source, piece in self.pieces():
            if isinstance(piece, BagRecord):
                yield source, piece
                continue
            for message in piece:
                record = record_at(source, message.data_at - HEAD_BYTES, len(source))
                if record is not None:
                    yield source, record

    def pieces(self) -> Iterator[Found]:
        """As `records`, with messages that lie back to back as one run."""
        start = len(MAGIC) if self._view[: len(MAGIC)] == MAGIC else 0
        at = start or next_record(self._view, 0, len(self._view))
        self._tally.skip(0, 0 if start else min(at, len(MAGIC)), "not the magic of a bag")
        self._tally.skip(len(MAGIC), 0 if start else at, "no record here")
        while at < len(self._view):
            self.place = at
            run = message_run(self._view, at, len(self._view))
            if run:
                self.seen += len(run)
                yield self._view, run
                at = run[-1].end
                continue
            record = self._at(at)
            if record is None:
                at = self._lost(at, at, "no record here")
            elif _is_plain_chunk(record):
                self.seen += 1
                yield self._view, record
                at = record.data_at
            else:
                at = yield from self._whole(record)
        self._tally.truncated |= self._is_unfinished()

    def _at(self, at: int) -> BagRecord | None:
        """The record that begins at `at`; the last one is remembered, as each is looked for twice."""
        if at != self._asked:
            self._asked = at
            self._found = record_at(self._view, at, len(self._view))
        return self._found

    def _is_unfinished(self) -> bool:
        """Whether nothing is damaged and yet the index that the bag's header tells of is not all there.

        A recorder writes the index's place into the header when it closes the bag, 0 until then.
        """
        head = record_at(self._view, len(MAGIC), len(self._view))
        if head is None or head.op != Op.BAG or self._tally.freeze().lossy:
            return False
        counts = (int.from_bytes(head.fields[name], "little") for name in (b"conn_count", b"chunk_count"))
        return not any(head.fields[b"index_pos"]) or self._listed < sum(counts)

    def _count(self, record: BagRecord) -> None:
        self.seen += 1
        head = record_at(self._view, len(MAGIC), len(self._view)) if record.op == Op.CONNECTION else None
        index_pos = int.from_bytes(head.fields.get(b"index_pos", b""), "little") if head is not None else 0
        self._listed += record.op == Op.CHUNK_INFO or (
            record.op == Op.CONNECTION and 0 < index_pos <= record.start
        )

    def _whole(self, record: BagRecord) -> Generator[Found, None, int]:
        """A record and what follows it; returns where to go on."""
        limit = len(self._view)
        if record.end < limit and self._at(record.end) is None:
            resume = next_record(self._view, record.start + 1, limit)
            if resume < record.end:
                self._tally.skip(record.start, resume, "record of a wrong length")
                return resume
        elif record.end > limit:
            return self._lost(record.start, record.start, "the file ends inside this record")
        self._count(record)
        if record.op == Op.CHUNK:
            yield from self._expand(record)
        else:
            yield self._view, record
        return record.end

    def _lost(self, start: int, at: int, reason: str) -> int:
        """Nothing whole at `start`: skip to the next record; behind the last one, the file is cut."""
        resume = next_record(self._view, at + 1, len(self._view))
        self._tally.truncated |= resume == len(self._view)
        self._tally.skip(start, resume, reason)
        return resume

    def _expand(self, chunk: BagRecord) -> Iterator[Found]:
        """The records of a compressed chunk; one that fails is skipped alone."""
        try:
            data = expand(self._view, chunk, self._limits)
        except ChunkError as error:
            self._tally.bad_checksums += isinstance(error, DamagedChunkError)
            self._tally.skip(chunk.start, chunk.end, str(error))
            return
        at = 0
        bad = False
        while at < len(data):
            run = message_run(data, at, len(data))
            if run:
                yield data, run
                at = run[-1].end
            record = record_at(data, at, len(data))
            if record is None or record.end > len(data):
                at = next_record(data, at + 1, len(data))
                bad = True
                continue
            yield data, record
            at = record.end
        if bad:
            self._tally.skip(chunk.data_at, chunk.end, "records in the chunk do not fit it")


def expand(view: memoryview, chunk: BagRecord, limits: Limits) -> bytes:
    """The data of a chunk compressed with bz2 or lz4. Raises ChunkError."""
    packed = view[chunk.data_at : chunk.end]
    (size,) = _U32.unpack(chunk.fields[b"size"])
    if size > limits.max_chunk_bytes or size > limits.max_ratio * len(packed) + (1 << 20):
        raise ChunkError(f"a chunk that expands to {size} bytes is beyond the limits")
    kind = chunk.fields[b"compression"]
    try:
        data = _unpack(kind, packed, size)
    except (OSError, RuntimeError, ValueError, EOFError) as error:
        raise DamagedChunkError(f"chunk data are damaged: {error}") from error
    if len(data) != size:
        raise DamagedChunkError(f"chunk declares {size} bytes and holds {len(data)}")
    return data


def _unpack(kind: bytes, packed: memoryview, size: int) -> bytes:
    if kind == b"bz2":
        decoder = bz2.BZ2Decompressor()
        data = decoder.decompress(packed, max_length=size + 1)
        if not decoder.eof and len(data) == size:  # the end carries the checksum
            data += decoder.decompress(b"", max_length=1)
        return data
    import lz4.frame

    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))


def indexed_connections(view: memoryview) -> Iterator[BagRecord]:
    """The connections repeated behind the data, where the bag's own header can be believed."""
    first = record_at(view, len(MAGIC), len(view))
    if first is None or first.op != Op.BAG:
        return
    at = int.from_bytes(first.fields[b"index_pos"], "little")
    while (record := record_at(view, at, len(view))) is not None and record.op == Op.CONNECTION:
        if record.end > len(view):
            return
        yield record
        at = record.end
