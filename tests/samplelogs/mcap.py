"""MCAP files made in tests, with the mcap library's own writer; and the sample log of the contract tests."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mcap.writer import CompressionType, Writer

from tests.samplelogs import Record

SECOND = 10**9
SUFFIX = ".mcap"
KNOWS_ITS_END = True
MAGIC_BYTES = 8


def build() -> bytes:
    """A JSON and a ROS 1 topic in zstd chunks of about ten messages."""
    rows = [{"k": k, "x": k / 7} for k in range(60)]
    schema = {"properties": {"k": {"type": "integer"}, "x": {"type": "number", "unit": "m"}}}
    pairs = [struct.pack("<Id", k, k / 3) for k in range(60)]
    topics = [json_topic("/a", schema, rows), ros1_topic("/b", "p/Pair", "uint32 k\nfloat64 x\n", pairs)]
    return mcap_file(topics, chunk_size=500)


def records(blob: bytes) -> list[Record]:
    """Top-level records; the rows of a chunk are those that its message indexes count."""
    found = [Record(0, MAGIC_BYTES, 0)]
    chunk = 0
    at = MAGIC_BYTES
    while at < len(blob) - MAGIC_BYTES:
        op, length = struct.unpack_from("<BQ", blob, at)
        end = at + 9 + length
        found.append(Record(at, end, int(op == 5)))
        if op == 6:
            chunk = len(found) - 1
        if op == 7:
            owner = found[chunk]
            found[chunk] = Record(owner.start, owner.end, owner.rows + (length - 6) // 16)
        at = end
    return [*found, Record(at, len(blob), 0)]


@dataclass(frozen=True)
class Topic:
    """A topic to write: its schema and messages as (log time in ns, payload)."""

    name: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes
    messages: Sequence[tuple[int, bytes]]


def mcap_file(
    topics: Iterable[Topic],
    *,
    compression: CompressionType = CompressionType.ZSTD,
    chunked: bool = True,
    chunk_size: int = 4096,
    recorded: bool = True,
    **options: Any,
) -> bytes:
    """A finished MCAP file with the messages of all topics in order of log time.

    `recorded`: whether the recorder notes its own time, too; else log times are 0.
    """
    out = io.BytesIO()
    writer = Writer(out, chunk_size=chunk_size, compression=compression, use_chunking=chunked, **options)
    writer.start(profile="test", library="flysid tests")
    queue = []
    for topic in topics:
        schema = writer.register_schema(topic.schema_name, topic.schema_encoding, topic.schema)
        channel = writer.register_channel(topic.name, topic.encoding, schema)
        queue += [(when, channel, payload) for when, payload in topic.messages]
    for number, (when, channel, payload) in enumerate(sorted(queue, key=lambda m: m[0])):
        writer.add_message(channel, when if recorded else 0, payload, when, number)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def json_topic(name: str, schema: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> Topic:
    """A JSON topic at 100 Hz."""
    messages = [(SECOND + k * 10**7, json.dumps(row).encode()) for k, row in enumerate(rows)]
    return Topic(name, "json", name.strip("/"), "jsonschema", json.dumps(schema).encode(), messages)


def ros1_topic(name: str, kind: str, definition: str, payloads: Sequence[bytes]) -> Topic:
    """A ROS 1 topic at 100 Hz."""
    messages = [(SECOND + k * 10**7, p) for k, p in enumerate(payloads)]
    return Topic(name, "ros1", kind, "ros1msg", definition.encode(), messages)


def ros2_topic(name: str, kind: str, definition: str, payloads: Sequence[bytes]) -> Topic:
    """A ROS 2 topic at 100 Hz."""
    messages = [(SECOND + k * 10**7, p) for k, p in enumerate(payloads)]
    return Topic(name, "cdr", kind, "ros2msg", definition.encode(), messages)


def record(op: int, body: bytes, length: int | None = None) -> bytes:
    """One MCAP record; `length` overrides the truth."""
    return struct.pack("<BQ", op, len(body) if length is None else length) + body


def prefixed(text: str | bytes) -> bytes:
    """A string with its length before it."""
    raw = text.encode() if isinstance(text, str) else text
    return struct.pack("<I", len(raw)) + raw
