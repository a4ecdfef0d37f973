"""ROS 1 bags made in tests, byte by byte; and the sample log of the contract tests."""

from __future__ import annotations

import bz2
import struct
from functools import cache

import numpy as np

from tests.samplelogs import Record
from tests.samplelogs import record_at as owner_of

SUFFIX = ".bag"
KNOWS_ITS_END = True
MAGIC = b"#ROSBAG V2.0\n"
IMU = "Header header\nfloat64 x\nfloat64 y\n" + "=" * 80 + "\nMSG: std_msgs/Header\n"
IMU += "uint32 seq\ntime stamp\nstring frame_id\n"
TYPES = {0: ("/imu", "p/Imu", IMU), 1: ("/pair", "p/Pair", "uint32 k\nfloat64 x\n")}
Piece = tuple[bytes, int, int]  # bytes, rows, connection whose definition it is (-1: none)


def record(data: bytes, **fields: bytes) -> bytes:
    """One record; fields in the order of their names, as the ROS recorder writes them."""
    return packed(fields) + struct.pack("<I", len(data)) + data


def packed(fields: dict[str, bytes]) -> bytes:
    """Header fields with their length in front."""
    inner = b"".join(
        struct.pack("<I", len(n) + 1 + len(v)) + n.encode() + b"=" + v for n, v in sorted(fields.items())
    )
    return struct.pack("<I", len(inner)) + inner


def connection(number: int) -> bytes:
    topic, kind, text = TYPES[number]
    about = {"topic": topic.encode(), "type": kind.encode(), "md5sum": b"0" * 32}
    about["message_definition"] = text.encode()
    body = packed(about)[4:]
    return record(body, op=b"\x07", conn=struct.pack("<I", number), topic=topic.encode())


def message(number: int, k: int) -> bytes:
    if number == 0:
        stamp = (1_600_000_000 + k // 100, k % 100 * 10**7)
        data = struct.pack("<IIII", k, *stamp, 4) + b"body" + struct.pack("<dd", k / 7, -k / 3)
    else:
        data = struct.pack("<Id", k, k / 11)
    when = struct.pack("<II", 1_600_000_000 + k // 100, k % 100 * 10**7 + 3 * 10**6)
    return record(data, op=b"\x02", conn=struct.pack("<I", number), time=when)


def chunk(data: bytes, kind: bytes = b"none") -> bytes:
    packed = bz2.compress(data) if kind == b"bz2" else data
    return record(packed, op=b"\x05", compression=kind, size=struct.pack("<I", len(data)))


@cache
def pieces() -> list[Piece]:
    """The sample in pieces: magic, bag header, plain chunks, a bzip2 chunk, the repeated connections."""
    middle: list[Piece] = []
    for c in range(4):
        inner = [(message(k % 2, k), 1, -1) for k in range(c * 40, c * 40 + 40)]
        if c == 0:
            inner = [(connection(0), 0, 0), (connection(1), 0, 1), *inner]
        data = b"".join(p[0] for p in inner)
        if c == 3:
            middle.append((chunk(data, b"bz2"), 40, -1))
        else:
            middle += [(chunk(data)[: -len(data)], 0, -1), *inner]
        index = np.arange(9, dtype="<u4").tobytes()
        middle.append((record(index, op=b"\x04", ver=b"\1\0\0\0", conn=bytes(4), count=b"\3\0\0\0"), 0, -1))
    start = len(MAGIC) + len(_bag_header(0)) + sum(len(p[0]) for p in middle)
    head: list[Piece] = [(MAGIC, 0, -1), (_bag_header(start), 0, -1)]
    infos: list[Piece] = [(chunk_info(), 0, -1)] * 4
    return [*head, *middle, (connection(0), 0, 0), (connection(1), 0, 1), *infos]


def chunk_info() -> bytes:
    """What the index says of a chunk; readers of flysid only count it."""
    about = {"ver": b"\1\0\0\0", "chunk_pos": bytes(8), "start_time": bytes(8), "end_time": bytes(8)}
    return record(struct.pack("<II", 0, 40), op=b"\x06", count=b"\1\0\0\0", **about)


def _bag_header(index_pos: int) -> bytes:
    counts = {"conn_count": struct.pack("<I", 2), "chunk_count": struct.pack("<I", 4)}
    return record(b" " * 300, op=b"\x03", index_pos=struct.pack("<Q", index_pos), **counts)


def build() -> bytes:
    """Two topics in three plain chunks and one of bzip2."""
    return b"".join(p[0] for p in pieces())


def records(blob: bytes) -> list[Record]:  # noqa: ARG001
    """Records, those inside plain chunks for themselves."""
    found = []
    at = 0
    for data, rows, _ in pieces():
        found.append(Record(at, at + len(data), rows))
        at += len(data)
    return found


def at_risk(blob: bytes, byte: int) -> int:
    """A connection puts the rows of its stream at risk."""
    owned = records(blob)
    owner = owner_of(owned, byte)
    return 80 if pieces()[owned.index(owner)][2] >= 0 else owner.rows
