"""MAVLink that went over a network: UDP datagrams and TCP streams of a capture (pcap, pcapng).

What other programs sent is passed over: a flow (from one address and port to another) carries MAVLink once a
whole payload is frames from end to end and the first one's checksum holds. A frame's arrival is that of the
packet in which it ends. What was captured twice, or sent again, is read once and counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from flysid.flight import Damage, Region
from flysid.ingest.formats.common.capture import Payload, is_capture, payloads
from flysid.ingest.formats.common.clock import IntArray
from flysid.ingest.formats.common.columns import as_array
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.mavlink.frames import Frames, Scanner, is_checked, read_header

LONGEST_FRAME = 280 + 13
SEQUENCES = 1 << 32
MAX_EARLY = 64  # segments that wait for one ahead of them
MAX_STREAMS = 1024  # of those that spoke last


@dataclass
class _Stream:
    """One direction of a TCP connection.

    Attributes
    ----------
    expected : the next byte's number.
    waiting : the beginning of a frame.
    early : segments that came ahead of others, by number.
    """

    expected: int
    waiting: bytes = b""
    early: dict[int, Payload] = field(default_factory=dict)

    def knows(self, found: Payload) -> bool:
        """Whether all of a segment was there before."""
        ends = ((found.sequence or 0) + len(found.content) - self.expected) % SEQUENCES
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
        self.waiting = b""
        self.expected = min(ahead, key=lambda number: ahead[number])
        return self._taken(self.expected)

    def _taken(self, number: int) -> Payload:
        found = self.early.pop(number)
        known = (self.expected - number) % SEQUENCES
        content = found.content[known:]
        self.expected = (self.expected + len(content)) % SEQUENCES
        return replace(found, content=content)


@dataclass
class Batch:
    """Payloads one after the other: their bytes, where each begins, its place in the file and its time."""

    data: bytearray = field(default_factory=bytearray)
    starts: list[int] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    times_us: list[int] = field(default_factory=list)

    def add(self, payload: bytes, found: Payload) -> None:
        """Take in a payload, or a part of one."""
        self.starts.append(len(self.data))
        self.places.append(found.at)
        self.times_us.append(found.time_ns // 1000)
        self.data += payload

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
    _places: list[tuple[IntArray, IntArray]] = field(default_factory=list)
    _base: int = 0

    def batches(self, view: memoryview, size: int) -> Iterator[tuple[Batch, int]]:
        """Batches of at least `size` bytes, and how many bytes came before each."""
        batch = Batch()
        for found in self._in_order(view):
            content = self._of_tcp(found) if found.sequence is not None else self._of_udp(found)
            if content:
                batch.add(content, found)
            if len(batch.data) >= size:
                yield self._closed(batch)
                batch = Batch()
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
            self.tally.repeats += stream.knows(found)
            yield from stream.in_order(found)
            if len(self._streams) > MAX_STREAMS:
                flow, silent = next(iter(self._streams.items()))
                yield from silent.rest()
                del self._streams[flow]
        for stream in self._streams.values():
            yield from stream.rest()

    def _closed(self, batch: Batch) -> tuple[Batch, int]:
        base = self._base
        self._base = self._base + len(batch.data)
        self._places.append((np.array(batch.starts) + base, np.array(batch.places)))
        return batch, base

    def _of_udp(self, found: Payload) -> bytes:
        """The datagram where it is MAVLink; b"" where it is something else."""
        is_whole = whole_frames(found.content) == len(found.content)
        if is_whole and (found.flow in self._flows or is_checked(found.content, 0, self.crc_extra)):
            self._flows.add(found.flow)
            self._count(self._passed.pop(found.flow, 0))
            return found.content
        if found.flow in self._flows:
            self._count(1)
        else:
            self._passed[found.flow] += 1
        return b""

    def _count(self, datagrams: int) -> None:
        self.tally.undecode("datagrams", datagrams, "not whole MAVLink frames")

    def _of_tcp(self, found: Payload) -> bytes:
        """The frames that end in this segment."""
        stream = self._streams[found.flow]
        held = stream.waiting + found.content
        start = 0 if found.flow in self._flows else self._first_frame(held)
        if start < 0:
            stream.waiting = held[-LONGEST_FRAME:]
            return b""
        self._flows.add(found.flow)
        end = start + whole_frames(held[start:])
        if len(held) - end > LONGEST_FRAME:  # what stands there is no frame: the reader counts it
            end = len(held) - LONGEST_FRAME
        stream.waiting = held[end:]
        return held[start:end]

    def _first_frame(self, content: bytes) -> int:
        """Where the first checked frame begins; -1 where there is none."""
        return next((at for at in range(len(content)) if is_checked(content, at, self.crc_extra)), -1)

    def located(self, damage: Damage) -> Damage:
        """The damage to the frames as damage to the file, with that to the capture itself."""
        own = self.tally.freeze()
        regions = sorted((*own.regions, *map(self._in_file, damage.regions)), key=lambda r: r.start)
        return replace(
            damage,
            bytes_skipped=damage.bytes_skipped + own.bytes_skipped,
            regions=tuple(regions[: Damage.MAX_REGIONS]),
            region_count=damage.region_count + own.region_count,
            truncated=own.truncated,
            undecoded={**damage.undecoded, **own.undecoded},
            time_outliers={**damage.time_outliers, **own.time_outliers},
            reasons={**damage.reasons, **own.reasons},
        )

    def _in_file(self, region: Region) -> Region:
        """A region of the payloads as one of the file: it begins in the record of its payload."""
        starts, places = next(p for p in reversed(self._places) if p[0][0] <= region.start)
        place = int(places[int(np.searchsorted(starts, region.start, side="right")) - 1])
        return Region(place, place + region.size, region.reason)


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
