"""MCAP records: what they look like, what a soundly built one is, where the next one starts.

A file is MAGIC, records, MAGIC. A record is u8 opcode, u64 length, body (little-endian). Bodies used here:

    0x01 header    str profile, str library
    0x02 footer    u64 summary start, u64 summary offset start, u32 summary crc
    0x03 schema    u16 id, str name, str encoding, u32 length, data
    0x04 channel   u16 id, u16 schema id, str topic, str message encoding, map metadata
    0x05 message   u16 channel id, u32 sequence, u64 log time, u64 publish time, payload
    0x06 chunk     u64 start, u64 end, u64 uncompressed size, u32 crc, str compression, u64 length, records
    0x07 index     u16 channel id, u32 length, (u64 log time, u64 offset in the chunk) ...
    0x0F data end  u32 crc of everything before it

where str is u32 length and UTF-8 and map is u32 length in bytes and pairs of str. The container has no
sync marker: after damage a record is believed when its parts fill its length exactly and a plausible
record, or the end of the file, follows it. Attachments are stepped over.

Later versions may put fields behind these, which readers step over (never in messages, footer and data end).
So bytes behind the known fields are no damage where a record follows them, unless one follows the known
fields already: then the length is wrong, or the checksums of the file must prove that it is not.
Source: the MCAP specification, version 0.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from flysid.ingest.formats.common.gather import Bytes, Index, as_bytes, numbers
from flysid.ingest.formats.messages.channel import Channel, Schema

MAGIC = b"\x89MCAP0\r\n"
LAST_KNOWN = max(Opcode)
FIRST_PRIVATE = 0x80
HEAD_BYTES = 9
MESSAGE_HEAD_BYTES = 31  # with the 9 bytes of the record's own head
MAX_CHANNELS = 65536

HEAD = struct.Struct("<BQ")
U16 = struct.Struct("<H")
U32 = struct.Struct("<I")
U64 = struct.Struct("<Q")
_CHUNK_FIXED = struct.Struct("<QQQI")
_WINDOW = 1 << 20
_FIRST_WINDOW = 1 << 10
MANY_RECORDS = 16
SURPLUS_BYTES = 1 << 10  # of what stands behind the known fields, this much is searched for records

# (view, body, end of the record) -> where the fields of this version end, beyond `end` where they do not fit
FieldsEnd = Callable[[memoryview, int, int], int]


@dataclass(frozen=True)
class ChunkHead:
    """Where a chunk's data lie and what they should expand to."""

    size: int
    crc: int
    compression: str
    data_at: int
    data_end: int


class Registry:
    """Channels seen so far. A channel id may be bound again; the channels themselves are kept for good."""

    def __init__(self) -> None:
        self.channels: list[Channel] = []
        self.bound: NDArray[np.int32] = np.full(65536, -1, dtype=np.int32)
        self._schemas: dict[int, Schema] = {}
        self._index: dict[Channel, int] = {}

    def define(self, op: int, body: bytes) -> None:
        """Take in the body of a schema or channel record. Raises ValueError where it is malformed."""
        (number,) = _unpack(U16, body, 0)
        if op == Opcode.SCHEMA:
            name, at = _prefix(body, 2)
            encoding, at = _prefix(body, at)
            data, _ = _prefix(body, at)
            self._schemas[number] = Schema(_text(name), _text(encoding), data)
            return
        (schema,) = _unpack(U16, body, 2)
        topic, at = _prefix(body, 4)
        encoding, at = _prefix(body, at)
        self._bind(number, Channel(_text(topic), _text(encoding), self._schemas.get(schema)))

    def _bind(self, number: int, channel: Channel) -> None:
        known = self._index.get(channel)
        if known is None and len(self.channels) < MAX_CHANNELS:
            known = self._index[channel] = len(self.channels)
            self.channels.append(channel)
        self.bound[number] = -1 if known is None else known


def strings(body: bytes, count: int) -> list[str]:
    """The `count` strings that a record begins with. Raises ValueError where they do not fit."""
    found: list[str] = []
    at = 0
    for _ in range(count):
        raw, at = _prefix(body, at)
        found.append(_text(raw))
    return found


