"""ROS 1 bags without positions and identifiers: messages rewritten in place, in a bag written anew.

Left out: topics that cannot be decoded, corrections for receivers, and of connections all but topic, type and
definition (the names of nodes tell machines and users). Chunks are compressed as the log's first one was.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.scrub_rules import Scrubber
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.messages.channel import Channel, Schema
from flysid.ingest.formats.messages.scrub import Clean, cleaner_for
from flysid.ingest.formats.rosbag1.records import (
    MAGIC,
    BagReader,
    BagRecord,
    Op,
    indexed_connections,
    record_at,
    split_fields,
)
from flysid.ingest.formats.rosbag1.writer import BagWriter

KEPT_FIELDS = (b"type", b"md5sum", b"message_definition", b"latching")
PIECE_BYTES = 1 << 20


def scrub(view: memoryview, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:
    """The bag, scrubbed."""
    tally = Tally()
    reader = BagReader(view, limits, tally)
    with tempfile.TemporaryFile() as body:  # the bag's first record tells where its last ones are
        writer = BagWriter(body, _compression(view))
        topics = _Topics(writer, scrubber)
        for known in indexed_connections(view):
            topics.define(known, bytes(view[known.data_at : known.end]))
        for source, record in reader.records():
            content = bytes(source[record.data_at : record.end]) if record.op != Op.CHUNK else b""
            if record.op == Op.CONNECTION:
                topics.define(record, content)
            elif record.op == Op.MESSAGE:
                topics.add(record, content)
        writer.finish()
        scrubber.note(rules.UNREADABLE, "between records", tally.freeze().bytes_skipped)
        scrubber.notes.append("Names of nodes are left out; pictures and point clouds stay.")
        yield writer.head()
        body.seek(0)
        while piece := body.read(PIECE_BYTES):
            yield piece


class _Topics:
    """Connections of the log, those of the copy, and what cleans their messages."""

    def __init__(self, writer: BagWriter, scrubber: Scrubber) -> None:
        self._writer = writer
        self._scrubber = scrubber
        self._known: dict[int, tuple[bytes, Mapping[bytes, bytes]]] = {}
        self._ready: dict[int, tuple[int, Clean] | None] = {}

    def define(self, record: BagRecord, data: bytes) -> None:
        """Learn a connection; the first definition of a number stands."""
        fields = split_fields(data)
        if fields is not None and record.connection not in self._known:
            self._known[record.connection] = (record.fields[b"topic"], fields)

    def add(self, record: BagRecord, data: bytes) -> None:
        """Clean one message and write it; or count it."""
        number = record.connection
        if number not in self._known:
            self._scrubber.note(rules.UNREADABLE, "messages of topics without definition", 1)
            return
        if number not in self._ready:
            self._ready[number] = self._prepare(*self._known[number])
        ready = self._ready[number]
        try:
            clean = None if ready is None else ready[1](data)
        except (ValueError, RecursionError):
            clean = None
        if ready is None or clean is None:
            name = self._known[number][0].decode("utf-8", "replace")
            self._scrubber.note(rules.UNREADABLE, f"messages of {name}", 1)
            return
        self._writer.add(ready[0], record.fields[b"time"], clean)

    def _prepare(self, topic: bytes, fields: Mapping[bytes, bytes]) -> tuple[int, Clean] | None:
        kind = fields.get(b"type", b"").decode("utf-8", "replace")
        schema = Schema(kind, "ros1msg", fields.get(b"message_definition", b""))
        clean = cleaner_for(Channel(topic.decode("utf-8", "replace"), "ros1", schema), self._scrubber)
        if clean is None:
            return None
        about = {name: fields[name] for name in KEPT_FIELDS if name in fields}
        return self._writer.connect(topic, about), clean


def _compression(view: memoryview) -> bytes:
    """That of the first chunk, where it stands at its place."""
    head = record_at(view, len(MAGIC), len(view))
    first = record_at(view, head.end, len(view)) if head is not None else None
    kind = first.fields[b"compression"] if first is not None and first.op == Op.CHUNK else b"none"
    return kind if kind in (b"bz2", b"lz4") else b"none"
