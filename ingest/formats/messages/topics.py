"""The topics of a log whose messages carry definitions: MCAP, ROS 1 bags and ROS 2 bags read alike.

A container's reader says which messages lie where; `Topics` keeps one decoder per topic and turns batches of
messages into parts of streams. Where a container gives messages one by one, `gather` gathers them to batches.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from flysid.flight import ClockMap
from flysid.ingest.formats.base import StreamPart, release
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.messages.channel import Channel
from flysid.ingest.formats.messages.topic import ZERO_PAGE, Messages, Topic, log_clock
from flysid.showing import first_of

MAX_TOPICS = 5000
NAMED = 8
BATCH_BYTES = 8 << 20  # larger ones touch new memory for every message, which costs more than decoding


class Topics:
    """Decoders by key (a channel's number, or the channel itself), and the stream keys they have taken.

    `tally` counts what is not decoded; of a log of several files, each has its own.
    """

    def __init__(self, tally: Tally) -> None:
        self.tally = tally
        self._topics: dict[Hashable, Topic] = {}
        self._streams: dict[str, pa.Schema] = {}

    def __bool__(self) -> bool:
        return bool(self._topics)

    def decode(self, key: Hashable, channel: Channel, messages: Messages) -> Iterator[StreamPart]:
        """The part that messages of one channel give; those of topics beyond the bound are counted."""
        topic = self._topics.get(key)
        if topic is None:
            if len(self._topics) >= MAX_TOPICS:
                self.tally.undecode(f"(topics beyond {MAX_TOPICS})", len(messages.at))
                return
            topic = self._topics[key] = Topic(channel)
        yield from topic.decode(messages, self.tally, self._streams)

    def clocks(self) -> tuple[ClockMap, ...]:
        """Log time against the messages' own stamps."""
        return (log_clock(list(self._topics.values())),) if self._topics else ()

    def notes(self) -> dict[str, str]:
        """What to know of a flight on two clocks: topics without a stamp have the time of recording."""
        topics = [topic for topic in self._topics.values() if topic.rows]
        lags = [lag for topic in topics for lag in topic.lags]
        bare = sorted({topic.channel.topic for topic in topics if topic.is_unstamped})
        if not bare or not lags:
            return {}
        names = first_of(bare, NAMED)
        ahead_s = float(np.median(lags)) * 1e-9
        text = (
            f"{names}: no stamp, on the time of recording, {ahead_s:.3f} s ahead of the other topics' stamps"
        )
        return {"clock_note": text}


class Message(NamedTuple):
    """One message, apart: its channel (None where it has none), its payload and its log time."""

    channel: Channel | None
    payload: bytes
    log_ns: int


@dataclass
class _Queue:
    """Messages of one topic that wait to be decoded together."""

    payloads: list[bytes] = field(default_factory=list)
    times: list[int] = field(default_factory=list)

    def take(self) -> Messages:
        """All of them; the queue is empty after."""
        size = np.array([len(p) for p in self.payloads], dtype=np.int64)
        data = np.frombuffer(b"".join([*self.payloads, bytes(ZERO_PAGE)]), dtype=np.uint8)
        log_ns = np.array(self.times, dtype=np.int64)
        self.payloads = []
        self.times = []
        return Messages(data, np.cumsum(size) - size, size, log_ns)


def gather(
    messages: Iterable[Message], topics: Topics, batch_bytes: int, view: memoryview, place: Callable[[], int]
) -> Iterator[StreamPart]:
    """Parts of messages that come one by one, topic by topic, in batches of at most `batch_bytes`.

    Messages of equal channels are decoded together, in order. Behind each batch, what was read of `view`, up
    to `place()`, is released.
    """
    queues: dict[Channel, _Queue] = {}
    same: dict[
        int, tuple[Channel, _Queue]
    ] = {}  # by identity: a channel's hash takes in its whole definition
    waiting = 0
    released = 0
    for channel, payload, log_ns in messages:
        if channel is None:
            continue
        known = same.get(id(channel))
        if known is None:
            known = same[id(channel)] = (channel, queues.setdefault(channel, _Queue()))
        queue = known[1]
        queue.payloads.append(payload)
        queue.times.append(log_ns)
        waiting += len(payload) + _HELD_BYTES
        if waiting >= min(batch_bytes, BATCH_BYTES):
            yield from _decode(queues, topics)
            release(view, released, place())
            released = place()
            waiting = 0
    yield from _decode(queues, topics)


_HELD_BYTES = 100  # what Python keeps for a payload and a time besides their bytes


def _decode(queues: dict[Channel, _Queue], topics: Topics) -> Iterator[StreamPart]:
    for channel, queue in queues.items():
        if queue.payloads:
            yield from topics.decode(channel, channel, queue.take())
