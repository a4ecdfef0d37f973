"""ROS 2 bags (.db3) without positions and identifiers: messages rewritten, in a database made anew.

Left out: topics that cannot be decoded, corrections for receivers, metadata, qualities of service. Messages
compressed one by one are written as they are when expanded. The copy has the tables of ROS 2 Jazzy (schema 4)
and the definitions with which the log was read. A metadata.yaml beside the log is not touched;
`ros2 bag reindex` makes one for the copy.
"""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Iterator
from pathlib import Path

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.scrub_rules import Scrubber
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.messages.channel import Channel
from flysid.ingest.formats.messages.scrub import Clean, cleaner_for
from flysid.ingest.formats.rosbag2.reader import Bag

PIECE_BYTES = 1 << 20
TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
  type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema VALUES (4, 'jazzy');
"""


def scrub(view: memoryview, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:
    """The bag, scrubbed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "copy.db3")
        _fill(path, view, scrubber, limits)
        scrubber.notes.append("Metadata is left out; pictures and point clouds stay.")
        with path.open("rb") as file:
            while piece := file.read(PIECE_BYTES):
                yield piece


def _fill(path: Path, view: memoryview, scrubber: Scrubber, limits: Limits) -> None:
    tally = Tally()
    bag = Bag(view, limits, tally)
    link = sqlite3.connect(path)
    try:
        link.executescript(TABLES)
        topics: dict[Channel, tuple[int, Clean] | None] = {}
        for message in bag.messages():
            channel = message.channel
            if channel is not None and channel not in topics:
                topics[channel] = _topic(link, len(topics) + 1, channel, scrubber)
            topic = topics[channel] if channel is not None else None
            try:
                clean = None if topic is None else topic[1](message.payload)
            except (ValueError, RecursionError):
                clean = None
            if topic is None or clean is None:
                name = channel.topic if channel is not None else "topics without definition"
                scrubber.note(rules.UNREADABLE, f"messages of {name}", 1)
                continue
            new = (topic[0], message.log_ns, clean)
            link.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", new)
        link.commit()
    finally:
        link.close()
    bag.tables.settle(tally)
    scrubber.note(rules.UNREADABLE, "between records", tally.freeze().bytes_skipped)


def _topic(
    link: sqlite3.Connection, number: int, channel: Channel, scrubber: Scrubber
) -> tuple[int, Clean] | None:
    """The number of the topic in the copy and what cleans its messages; None where they cannot be decoded."""
    schema = channel.schema
    clean = cleaner_for(channel, scrubber)
    if clean is None or schema is None:
        return None
    link.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '', '')", (number, channel.topic, schema.name))
    same = "SELECT 1 FROM message_definitions WHERE topic_type = ?"
    if link.execute(same, (schema.name,)).fetchone() is None:
        new = (number, schema.name, schema.encoding, schema.data.decode("utf-8", "replace"))
        link.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, '')", new)
    return number, clean