def string_pairs(body: bytes) -> dict[str, str]:
    """The pairs of a metadata record's map, with its name in front of each key; what is malformed ends it."""
    pairs: dict[str, str] = {}
    try:
        name, at = _prefix(body, 0)
        content, _ = _prefix(body, at)
        at = 0
        while at < len(content):
            key, at = _prefix(content, at)
            value, at = _prefix(content, at)
            pairs[f"{_text(name)}.{_text(key)}" if name else _text(key)] = _text(value)
    except ValueError:
        pass
    return pairs


def chunk_head(view: memoryview, body: int, end: int) -> ChunkHead | None:
    """The head of the chunk whose body is view[body:end]; None where its parts do not fit."""
    at = body + _CHUNK_FIXED.size
    if at + 12 > end:
        return None
    _, _, size, crc = _CHUNK_FIXED.unpack_from(view, body)
    (width,) = U32.unpack_from(view, at)
    if width > 16 or at + 4 + width + 8 > end:
        return None
    compression = bytes(view[at + 4 : at + 4 + width]).decode("utf-8", "replace")
    (length,) = U64.unpack_from(view, at + 4 + width)
    data_at = at + 4 + width + 8
    if data_at + length > end:
        return None
    return ChunkHead(size, crc, compression, data_at, data_at + length)


def message_offsets(view: memoryview, body: int) -> Index:
    """Where the messages of a sound message index lie in their chunk."""
    (length,) = U32.unpack_from(view, body + 2)
    offsets: Index = np.frombuffer(view[body + 6 : body + 6 + length], dtype="<i8")[1::2]
    return offsets


def record_end(view: memoryview, at: int, limit: int, *, intact: bool = False) -> int:
    """Where the record at `at` ends if its parts fit its length and it ends by `limit`; else -1.

    The magic counts as a record: it opens and closes a file, and files may be concatenated. Where a checksum
    proves the bytes `intact`, all that stands behind the known fields belongs to the record.
    """
    if view[at : at + len(MAGIC)] == MAGIC:
        return at + len(MAGIC)
    known, end = _extent(view, at, limit)
    if known == end or (_follows(view, end, limit) and (intact or not _holds_records(view, known, end))):
        return end
    return -1


_FIRST_STRING = np.full(256, -1, dtype=np.int64)
"""Where in the body of a record its first string stands, by opcode; -1 where it has none."""
for _op, _place in ((Opcode.HEADER, 0), (Opcode.SCHEMA, 2), (Opcode.CHANNEL, 4), (Opcode.CHUNK, 28)):
    _FIRST_STRING[_op] = _place


def known_fields(view: memoryview, op: int, body: int, end: int) -> bytes:
    """The body of a sound record without what a later version has put behind the fields."""
    return bytes(view[body : _FIELDS_END[op](view, body, end)])


def _extent(view: memoryview, at: int, limit: int) -> tuple[int, int]:
    """Where the known fields of the record at `at` end, and where it ends; -1 twice where they do not fit."""
    if at + HEAD_BYTES > limit:
        return -1, -1
    op, length = HEAD.unpack_from(view, at)
    body = at + HEAD_BYTES
    end = at + HEAD_BYTES + length
    if end > limit or op == 0:
        return -1, -1
    fields_end = _FIELDS_END.get(op)
    if fields_end is None:  # a record this version does not know: believed if something sound follows
        is_sound = op > LAST_KNOWN and (end == limit or _plausible_head(view, end, limit))
        return (end, end) if is_sound else (-1, -1)
    known = fields_end(view, body, end)
    return (known, end) if known <= end else (-1, -1)


def _follows(view: memoryview, at: int, limit: int) -> bool:
    """Whether a record or the magic lies at `at`, or what the end of the file leaves of them."""
    if at == limit or view[at : at + len(MAGIC)] == MAGIC or is_cut_off(view, at, limit):
        return True
    return _extent(view, at, limit)[0] >= 0


