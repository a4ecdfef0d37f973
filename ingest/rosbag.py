"""ROS 1 bags (format 2.0): every topic a stream of its own, decoded from the definitions in the bag.

Stream keys, clocks and columns are those of an MCAP file with the same topics: `time_ns` is the message's own
stamp where it has one, else the time of recording, which is `recv_ns`. No ROS and no library is needed. As a
bag has no checksums outside bzip2 chunks, a damaged value inside a message is read as it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from flysid.errors import FormatError
from flysid.ingest.bag_records import (
    CONNECTION,
    MAGIC,
    MESSAGE,
    BagReader,
    BagRecord,
    indexed_connections,
    split_fields,
)
from flysid.ingest.base import Format, Limits, Parts, StreamPart, Summary, release
from flysid.ingest.mcap_records import Channel, Schema
from flysid.ingest.mcap_topics import ZERO_PAGE, Messages, Topic, log_clock
from flysid.ingest.tally import Tally

MAX_TOPICS = 5000
BATCH_BYTES = 16 << 20


@dataclass
class _Queue:
    """Messages of one topic that wait to be decoded together."""

    topic: Topic
    payloads: list[bytes] = field(default_factory=list)
    times: list[bytes] = field(default_factory=list)

    def take(self) -> Messages:
        """All of them; the queue is empty after."""
        size = np.array([len(p) for p in self.payloads], dtype=np.int64)
        data = np.frombuffer(b"".join([*self.payloads, bytes(ZERO_PAGE)]), dtype=np.uint8)
        stamps = np.frombuffer(b"".join(self.times), dtype="<u4").reshape(-1, 2).astype(np.int64)
        self.payloads, self.times = [], []
        return Messages(data, np.cumsum(size) - size, size, stamps[:, 0] * 10**9 + stamps[:, 1])


class _Connections:
    """Connection numbers and the topics they carry; publishers of one topic and type share a queue."""

    def __init__(self) -> None:
        self.of: dict[int, _Queue | None] = {}
        self.queues: dict[Channel, _Queue] = {}

    def define(self, record: BagRecord, data: bytes) -> None:
        """Learn a connection; the first definition of a number stands, one that is damaged is none."""
        fields = split_fields(data)
        if self.of.get(record.connection) is not None or fields is None:
            return
        if len(self.queues) >= MAX_TOPICS:
            self.of[record.connection] = None
            return
        name = record.fields[b"topic"].decode("utf-8", "replace")
        kind = fields.get(b"type", b"").decode("utf-8", "replace")
        channel = Channel(name, "ros1", Schema(kind, "ros1msg", fields.get(b"message_definition", b"")))
        if channel not in self.queues:
            self.queues[channel] = _Queue(Topic(channel))
        self.of[record.connection] = self.queues[channel]


def read_bag(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of all topics of a ROS 1 bag.

    Parameters
    ----------
    view : the file.
    name : its name, for errors.
    limits : bounds; see Limits.

    Raises
    ------
    FormatError : there is not one record in the file.
    """
    tally, connections = Tally(), _Connections()
    reader = BagReader(view, limits, tally)
    streams: dict[str, pa.Schema] = {}
    for known in indexed_connections(view):
        connections.define(known, bytes(view[known.data_at : known.end]))
    waiting = released = seen = 0
    for source, record in reader.records():
        seen += 1
        if record.op == CONNECTION:
            connections.define(record, bytes(source[record.data_at : record.end]))
        elif record.op == MESSAGE:
            waiting += _queue(connections, record, source, tally)
        if waiting >= min(limits.batch_bytes, BATCH_BYTES):
            yield from _decode(connections, tally, streams)
            release(view, released, reader.place)
            waiting, released = 0, reader.place
    yield from _decode(connections, tally, streams)
    if not seen:
        raise FormatError(
            "no record in this bag can be read", path=name, byte=0, hint="is the copy complete?"
        )
    topics = [queue.topic for queue in connections.queues.values()]
    return Summary(tally.freeze(), (log_clock(topics),) if topics else (), {})


def _queue(connections: _Connections, record: BagRecord, source: memoryview | bytes, tally: Tally) -> int:
    """Put a message into its queue; returns the bytes that now wait."""
    queue = connections.of.get(record.connection)
    if queue is None:
        tally.undecode("(connection without definition)")
        return 0
    queue.payloads.append(bytes(source[record.data_at : record.end]))
    queue.times.append(record.fields[b"time"])
    return record.end - record.start


def _decode(connections: _Connections, tally: Tally, streams: dict[str, pa.Schema]) -> Iterator[StreamPart]:
    for queue in connections.queues.values():
        if queue.payloads:
            yield from queue.topic.decode(queue.take(), tally, streams)


def sniff_bag(head: bytes, name: str) -> float:
    """1 for the magic; 0.5 for a file called .bag whose magic is damaged in up to two bytes."""
    if head.startswith(MAGIC):
        return 1.0
    same = sum(a == b for a, b in zip(head, MAGIC, strict=False))
    return 0.5 if same >= len(MAGIC) - 2 and name.lower().endswith(".bag") else 0.0


FORMAT = Format("rosbag", "ROS 1 bag", (".bag",), sniff_bag, read_bag)
