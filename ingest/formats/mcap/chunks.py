"""The data of an MCAP chunk: expanded within bounds, checked, and searched for messages.

A chunk may hold a decompression bomb, so nothing is allocated on the word of the file: sizes are checked
against `Limits` first and the decompressors get a limit of what they may write.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common.compression import CompressionError
from flysid.ingest.formats.common.gather import Bytes, Index, Values, as_bytes, rows
from flysid.ingest.formats.mcap.records import (
    HEAD_BYTES,
    MESSAGE_HEAD_BYTES,
    U64,
    ChunkHead,
    Registry,
)

SMALL_CHUNK_BYTES = 1 << 20  # below this, the ratio is not held against a chunk
_PIECE = 1 << 16

MESSAGE_HEAD = np.dtype(
    [("op", "u1"), ("size", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("sent", "<u8")]
)


@dataclass(frozen=True)
class Definition:
    """A schema or channel record data[start:end] (body only), which comes before message number `before`."""

    before: int
    op: int
    start: int
    end: int


@dataclass(frozen=True)
class Contents:
    """What lies in a run of records: places of messages, definitions between them, and where the run ends."""

    messages: Index
    definitions: tuple[Definition, ...]
    stop: int


@dataclass(frozen=True)
class Block:
    """Messages in one buffer: payloads data[at : at + size], times, places in Registry.channels (or -1).

    `published`: how many have the time of their publishing, as the recorder noted none of its own.
    """

    data: Bytes
    at: Index
    size: Index
    channel: Index
    log_ns: Index
    published: int = 0


def check_bounds(head: ChunkHead, limits: Limits) -> None:
    """Raise CompressionError where a chunk declares more than `limits` allow."""
    packed = head.data_end - head.data_at
    if head.size > limits.max_chunk_bytes:
        raise CompressionError(
            f"chunk declares {head.size} bytes; at most {limits.max_chunk_bytes} are allowed"
        )
    if head.size > SMALL_CHUNK_BYTES and head.size > limits.max_ratio * packed:
        raise CompressionError(
            f"chunk declares {head.size} bytes from {packed}: above {limits.max_ratio:g} times"
        )


def expand(view: memoryview, head: ChunkHead) -> bytes | memoryview:
    """The records of a chunk, of the declared size. Raises CompressionError where they cannot be had."""
    packed = view[head.data_at : head.data_end]
    if head.compression == "":
        data: bytes | memoryview = packed
    elif head.compression == "zstd":
        data = _expand_zstd(packed, head.size)
    elif head.compression == "lz4":
        data = _expand_lz4(packed, head.size)
    else:
        raise CompressionError(f"compression {head.compression!r} is not known")
    if len(data) != head.size:
        raise CompressionError(f"chunk declares {head.size} bytes and holds {len(data)}")
    return data


def expand_cut(view: memoryview, head: ChunkHead, limits: Limits) -> bytes:
    """As much of a chunk as the end of the file left, unchecked: its checksum covers what is missing."""
    packed = view[head.data_at :]
    most = min(head.size, limits.max_chunk_bytes, int(limits.max_ratio * len(packed)) + SMALL_CHUNK_BYTES)
    if head.compression == "zstd":
        return _cut_zstd(packed, most)
    if head.compression == "lz4":
        return _cut_lz4(packed, most)
    return bytes(packed[:most]) if head.compression == "" else b""


def checksum_fails(head: ChunkHead, data: bytes | memoryview) -> bool:
    """Whether the CRC-32 of a chunk is stated (not 0) and wrong."""
    return head.crc != 0 and crc32(data) != head.crc


def crc32(data: bytes | memoryview) -> int:
    """CRC-32 as in zlib, four times as fast."""
    import fastcrc

    return int(fastcrc.crc32.iso_hdlc(data))


def walk(data: bytes | memoryview, start: int, stop: int, registry: Registry | None = None) -> Contents:
    """Messages and definitions from `start` on, up to the first record that is neither or does not fit.

    With a registry a message of an unknown channel ends the walk too: top-level records have no checksum.
    """
    places: list[int] = []
    definitions: list[Definition] = []
    keep = places.append
    length_at = U64.unpack_from
    at = start
    bound = None if registry is None else registry.bound
    while at + HEAD_BYTES <= stop:
        op = data[at]
        end = at + HEAD_BYTES + length_at(data, at + 1)[0]
        if end > stop:
            break
        if op == Opcode.MESSAGE and end - at >= MESSAGE_HEAD_BYTES:
            if bound is not None and bound[data[at + 9] | data[at + 10] << 8] < 0:
                break
            keep(at)
        elif op in (Opcode.SCHEMA, Opcode.CHANNEL):
            if registry is not None:
                break
            definitions.append(Definition(len(places), op, at + HEAD_BYTES, end))
        elif registry is not None or op == 0 or op == Opcode.MESSAGE:
            break
        at = end
    return Contents(np.array(places, dtype=np.int64), tuple(definitions), at)


def find_indexed(data: bytes | memoryview, offsets: Index) -> Contents | None:
    """The same as `walk` over a whole chunk, from the offsets of its message indexes; None where they lie."""
    messages = np.sort(offsets)
    if len(messages) == 0 or messages[0] < 0 or messages[-1] + MESSAGE_HEAD_BYTES > len(data):
        return None
    head = rows(as_bytes(data), messages, MESSAGE_HEAD_BYTES).view(MESSAGE_HEAD)
    if (head["op"] != Opcode.MESSAGE).any() or (head["size"] < 22).any() or (head["size"] > len(data)).any():
        return None
    free = np.concatenate([[0], messages + HEAD_BYTES + head["size"].astype(np.int64)])
    taken = np.append(messages, len(data))
    if (free > taken).any():
        return None
    definitions: list[Definition] = []
    for gap in np.flatnonzero(free < taken).tolist():
        inside = walk(data, int(free[gap]), int(taken[gap]))
        if len(inside.messages) or inside.stop != taken[gap]:
            return None
        definitions += [Definition(gap, d.op, d.start, d.end) for d in inside.definitions]
    return Contents(messages, tuple(definitions), len(data))


def bind(data: bytes | memoryview, found: Contents, registry: Registry) -> Block:
    """The messages found, each with the channel that its id meant where it stood."""
    buffer = as_bytes(data)
    head = rows(buffer, found.messages, MESSAGE_HEAD_BYTES).view(MESSAGE_HEAD)
    numbers: Values = head["channel"]
    channel = np.empty(len(numbers), dtype=np.int64)
    done = 0
    for item in found.definitions:
        channel[done : item.before] = registry.bound[numbers[done : item.before]]
        done = item.before
        try:
            registry.define(item.op, bytes(data[item.start : item.end]))
        except ValueError:
            continue  # its messages stay unbound, and are counted as such
    channel[done:] = registry.bound[numbers[done:]]
    size = head["size"].astype(np.int64) - 22
    bare = (head["log"] == 0) & (head["sent"] != 0)
    log_ns = np.where(bare, head["sent"], head["log"]).astype(np.int64)
    at = found.messages + MESSAGE_HEAD_BYTES
    return Block(buffer, at, size, channel, log_ns, int(np.count_nonzero(bare)))


def _expand_zstd(packed: memoryview, size: int) -> bytes:
    import zstandard

    try:
        stated = zstandard.get_frame_parameters(packed).content_size
        if stated not in (size, 0, zstandard.CONTENTSIZE_UNKNOWN):
            raise CompressionError(f"chunk declares {size} bytes and its zstd frame {stated}")
        return bytes(zstandard.ZstdDecompressor().decompress(packed, max_output_size=max(size, 1)))
    except zstandard.ZstdError as error:
        raise CompressionError(f"zstd data are damaged: {error}") from error


def _expand_lz4(packed: memoryview, size: int) -> bytes:
    import lz4.frame

    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    except (RuntimeError, ValueError, EOFError) as error:
        raise CompressionError(f"lz4 data are damaged: {error}") from error


def _cut_zstd(packed: memoryview, most: int) -> bytes:
    import zstandard

    out = bytearray()
    try:
        reader = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(packed)
        while len(out) < most and (piece := reader.read(min(_PIECE, most - len(out)))):
            out += piece
    except zstandard.ZstdError:
        pass  # the cut, or damage before it: what came out so far stands
    return bytes(out)


def _cut_lz4(packed: memoryview, most: int) -> bytes:
    import lz4.frame

    out = bytearray()
    decoder = lz4.frame.LZ4FrameDecompressor()
    try:
        for at in range(0, len(packed), _PIECE):
            if len(out) >= most or decoder.eof:
                break
            out += decoder.decompress(packed[at : at + _PIECE], max_length=most - len(out))
    except (RuntimeError, EOFError):
        pass  # the cut, or damage before it: what came out so far stands
    return bytes(out)