def _holds_records(view: memoryview, start: int, end: int) -> bool:
    """Whether records lie at the end of view[start:end], or a good many one after the other in it."""
    window = min(end - HEAD_BYTES + 1, start + SURPLUS_BYTES)
    return any(_are_records(view, at, end) for at in _candidates(as_bytes(view), start, window).tolist())


def _are_records(view: memoryview, at: int, end: int) -> bool:
    for _ in range(MANY_RECORDS):
        at = _extent(view, at, end)[1]
        if at < 0 or at == end:
            break
    return at > 0


def next_record(view: memoryview, start: int, limit: int, registry: Registry) -> int:
    """The first place at or after `start` where a sound record lies that another follows; else `limit`."""
    data = as_bytes(view)
    at = start
    reach = _FIRST_WINDOW  # what was lost is short where records are dense
    while at < limit:
        stop = min(at + reach, limit - HEAD_BYTES + 1)
        for place in _whole(data, _candidates(data, at, stop), limit, registry):
            if _convincing(view, place, limit, registry):
                return place
        at += reach
        reach = min(4 * reach, _WINDOW)
    tail = limit - len(MAGIC)
    return tail if tail >= start and view[tail:limit] == MAGIC else limit


def _candidates(data: Bytes, start: int, stop: int) -> Index:
    """Places with a known opcode and a length below 2^40, or with the first byte of the magic."""
    if stop <= start:
        return np.empty(0, dtype=np.int64)
    op = data[start:stop]
    high = data[start + 6 : stop + 6] | data[start + 7 : stop + 7] | data[start + 8 : stop + 8]
    found = np.flatnonzero((op >= Opcode.HEADER) & (op <= LAST_KNOWN) & (high == 0) | (op == MAGIC[0]))
    return found + start


def _whole(data: Bytes, places: Index, limit: int, registry: Registry) -> list[int]:
    """Of these places the magic and the records that end by `limit`; messages of known channels only."""
    if not len(places):
        return []
    ends = numbers(data, places + 1, "<u8").astype(np.int64) + places + HEAD_BYTES
    is_magic = data[places] == MAGIC[0]
    is_message = (data[places] == Opcode.MESSAGE) & (places + HEAD_BYTES + 2 <= limit)
    number = numbers(data, np.where(is_message, places + HEAD_BYTES, 0), "<u2")
    is_lost = is_message & (registry.bound[number] < 0)
    whole = is_magic | ((ends <= limit) & ~is_lost & _leads_on(data, ends, limit))
    places = places[whole]
    return (places[_strings_fit(data, places, ends[whole], limit)]).tolist()  # type: ignore[no-any-return]


def _leads_on(data: Bytes, ends: Index, limit: int) -> NDArray[np.bool_]:
    """Whether a record could begin at `ends`: its length is below 2^40. Or the magic, or the file ends."""
    at = np.where((ends >= 0) & (ends + HEAD_BYTES <= limit), ends, 0)
    high = data[at + 6] | data[at + 7] | data[at + 8]
    found: NDArray[np.bool_] = (ends + HEAD_BYTES > limit) | (data[at] == MAGIC[0]) | (high == 0)
    return found


def _strings_fit(data: Bytes, places: Index, ends: Index, limit: int) -> NDArray[np.bool_]:
    """Of which records the first string ends in them, and of chunks the data behind it."""
    first = _FIRST_STRING[data[places]]
    at = places + HEAD_BYTES + first
    has_text = (first >= 0) & (at + 4 <= limit)
    at = np.where(has_text, at, 0)
    behind = at + 4 + numbers(data, at, "<u4").astype(np.int64)
    is_chunk = has_text & (data[places] == Opcode.CHUNK)
    fits = ~has_text | (behind + 8 * is_chunk <= ends)
    size = numbers(data, np.where(is_chunk & fits, behind, 0), "<u8")
    fits &= ~is_chunk | (size <= np.maximum(ends - behind - 8, 0).astype(np.uint64))
    return fits  # type: ignore[no-any-return]


