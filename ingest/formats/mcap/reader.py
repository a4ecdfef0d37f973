"""MCAP logs: ROS 1, ROS 2, protobuf and JSON topics, each a stream of its own.

The stream key is the topic. `time_ns` is the message's own stamp where it has one (`header.stamp`, `stamp`,
`timestamp`), else the log time; which of them is in the schema metadata as `time_source`. The log time is
`recv_ns`. A recorder that left it at 0 is believed in its publish time.
A topic whose layout changes goes on under `topic~2`. Topics without a known layout are named in the damage.
Messages are gathered over chunks to batches, then decoded topic by topic.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from flysid.errors import FormatError
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary, release, sniff_magic
from flysid.ingest.formats.common.gather import Bytes
from flysid.ingest.formats.common.tally import Tally, joined
from flysid.ingest.formats.mcap.chunks import Block
from flysid.ingest.formats.mcap.container import McapReader
from flysid.ingest.formats.mcap.records import MAGIC, Registry
from flysid.ingest.formats.messages.topic import ZERO_PAGE, Messages
from flysid.ingest.formats.messages.topics import BATCH_BYTES, Topics
from flysid.showing import counted


@dataclass
class _Batch:
    """Blocks that wait to be decoded together."""

    blocks: list[Block] = field(default_factory=list)
    payload: int = 0

    def add(self, block: Block) -> None:
        if len(block.at):
            self.blocks.append(block)
            self.payload += len(block.data)

    def by_channel(self) -> Iterator[tuple[int, Messages]]:
        """Channel number and its messages, in file order, over all blocks."""
        if not self.blocks:
            return
        data, bases = _join([b.data for b in self.blocks])
        at = np.concatenate([b.at + base for b, base in zip(self.blocks, bases, strict=True)])
        size = np.concatenate([b.size for b in self.blocks])
        log_ns = np.concatenate([b.log_ns for b in self.blocks])
        channel = np.concatenate([b.channel for b in self.blocks])
        order = np.argsort(channel.astype(np.int32), kind="stable")
        cuts = np.flatnonzero(np.diff(channel[order])) + 1
        for which in np.split(order, cuts):
            yield int(channel[which[0]]), Messages(data, at[which], size[which], log_ns[which])


def _join(parts: list[Bytes]) -> tuple[Bytes, list[int]]:
    """Buffers as one, with a page of zeros behind them, and where each begins in it."""
    bases = np.concatenate([[0], np.cumsum([len(p) for p in parts])[:-1]]).tolist()
    return np.concatenate([*parts, np.zeros(ZERO_PAGE, dtype=np.uint8)]), bases


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of all topics of an MCAP file.

    Parameters
    ----------
    view : the file.
    name : its name, for errors.
    limits : bounds; see Limits.

    Raises
    ------
    FormatError : there is not one message in the file, nor the end that an empty log would have.
    """
    return read_files((view,), name, limits)


def read_files(views: Sequence[memoryview], name: str, limits: Limits) -> Parts:
    """As `read`, of a recording that was split over several files."""
    damages = []
    info: dict[str, str] = {}
    has_channels = False
    published = 0
    topics = Topics(Tally())
    for number, view in enumerate(views):
        topics.tally = Tally()
        reader = McapReader(view, limits, topics.tally)
        yield from _gathered(view, number, reader, topics, limits)
        damages.append((len(view), topics.tally.freeze()))
        info |= reader.info
        published += reader.published
        has_channels |= bool(reader.registry.channels)
    damage = joined(damages)
    if not topics and damage.lossy and not has_channels:
        why = damage.regions[0] if damage.regions else None
        raise FormatError(
            "no message in this MCAP file can be read" + (f": {why.reason}" if why else ""),
            path=name,
            byte=why.start if why else 0,
            hint="check that this is an MCAP file, and that the download or copy finished",
        )
    notes = topics.notes()
    if published:
        bare = f"{counted(published, 'message')} without a log time: the time of publishing stands for it"
        notes["clock_note"] = "; ".join(filter(None, (bare, notes.get("clock_note", ""))))
    return Summary(damage, topics.clocks(), {**info, **notes})


def _gathered(
    view: memoryview, number: int, reader: McapReader, topics: Topics, limits: Limits
) -> Iterator[StreamPart]:
    """Parts of one file, by its number: files number their channels for themselves."""
    batch = _Batch()
    released = 0
    for block in reader.blocks():
        batch.add(block)
        if batch.payload >= min(limits.batch_bytes, BATCH_BYTES):
            yield from _decode(batch, number, reader.registry, topics)
            batch = _Batch()
            release(view, released, reader.place)
            released = reader.place
    yield from _decode(batch, number, reader.registry, topics)


def _decode(batch: _Batch, file: int, registry: Registry, topics: Topics) -> Iterator[StreamPart]:
    """Parts of a batch."""
    for number, messages in batch.by_channel():
        if number < 0:
            topics.tally.undecode("(channel without definition)", len(messages.at))
        else:
            yield from topics.decode((file, number), registry.channels[number], messages)


def listen(view: memoryview, limits: Limits) -> Iterator[tuple[str, int]]:
    """Topic and time of recording of each message of a file."""
    reader = McapReader(view, limits, Tally())
    for block in reader.blocks():
        for channel, log_ns in zip(block.channel.tolist(), block.log_ns.tolist(), strict=True):
            if channel >= 0:
                yield reader.registry.channels[channel].topic, log_ns


def sniff(head: bytes, name: str) -> float:
    """As `sniff_magic`."""
    return sniff_magic(head, name, MAGIC, ".mcap")
