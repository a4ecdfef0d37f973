"""ROS 2 bags in SQLite files (.db3): every topic a stream of its own.

Stream keys, clocks and columns are those of an MCAP file with the same topics. Tables used: `topics` (id,
name, type, serialization format), `messages` (topic, time of recording in ns, CDR bytes) and, in bags since
ROS 2 Iron, `message_definitions` (type, encoding, text). Older bags hold no definitions: those of ROS 2
Humble are taken from the optional library rosbags. Several files
of one recording are one log: see `recordings`. Messages compressed one by one are known by the magic of zstd.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from flysid.errors import FormatError
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary
from flysid.ingest.formats.common.compression import ZSTD_MAGIC, CompressionError, unpack_message
from flysid.ingest.formats.common.tally import Tally, joined
from flysid.ingest.formats.messages.channel import Channel, Schema
from flysid.ingest.formats.messages.topics import Message, Topics, gather
from flysid.ingest.formats.rosbag2.ros_types import find_definition
from flysid.ingest.formats.rosbag2.sqlite_pages import MAGIC
from flysid.ingest.formats.rosbag2.sqlite_tables import Row, Tables
from flysid.showing import first_of

MAX_CHANNELS = 1 << 16
MOST_NAMED = 5
MARK = b"CREATE TABLE messages"


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of all topics of one file of a ROS 2 bag.

    Parameters
    ----------
    view : the file.
    name : its name, for errors.
    limits : bounds; see Limits.

    Raises
    ------
    FormatError : it holds no row of messages, and no table that could.
    """
    return read_files((view,), name, limits)


def read_files(views: Sequence[memoryview], name: str, limits: Limits) -> Parts:
    """As `read`, of a bag that was split over several files."""
    damages = []
    info: dict[str, str] = {}
    is_bag = False
    tables: list[str] = []
    topics = Topics(Tally())
    for view in views:
        topics.tally = Tally()
        bag = Bag(view, limits, topics.tally)
        yield from _gathered(view, bag, topics, limits)
        bag.tables.settle(topics.tally)
        damages.append((len(view), topics.tally.freeze()))
        info |= bag.info
        is_bag |= bool(bag.rows) or "messages" in bag.tables
        tables += bag.tables.names
    if not is_bag:
        raise FormatError(
            "no table of messages in this SQLite file"
            + (f", which holds {first_of(tables, MOST_NAMED)}" if tables else ""),
            path=name,
            byte=0,
            hint="it is a database of another program: give the bag"
            if tables
            else "check that this is a ROS 2 bag, and that the download or copy finished",
        )
    return Summary(joined(damages), topics.clocks(), {**info, **topics.notes()})


def _gathered(view: memoryview, bag: Bag, topics: Topics, limits: Limits) -> Iterator[StreamPart]:
    """Parts of one file."""
    yield from gather(bag.messages(), topics, limits.batch_bytes, view, lambda: bag.tables.place)


def listen(view: memoryview, limits: Limits) -> Iterator[tuple[str, int]]:
    """Topic and time of recording of each message of a file."""
    for message in Bag(view, limits, Tally()).messages():
        if message.channel is not None:
            yield message.channel.topic, message.log_ns


class Bag:
    """The messages of one file; `rows` and `info` fill while they are read."""

    def __init__(self, view: memoryview, limits: Limits, tally: Tally) -> None:
        self.tables = Tables(view)
        self.rows = 0
        self.info: dict[str, str] = {}
        self._limits = limits
        self._tally = tally
        self._channels = self._read_channels()

    def messages(self) -> Iterator[Message]:
        """Every message, in the order of the table, then those on pages that damage cut loose."""
        topic, when, data = self.tables.places("messages", ("topic_id", "timestamp", "data"), (1, 2, 3))

        def fits(row: Row) -> bool:
            return (
                len(row) > max(topic, when, data)
                and isinstance(row[topic], int)
                and isinstance(row[when], int)
                and isinstance(row[data], bytes)
            )

        for source in (self.tables.rows("messages", fits), self.tables.stray_rows(fits)):
            for row in source:
                self.rows += 1
                yield self._message(row[topic], row[when], row[data])

    def _message(self, topic: Any, log_ns: Any, payload: Any) -> Message:
        channel = self._channels.get(topic)
        if channel is None:
            self._tally.undecode(f"(topic {topic}, which the bag does not name)")
        elif payload[:4] == ZSTD_MAGIC:
            try:
                payload = unpack_message(payload, self._limits)
            except CompressionError as error:
                self._tally.undecode(channel.topic, 1, str(error))
                channel = None
        return Message(channel, payload, log_ns)

    def _read_channels(self) -> Mapping[int, Channel]:
        """Channels by the number of their topic."""
        known: dict[str, tuple[str, str]] = {}
        kind, encoding, text = self.tables.places(
            "message_definitions", ("topic_type", "encoding", "encoded_message_definition"), (1, 2, 3)
        )
        for row in self.tables.rows("message_definitions", _has_texts(kind, encoding, text)):
            known.setdefault(str(row[kind]), (str(row[encoding]), str(row[text])))
        channels: dict[int, Channel] = {}
        places = self.tables.places("topics", ("id", "name", "type", "serialization_format"), (0, 1, 2, 3))
        number, name, kind, wire = places
        for k, row in enumerate(self.tables.rows("topics", _has_texts(name, kind, wire)), 1):
            if k <= MAX_CHANNELS:
                schema = self._schema(str(row[kind]), known)
                channels.setdefault(_whole(row[number]), Channel(str(row[name]), str(row[wire]), *schema))
        return channels

    def _schema(self, kind: str, known: Mapping[str, tuple[str, str]]) -> tuple[Schema, str]:
        """The schema of a type, and why there is none."""
        found = find_definition(kind, *known.get(kind, ("", "")))
        if found.source:
            self.info["definitions"] = found.source
        return Schema(kind, "" if found.fault else found.encoding, found.text.encode()), found.fault


def _whole(value: Any) -> int:
    return value if isinstance(value, int) else -1


def _has_texts(*places: int) -> Any:
    """A test of rows: text in all these columns."""
    return lambda row: len(row) > max(places) and all(isinstance(row[k], str) for k in places)


def sniff(head: bytes, name: str) -> float:
    """1 for an SQLite file with a table of messages; 0.5 for a .db3 whose first page is damaged."""
    if head.startswith(MAGIC):
        return 1.0 if MARK in head else 0.5 if ".db3" in name.lower() else 0.1
    same = sum(a == b for a, b in zip(head, MAGIC, strict=False))
    return 0.5 if same >= len(MAGIC) - 2 and ".db3" in name.lower() else 0.0