def _convincing(view: memoryview, at: int, limit: int, registry: Registry) -> bool:
    end = record_end(view, at, limit)
    if end < 0:
        return False
    if view[at] == Opcode.MESSAGE and registry.bound[U16.unpack_from(view, at + HEAD_BYTES)[0]] < 0:
        return False
    return end == limit or record_end(view, end, limit) > 0 or is_cut_off(view, end, limit)


def is_cut_off(view: memoryview, at: int, limit: int) -> bool:
    """Whether a record starts at `at` that the end of the file cuts."""
    if limit - at < len(MAGIC) and view[at:limit] == MAGIC[: limit - at]:
        return limit > at
    if not at < limit or not Opcode.HEADER <= view[at] <= LAST_KNOWN:
        return False
    if at + HEAD_BYTES > limit:
        return True
    length = int(U64.unpack_from(view, at + 1)[0])
    return at + HEAD_BYTES + length > limit and length < 1 << 40


def _plausible_head(view: memoryview, at: int, limit: int) -> bool:
    if at + HEAD_BYTES > limit:
        return False
    op, length = HEAD.unpack_from(view, at)
    return bool(op) and at + HEAD_BYTES + length <= limit


def _prefix(body: bytes, at: int) -> tuple[bytes, int]:
    (size,) = _unpack(U32, body, at)
    if at + 4 + size > len(body):
        raise ValueError("a string runs past the end of its record")
    return body[at + 4 : at + 4 + size], at + 4 + size


def _unpack(kind: struct.Struct, body: bytes, at: int) -> tuple[int, ...]:
    if at + kind.size > len(body):
        raise ValueError("a record is too short")
    return kind.unpack_from(body, at)


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace")


def _after_strings(view: memoryview, at: int, end: int, count: int) -> int:
    """Where `count` prefixed strings from `at` on end; beyond `end` where they do not fit."""
    for _ in range(count):
        if at + 4 > end:
            return end + 1
        at += 4 + U32.unpack_from(view, at)[0]
    return at


def _strings(skip: int, count: int, more: int = 0) -> FieldsEnd:
    """Fields: `skip` bytes, `count` prefixed blobs, `more` bytes."""
    return lambda view, body, end: _after_strings(view, body + skip, end, count) + more


def _exactly(size: int) -> FieldsEnd:
    """Fields of `size` bytes that no version will extend."""
    return lambda _view, body, end: end if end - body == size else end + 1


def _at_least(size: int) -> FieldsEnd:
    """Fields of `size` bytes and content up to the end."""
    return lambda _view, body, end: end if end - body >= size else end + 1


def _chunk_end(view: memoryview, body: int, end: int) -> int:
    head = chunk_head(view, body, end)
    return end + 1 if head is None else head.data_end


def _message_index_end(view: memoryview, body: int, end: int) -> int:
    if end - body < 6:
        return end + 1
    (length,) = U32.unpack_from(view, body + 2)
    return end + 1 if length % 16 else body + 6 + int(length)


def _chunk_index_end(view: memoryview, body: int, end: int) -> int:
    """u64 x 4, map (u16, u64), u64, str, u64 x 2."""
    at = _after_strings(view, body + 32, end, 1) + 8
    return _after_strings(view, at, end, 1) + 16


_FIELDS_END: Mapping[int, FieldsEnd] = {
    Opcode.HEADER: _strings(0, 2),
    Opcode.FOOTER: _exactly(20),
    Opcode.SCHEMA: _strings(2, 3),
    Opcode.CHANNEL: _strings(4, 3),
    Opcode.MESSAGE: _at_least(22),
    Opcode.CHUNK: _chunk_end,
    Opcode.MESSAGE_INDEX: _message_index_end,
    8: _chunk_index_end,
    Opcode.ATTACHMENT: _at_least(36),
    10: _strings(40, 2),
    Opcode.STATISTICS: _strings(42, 1),
    Opcode.METADATA: _strings(0, 2),
    13: _strings(16, 1),
    14: lambda _view, body, _end: body + 17,
    Opcode.DATA_END: _exactly(4),
}
