"""MCAP without positions and identifiers: messages rewritten, written anew with the same topics and times.

JSON, protobuf, ROS 1 and CDR messages are scrubbed by the fields that their schemas name. Left out: topics
that cannot be decoded, attachments, metadata. Chunks are compressed with zstd where the log's were.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import IO, Any, cast

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.scrub_rules import Scrubber, ScrubColumn
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.mcap.container import McapReader
from flysid.ingest.formats.mcap.records import HEAD_BYTES, MESSAGE_HEAD_BYTES
from flysid.ingest.formats.messages.channel import Channel
from flysid.ingest.formats.messages.definitions import DefinitionError
from flysid.ingest.formats.messages.protobuf import parse_descriptors
from flysid.ingest.formats.messages.scrub import CORRECTIONS, Clean, cleaner_for

LIBRARY = "flysid scrub"
CHUNK_BYTES = 1 << 20


def scrub(view: memoryview, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:
    """The log, scrubbed."""
    from mcap.writer import CompressionType, Writer

    tally = Tally()
    reader = McapReader(view, limits, tally)
    sink = _Sink()
    is_packed = b"zstd" in bytes(view[: 1 << 16]) or b"lz4" in bytes(view[: 1 << 16])
    compression = CompressionType.ZSTD if is_packed else CompressionType.NONE
    writer = Writer(cast("IO[Any]", sink), chunk_size=CHUNK_BYTES, compression=compression)
    writer.start(profile="", library=LIBRARY)
    topics: dict[int, tuple[int, Clean] | None] = {}
    for block in reader.blocks():
        data = block.data.data
        for at, size, number in zip(
            block.at.tolist(), block.size.tolist(), block.channel.tolist(), strict=True
        ):
            channel = reader.registry.channels[number] if number >= 0 else None
            if number not in topics:
                topics[number] = None if channel is None else _topic(writer, channel, scrubber)
            topic = topics[number]
            name = "topics without definition" if channel is None else channel.topic
            try:
                content = None if topic is None else topic[1](bytes(data[at : at + size]))
            except (ValueError, RecursionError):
                content = None
            if topic is None or content is None:
                scrubber.note(rules.UNREADABLE, f"messages of {name}", 1)
                continue
            head = bytes(data[at - MESSAGE_HEAD_BYTES + HEAD_BYTES : at])
            sequence, logged, sent = (
                int.from_bytes(head[a:b], "little") for a, b in ((2, 6), (6, 14), (14, 22))
            )
            writer.add_message(topic[0], logged, content, sent, sequence)
        yield sink.drain()
    writer.finish()  # type: ignore[no-untyped-call]
    scrubber.note(rules.UNREADABLE, "between records", tally.freeze().bytes_skipped)
    scrubber.notes.append("Metadata and attachments, if any, are left out; pictures and point clouds stay.")
    yield sink.drain()


class _Sink:
    """Takes what the writer writes, and gives it away piece by piece."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
        self._at = 0

    def write(self, content: Any) -> int:
        self._pieces.append(bytes(content))
        self._at += len(self._pieces[-1])
        return len(self._pieces[-1])

    def tell(self) -> int:
        return self._at

    def drain(self) -> bytes:
        pieces = self._pieces
        self._pieces = []
        return b"".join(pieces)


def _topic(writer: Any, channel: Channel, scrubber: Scrubber) -> tuple[int, Clean] | None:
    """The channel's id in the copy and what cleans its messages; None where they cannot be decoded."""
    schema = channel.schema
    try:
        clean = _cleaner(channel, scrubber)
    except (DefinitionError, ValueError):
        return None
    if clean is None or CORRECTIONS in f"{channel.topic} {schema.name if schema else ''}".lower():
        return None
    number = 0 if schema is None else writer.register_schema(schema.name, schema.encoding, schema.data)
    return int(writer.register_channel(channel.topic, channel.encoding, number)), clean


def _cleaner(channel: Channel, scrubber: Scrubber) -> Clean | None:
    """What cleans one message of a channel. Raises DefinitionError where its schema gives no layout."""
    where = channel.topic
    schema = channel.schema
    if channel.encoding == "json":
        return lambda raw: _json(raw, where, scrubber)
    if schema is None:
        return None
    if channel.encoding == "protobuf" and schema.encoding == "protobuf":
        layout = parse_descriptors(schema.name, schema.data)
        return lambda raw: _protobuf(layout.message.FromString(raw), where, scrubber)
    return cleaner_for(channel, scrubber)


def _json(raw: bytes, where: str, scrubber: Scrubber) -> bytes:
    tree = json.loads(raw)
    clean = rules.scrub_tree(tree, where, scrubber)
    return raw if clean == tree else json.dumps(clean, separators=(",", ":"), ensure_ascii=False).encode()


def _protobuf(message: Any, where: str, scrubber: Scrubber) -> bytes:
    message.DiscardUnknownFields()
    _scrub_fields(message, where, scrubber)
    return bytes(message.SerializeToString(deterministic=True))


def _scrub_fields(message: Any, where: str, scrubber: Scrubber) -> None:
    import numpy as np

    numbers: dict[str, float] = {}
    for field, value in message.ListFields():
        path = f"{where}.{field.name}"
        if field.message_type is not None and hasattr(value, "DESCRIPTOR"):
            _scrub_fields(value, path, scrubber)
        elif field.message_type is not None:
            inner = value.values() if hasattr(value, "values") else value
            for item in (i for i in inner if hasattr(i, "DESCRIPTOR")):
                _scrub_fields(item, path, scrubber)
        elif isinstance(value, str):
            clean = (
                ""
                if rules.is_identity(field.name)
                else rules.redact(value.encode()).decode("utf-8", "replace")
            )
            scrubber.note(rules.TEXT, path, clean != value)
            setattr(message, field.name, clean)
        elif hasattr(value, "append") and value and isinstance(value[0], str):
            value[:] = [rules.redact(text.encode()).decode("utf-8", "replace") for text in value]
        elif rules.is_identity(field.name):
            message.ClearField(field.name)
            scrubber.note(rules.IDENTITY, path, 1)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            numbers[field.name] = value
    columns = [
        ScrubColumn(name, name, 1e-7 if isinstance(v, int) and abs(v) > 360 else None)
        for name, v in numbers.items()
    ]
    for place in rules.places(columns):
        used = (place.lat, place.lon, *place.altitudes)
        rows = np.array([tuple(float(numbers[c.key]) for c in used)], dtype=[(c.key, "f8") for c in used])
        rules.scrub_place(rows, place, where, scrubber)
        for column in used:
            new = float(rows[column.key][0])
            setattr(message, column.key, round(new) if isinstance(numbers[column.key], int) else new)
