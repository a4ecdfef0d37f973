"""ROS 1 bags (format 2.0): every topic a stream of its own, decoded from the definitions in the bag.

Stream keys, clocks and columns are those of an MCAP file with the same topics: `time_ns` is the message's own
stamp where it has one, else the time of recording, which is `recv_ns`. No ROS and no library is needed. As a
bag has no checksums outside bzip2 chunks, a damaged value inside a message is read as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flysid.errors import FormatError
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary, sniff_magic
from flysid.ingest.formats.common.tally import Tally, joined
from flysid.ingest.formats.messages.channel import Channel, Schema
from flysid.ingest.formats.messages.topics import Message, Topics, gather
from flysid.ingest.formats.rosbag1.records import (
    MAGIC,
    BagReader,
    BagRecord,
    Op,
    indexed_connections,
    place_of,
    split_fields,
)
from flysid.ingest.formats.rosbag1.runs import MessagePlace

MAX_CONNECTIONS = 1 << 16


class _Connections:
    """Connection numbers and the channels they carry."""

    def __init__(self) -> None:
        self._of: dict[int, Channel] = {}

    def define(self, record: BagRecord, data: bytes) -> bool:
        """Learn a connection; the first definition of a number stands. False where it is damaged."""
        fields = split_fields(data)
        if record.connection in self._of or fields is None or len(self._of) >= MAX_CONNECTIONS:
            return fields is not None
        name = record.fields[b"topic"].decode("utf-8", "replace")
        kind = fields.get(b"type", b"").decode("utf-8", "replace")
        schema = Schema(kind, "ros1msg", fields.get(b"message_definition", b""))
        self._of[record.connection] = Channel(name, "ros1", schema)
        return True

    def messages(self, run: list[MessagePlace], source: memoryview | bytes) -> Iterator[Message]:
        """Messages with their channels; publishers of one topic and type share it."""
        first = run[0].data_at
        data = bytes(source[first : run[-1].end])
        for number, log_ns, start, end in run:
            yield Message(self._of.get(number), data[start - first : end - first], log_ns)


def read(view: memoryview, name: str, limits: Limits) -> Parts:
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
    return read_files((view,), name, limits)


def read_files(views: Sequence[memoryview], name: str, limits: Limits) -> Parts:
    """As `read`, of a recording that was split over several files."""
    damages = []
    seen = 0
    topics = Topics(Tally())
    for view in views:
        tally = topics.tally = Tally()
        reader = BagReader(view, limits, tally)
        yield from _gathered(view, reader, topics, limits)
        damages.append((len(view), tally.freeze()))
        seen += reader.seen
    if not seen:
        raise FormatError(
            "no record in this bag can be read",
            path=name,
            byte=0,
            hint="check that the download or copy finished",
        )
    return Summary(joined(damages), topics.clocks(), topics.notes())


def _gathered(view: memoryview, reader: BagReader, topics: Topics, limits: Limits) -> Iterator[StreamPart]:
    """Parts of one file."""
    messages = _messages(view, reader, topics.tally)
    yield from gather(messages, topics, limits.batch_bytes, view, lambda: reader.place)


def listen(view: memoryview, limits: Limits) -> Iterator[tuple[str, int]]:
    """Topics and times of recording of the messages of a file."""
    tally = Tally()
    for message in _messages(view, BagReader(view, limits, tally), tally):
        if message.channel is not None:
            yield message.channel.topic, message.log_ns


def _messages(view: memoryview, reader: BagReader, tally: Tally) -> Iterator[Message]:
    """Every message of a bag in file order; those of no known connection are counted."""
    connections = _Connections()
    for known in indexed_connections(view):
        connections.define(known, bytes(view[known.data_at : known.end]))
    for source, piece in reader.pieces():
        if not isinstance(piece, BagRecord):
            run = piece
        elif piece.op == Op.MESSAGE:
            run = [place_of(piece)]
        else:
            run = []
            data = bytes(source[piece.data_at : piece.end]) if piece.op == Op.CONNECTION else b""
            if piece.op == Op.CONNECTION and not connections.define(piece, data):
                tally.undecode("(connections)")  # its length may have taken in messages
        for message in connections.messages(run, source) if run else ():
            if message.channel is None:
                tally.undecode("(connection without definition)")
            yield message


def sniff(head: bytes, name: str) -> float:
    """As `sniff_magic`."""
    return sniff_magic(head, name, MAGIC, ".bag")
