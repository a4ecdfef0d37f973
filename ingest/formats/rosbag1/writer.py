"""ROS 1 bags (format 2.0) written: chunks of messages, their indexes, and what is found at the end of a bag.

The format is that of the ROS wiki, "Bags/Format/2.0".
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Mapping
from typing import IO

from flysid.ingest.formats.rosbag1.records import MAGIC, Op

HEADER_BYTES = 4096  # of the bag's own record, padded
CHUNK_BYTES = 768 * 1024
_VERSION = struct.pack("<I", 1)


def fields(content: Mapping[bytes, bytes]) -> bytes:
    """`name=value` fields, each with its length in front."""
    return b"".join(struct.pack("<I", len(n) + 1 + len(v)) + n + b"=" + v for n, v in content.items())


def record(op: int, content: Mapping[bytes, bytes], data: bytes) -> bytes:
    """One record."""
    head = fields({b"op": bytes([op]), **content})
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


class BagWriter:
    """Writes everything behind the bag's own header, which `head` gives once all is written.

    Parameters
    ----------
    body : a file to write to, from its beginning.
    compression : of chunks: b"none", b"bz2" or b"lz4".
    """

    def __init__(self, body: IO[bytes], compression: bytes = b"none") -> None:
        self._body = body
        self._compression = compression
        self._connections: list[bytes] = []
        self._chunk = bytearray()
        self._index: dict[int, list[tuple[bytes, int]]] = {}
        self._infos: list[bytes] = []
        self._end = 0

    def connect(self, topic: bytes, about: Mapping[bytes, bytes]) -> int:
        """Define a connection; returns its number. `about`: type, md5sum, message_definition ..."""
        number = len(self._connections)
        head = {b"conn": struct.pack("<I", number), b"topic": topic}
        self._connections.append(record(Op.CONNECTION, head, fields({b"topic": topic, **about})))
        self._chunk += self._connections[-1]
        return number

    def add(self, number: int, time: bytes, data: bytes) -> None:
        """One message; `time` is u32 seconds and u32 nanoseconds."""
        self._index.setdefault(number, []).append((time, len(self._chunk)))
        self._chunk += record(Op.MESSAGE, {b"conn": struct.pack("<I", number), b"time": time}, data)
        if len(self._chunk) >= CHUNK_BYTES:
            self._close_chunk()

    def finish(self) -> None:
        """The last chunk, the connections again, and where the chunks are."""
        if self._chunk:
            self._close_chunk()
        self._end = self._body.tell()
        for piece in (*self._connections, *self._infos):
            self._body.write(piece)

    def head(self) -> bytes:
        """The magic and the bag's own record."""
        content = {
            b"index_pos": struct.pack("<Q", len(MAGIC) + HEADER_BYTES + self._end),
            b"conn_count": struct.pack("<I", len(self._connections)),
            b"chunk_count": struct.pack("<I", len(self._infos)),
        }
        return MAGIC + record(Op.BAG, content, b" " * (HEADER_BYTES - len(record(Op.BAG, content, b""))))

    def _close_chunk(self) -> None:
        at = len(MAGIC) + HEADER_BYTES + self._body.tell()
        about = {b"compression": self._compression, b"size": struct.pack("<I", len(self._chunk))}
        self._body.write(record(Op.CHUNK, about, _pack(self._compression, bytes(self._chunk))))
        counts = b""
        for number, places in self._index.items():
            about = {b"conn": struct.pack("<I", number), b"count": struct.pack("<I", len(places))}
            data = b"".join(time + struct.pack("<I", offset) for time, offset in places)
            self._body.write(record(Op.INDEX, {b"ver": _VERSION, **about}, data))
            counts += struct.pack("<II", number, len(places))
        times = sorted((struct.unpack("<II", t), t) for places in self._index.values() for t, _ in places)
        first, last = (times[0][1], times[-1][1]) if times else (bytes(8), bytes(8))
        about = {
            b"ver": _VERSION,
            b"chunk_pos": struct.pack("<Q", at),
            b"start_time": first,
            b"end_time": last,
        }
        about[b"count"] = struct.pack("<I", len(self._index))
        self._infos.append(record(Op.CHUNK_INFO, about, counts))
        self._chunk = bytearray()
        self._index = {}


def _pack(kind: bytes, data: bytes) -> bytes:
    if kind == b"bz2":
        return bz2.compress(data)
    if kind == b"lz4":
        import lz4.frame

        return bytes(lz4.frame.compress(data))
    return data
