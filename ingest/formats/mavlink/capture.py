"""MAVLink that went over a network: UDP datagrams and TCP streams of a capture (pcap, pcapng).

What other programs sent is passed over: a flow (from one address and port to another) carries MAVLink once a
whole payload is frames from end to end and the first one's checksum holds. A frame's arrival is that of the
packet in which it ends. What was captured twice, or sent again, is read once and counted.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from flysid.flight import Damage, Region
from flysid.ingest.formats.common.capture import SEQUENCES, Payload, is_capture, payloads
from flysid.ingest.formats.common.clock import IntArray
from flysid.ingest.formats.common.columns import as_array
from flysid.ingest.formats.common.located import Located
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.mavlink.frames import MARKER, Frames, Scanner, is_checked, read_header

LONGEST_FRAME = 280 + 13
MAX_EARLY = 64  # segments that wait for one ahead of them
MAX_STREAMS = 1024  # of those that spoke last


@dataclass
class _Stream:
    """One direction of a TCP connection.

    Attributes
    ----------
    expected : the next byte's number.
    opened : the first byte's, where the capture holds the opening; -1 where it does not.
    waiting : the beginning of a frame, and the segment in which it stands.
    early : segments that came ahead of others, by number.
    """

    expected: int
    opened: int = -1
    waiting: Located = field(default_factory=Located)
    early: dict[int, Payload] = field(default_factory=dict)

    def knows(self, found: Payload) -> bool:
        """Whether all of a segment was there before."""
        ends = ((found.sequence or 0) + len(found.body) - self.expected) % SEQUENCES
        return ends == 0 or ends >= SEQUENCES // 2 or (found.sequence or 0) in self.early

    def in_order(self, found: Payload) -> Iterator[Payload]:
        """The segments that can be read now: what was sent before is passed over, what came early waits."""
        self.early.setdefault(found.sequence or 0, found)
        while ready := self._next(MAX_EARLY):
            yield ready

    def rest(self) -> Iterator[Payload]:
        """What still waits: the segments between are not in the capture."""
        while ready := self._next(0):
            yield ready

    def _next(self, most: int) -> Payload | None:
        """The segment that comes next; where more than `most` wait for it, the first of these."""
        ahead = {number: (number - self.expected) % SEQUENCES for number in self.early}
        for number, distance in ahead.items():
            if distance == 0 or distance >= SEQUENCES // 2:
                return self._taken(number)
        if len(ahead) <= most:
            return None
        self.expected = min(ahead, key=lambda number: ahead[number])
        return self._taken(self.expected)

    def _taken(self, number: int) -> Payload:
        found = self.early.pop(number)
        known = (self.expected - number) % SEQUENCES
        body = found.body.cut(known, len(found.body))
        self.expected = (self.expected + len(body)) % SEQUENCES
        return replace(found, body=body)


@dataclass
class Batch:
    """Pieces of payloads one after the other: their bytes; of each its start, place in the file and time."""

    data: bytearray = field(default_factory=bytearray)
    starts: list[int] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    times_us: list[int] = field(default_factory=list)

    def add(self, carried: Located, time_ns: int) -> None:
        """Take in what came at one time."""
        at = len(self.data)
        for place, size in carried.spans:
            self.starts.append(at)
            self.places.append(place)
            self.times_us.append(time_ns // 1000)
            at += size
        self.data += carried.data

    def stamped(self, frames: Frames) -> Frames:
        """Frames of these bytes with the times of their payloads."""
        which = np.searchsorted(np.array(self.starts), frames.start, side="right") - 1
        return replace(frames, stamp_us=np.array(self.times_us, dtype=np.int64)[which])


@dataclass
class Capture:
    """Takes MAVLink out of a capture, batch by batch.

    Parameters
    ----------
    crc_extra : seeds by message id, to tell MAVLink from other traffic.
    """

    crc_extra: npt.NDArray[np.int16]
    tally: Tally = field(default_factory=Tally)
    _flows: set[bytes] = field(default_factory=set)
    _passed: Counter[bytes] = field(
        default_factory=Counter
    )  # datagrams of flows that may prove to be MAVLink
    _streams: dict[bytes, _Stream] = field(default_factory=dict)
    _cut: list[Located] = field(default_factory=list)  # beginnings of frames whose rest is not there
    _places: list[tuple[IntArray, IntArray]] = field(default_factory=list)
    _base: int = 0

    def batches(self, view: memoryview, size: int) -> Iterator[tuple[Batch, int]]:
        """Batches of at least `size` bytes, and how many bytes came before each."""
        batch = Batch()
        time_ns = 0
        for found in self._in_order(view):
            time_ns = found.time_ns
            batch.add(self._of_tcp(found) if found.sequence is not None else self._of_udp(found), time_ns)
            if len(batch.data) >= size:
                yield self._closed(batch)
                batch = Batch()
        for cut in self._cut:
            batch.add(cut, time_ns)
        if batch.data:
            yield self._closed(batch)

    def _in_order(self, view: memoryview) -> Iterator[Payload]:
        """Datagrams as they came, segments in the order of their streams."""
        for found in payloads(view, self.tally):
            if found.sequence is None:
                yield found
                continue
            stream = self._streams.pop(found.flow, None) or _Stream(found.sequence)
            self._streams[found.flow] = stream  # the last that spoke
            if found.opens and found.sequence != stream.opened:  # ports are used again
                yield from self._ended(found.flow)
                stream = self._streams[found.flow] = _Stream(found.sequence, found.sequence)
            if len(found.body):
                self.tally.repeats += stream.knows(found)
                yield from stream.in_order(found)
            if len(self._streams) > MAX_STREAMS:
                yield from self._ended(next(iter(self._streams)))
        for flow in list(self._streams):
            yield from self._ended(flow)

    def _ended(self, flow: bytes) -> Iterator[Payload]:
        """What still waits of a stream, before it is forgotten; the beginning of a frame is kept apart."""
        yield from self._streams[flow].rest()
        stream = self._streams.pop(flow)
        if flow in self._flows:
            self._cut.append(stream.waiting)

    def _closed(self, batch: Batch) -> tuple[Batch, int]:
        base = self._base
        self._base = self._base + len(batch.data)
        self._places.append((np.array(batch.starts) + base, np.array(batch.places)))
        return batch, base

    def _of_udp(self, found: Payload) -> Located:
        """The datagram where it is MAVLink; nothing where it is something else."""
        is_whole = whole_frames(found.content) == len(found.content)
        if is_whole and (found.flow in self._flows or is_checked(found.content, 0, self.crc_extra)):
            self._flows.add(found.flow)
            self._count(self._passed.pop(found.flow, 0))
            return found.body
        if found.flow in self._flows:
            self._count(1)
        else:
            self._passed[found.flow] += 1
        return Located()

    def _count(self, datagrams: int) -> None:
        self.tally.undecode("datagrams", datagrams, "not whole MAVLink frames")

    def _of_tcp(self, found: Payload) -> Located:
        """The frames that end in this segment, and what stands ahead of them and is none: that is counted."""
        stream = self._streams[found.flow]
        held = stream.waiting + found.body
        is_known = found.flow in self._flows
        ready = self._ready(held.data, whole_frames(held.data) if is_known else 0)
        old = max(ready, len(held) - LONGEST_FRAME)
        stream.waiting = held.cut(old, len(held))
        if not (is_known or ready):
            return Located()
        self._flows.add(found.flow)
        return held.cut(0, old)

    def _ready(self, content: bytes, end: int) -> int:
        """Where the last frame ends that is chained to a checked one; `end` where none begins behind it."""
        while match := next((m for m in MARKER.finditer(content, end) if self._is_frame(content, m)), None):
            end = match.start() + whole_frames(content[match.start() :])
        return end

    def _is_frame(self, content: bytes, marker: re.Match[bytes]) -> bool:
        return is_checked(content, marker.start(), self.crc_extra)

    def located(self, damage: Damage) -> Damage:
        """The damage to the frames as damage to the file, with that to the capture itself."""
        own = self.tally.freeze()
        pieces = self._in_file(damage.regions)
        regions = sorted((*own.regions, *pieces), key=lambda r: r.start)
        return replace(
            damage,
            bytes_skipped=damage.bytes_skipped + own.bytes_skipped,
            regions=tuple(regions[: Damage.MAX_REGIONS]),
            region_count=damage.region_count - len(damage.regions) + len(pieces) + own.region_count,
            truncated=own.truncated,
            undecoded={**damage.undecoded, **own.undecoded},
            time_outliers={**damage.time_outliers, **own.time_outliers},
            reasons={**damage.reasons, **own.reasons},
        )

    def _in_file(self, regions: Sequence[Region]) -> list[Region]:
        """Regions of the payloads where they lie in the file: in as many pieces as packets carried them."""
        starts, places = (np.concatenate(part) for part in zip(*self._places, strict=True))
        ends = np.append(starts[1:], self._base)
        found = []
        for region in regions:
            first = int(np.searchsorted(starts, region.start, side="right")) - 1
            for k in range(first, int(np.searchsorted(starts, region.end))):
                moved = int(places[k] - starts[k])
                begin = max(region.start, int(starts[k]))
                end = min(region.end, int(ends[k]))
                found.append(Region(begin + moved, end + moved, region.reason))
        return found


def whole_frames(content: bytes) -> int:
    """How many bytes from the first on are whole frames by their lengths."""
    at = 0
    while (head := read_header(content, at)) is not None:
        at = head.end
    return at


def holds_mavlink(head: bytes, crc_extra: npt.NDArray[np.int16]) -> bool:
    """Whether the first packets of a capture hold MAVLink."""
    if not is_capture(head):
        return False
    capture = Capture(crc_extra)
    return next(capture.batches(memoryview(head), 1), None) is not None


def scan_batch(scanner: Scanner, batch: Batch, base: int) -> Frames:
    """The frames of a batch."""
    frames, _ = scanner.scan(as_array(bytes(batch.data)), base, len(batch.data))
    return batch.stamped(frames)
