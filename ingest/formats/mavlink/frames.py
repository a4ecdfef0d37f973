"""Finding MAVLink frames in bytes: every valid frame, and exactly which bytes are none.

    tlog record   u64 big-endian microseconds (UTC, arrival at the ground), then a frame
    v1 frame      FE len seq sys comp id payload[len] crc16
    v2 frame      FD len incompat compat seq sys comp id[3] payload[len] crc16 [signature 13 if incompat & 1]

The CRC (MCRF4XX) covers all between the marker and itself, then one seed byte of the message's layout.
Clean stretches are walked by a `chain` function (plain, or compiled for large files); whatever stops it is
judged here, in one place for both. Timestamps are outside the CRC and are not judged here.

An unknown id cannot be checked: such a frame is accepted only where a checked one follows exactly.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from flysid.flight import Damage, Region
from flysid.ingest.formats.mavlink.checksums import (
    Buffer,
    ByteArray,
    Header,
    IntArray,
    crc_holds,
    is_valid,
    seed_of,
)
from flysid.ingest.formats.mavlink.dialect import UNKNOWN

MARKER = re.compile(rb"[\xfd\xfe]")
V1 = 0xFE
V2 = 0xFD
SIGNED = 0x01
SIGNATURE_BYTES = 13
LOOK_AHEAD = 8192
MAX_UNKNOWN_IN_A_ROW = 16
STAMP_BYTES = 8
FIRST_STRETCH = 1 << 12
LONGEST_STRETCH = 1 << 20
HEADER_BLOCK = 1 << 14
FIRST_SEARCH = 1 << 8
ROWS = ("start", "message", "payload", "length", "system", "component", "sequence")  # of `Frames`

Chain = Callable[[ByteArray, int, int, int], tuple[IntArray, int]]


class MessageId(IntEnum):
    """Messages that are known by their number, before their dialect is."""

    HEARTBEAT = 0
    SYSTEM_TIME = 2
    RADIO_STATUS = 109
    AUTOPILOT_VERSION = 148


@dataclass(frozen=True, eq=False)
class Frames:
    """Valid frames of one batch in file order; offsets count within `buffer`.

    Attributes
    ----------
    buffer : the batch's bytes.
    start : (n,) offset of the marker.
    message : (n,) message id.
    payload, length : (n,) offset and size of the payload.
    system, component, sequence : (n,) uint8, from the header.
    stamp_us : (n,) arrival, microseconds UTC; None where the log has none; -1 where damage took
        it; 0 where it is absurd.
    """

    buffer: ByteArray
    start: IntArray
    message: IntArray
    payload: IntArray
    length: IntArray
    system: ByteArray
    component: ByteArray
    sequence: ByteArray
    stamp_us: IntArray | None

    def __len__(self) -> int:
        return len(self.start)

    def senders(self) -> IntArray:
        """(n,) system * 256 + component."""
        return (self.system.astype(np.int64) << 8) | self.component

    def checksums(self) -> IntArray:
        """(n,) of header and content, as the frames state them."""
        at = self.payload + self.length
        sums: IntArray = self.buffer[at].astype(np.int64) | self.buffer[at + 1].astype(np.int64) << 8
        return sums

    def where(self, kept: npt.NDArray[np.bool_]) -> Frames:
        """Some of the frames."""
        stamps = None if self.stamp_us is None else self.stamp_us[kept]
        return replace(self, **{name: getattr(self, name)[kept] for name in ROWS}, stamp_us=stamps)


def plain_chain(crc_extra: npt.NDArray[np.int16]) -> Chain:
    """A chain function without compilation: about 0.4 us a frame.

    chain(raw, position, limit, stamp) walks valid records from `position`. It returns the
    frames' offsets and where it stopped: at the first record that starts at or after `limit`, or is not a
    complete valid frame of a known id.
    """

    def chain(raw: ByteArray, position: int, limit: int, stamp: int) -> tuple[IntArray, int]:
        found: list[IntArray] = []
        size = FIRST_STRETCH  # after damage the chain is often entered only to stop again
        while position < limit and position + stamp < len(raw) and raw[position + stamp] in (V1, V2):
            starts, ends = _link(raw, position, min(position + size, limit), stamp)
            good = _check(raw, starts, crc_extra)
            found.append(starts[:good])
            if not good:
                break
            position = int(ends[good - 1])
            if good < len(starts):
                break
            size = min(4 * size, LONGEST_STRETCH)
        return np.concatenate(found) if found else np.empty(0, np.int64), position

    return chain


def _link(raw: ByteArray, position: int, limit: int, stamp: int) -> tuple[IntArray, IntArray]:
    """Frames that follow each other by their lengths alone from `position` on, where they start and end."""
    first = position + stamp
    size = len(raw)
    window = raw[first : limit + stamp]
    at = np.flatnonzero(window + 3 < 2) + first  # the markers FD and FE, in 8 bits
    at = at[at + 8 <= size]
    is_v2 = raw[at] == V2
    flags = raw[at + 2]
    ends = at + raw[at + 1] + np.where(is_v2, 12 + SIGNATURE_BYTES * (flags & SIGNED).astype(np.int64), 8)
    whole = (ends <= size) & ~(is_v2 & (flags > SIGNED))
    at = at[whole]
    ends = ends[whole]
    place = np.full(len(window) + 1, -1, dtype=np.int32)
    place[at - first] = np.arange(len(at))
    following = place[np.minimum(ends + stamp - first, len(window))].tolist()
    index = int(place[0]) if len(window) else -1
    chain: list[int] = []
    while index >= 0:
        chain.append(index)
        index = following[index]
    return at[chain], ends[chain]


def _check(raw: ByteArray, starts: IntArray, crc_extra: npt.NDArray[np.int16]) -> int:
    """How many of these frames, from the first on, are of known ids and have the right CRC."""
    if not len(starts):
        return 0
    is_v2 = raw[starts] == V2
    at = starts + np.where(is_v2, 7, 5)
    number = raw[at].astype(np.int64)
    wide = np.flatnonzero(is_v2)
    number[wide] |= (raw[at[wide] + 1].astype(np.int64) << 8) | (raw[at[wide] + 2].astype(np.int64) << 16)
    seed = crc_extra[np.minimum(number, len(crc_extra) - 1)]
    unknown = (number >= len(crc_extra)) | (seed == UNKNOWN)
    count = int(unknown.argmax()) if unknown.any() else len(starts)
    starts = starts[:count]
    seed = seed[:count]
    is_v2 = is_v2[:count]
    crc_at = starts + raw[starts + 1] + np.where(is_v2, 10, 6)
    right = crc_holds(raw, starts, crc_at, seed)
    return count if right.all() else int(right.argmin())


@dataclass
class _Batch:
    """One batch while it is scanned: its bytes, its offset in the file, and the frames found so far."""

    buffer: Buffer
    base: int
    limit: int
    found: list[IntArray] = field(default_factory=list)
    bare: list[int] = field(default_factory=list)
    _judged: list[tuple[int, int, bool]] = field(default_factory=list)
    _span: tuple[int, int] = (0, 0)

    def known_frames(
        self, begin: int, end: int, crc_extra: npt.NDArray[np.int16]
    ) -> Iterator[tuple[int, int, bool]]:
        """Whole frames of known ids from `begin` to `end`, see `_judged`; they may overlap.

        They are judged a stretch at a time, and kept: what was lost is mostly short, and garbage may be dense
        with frames. So stretches grow while they follow each other.
        """
        while begin < end:
            start, stop = self._span
            if not start <= begin < stop:
                reach = min(4 * (stop - start), HEADER_BLOCK) if start <= begin <= stop + FIRST_SEARCH else 0
                self._span = (begin, min(begin + max(reach, FIRST_SEARCH), end))
                self._judged = _judged(np.frombuffer(self.buffer, np.uint8), *self._span, crc_extra)
            yield from self._judged[bisect_left(self._judged, (begin,)) :]
            begin = self._span[1]


@dataclass
class Scanner:
    """Finds frames batch by batch and keeps account of every byte that belongs to none.

    Parameters
    ----------
    crc_extra : seeds by message id (`Dialect.crc_extra`).
    stamp : bytes before each frame: 8 in a tlog, 0 in raw MAVLink.
    chain : walks clean stretches; `plain_chain(crc_extra)` or the compiled one.

    Attributes
    ----------
    foreign : frames that another dialect may know: of unknown ids, or right but for the seed.
    private : messages that this log's own dialect defines under numbers of this one, and their seeds.
    """

    crc_extra: npt.NDArray[np.int16]
    stamp: int
    chain: Chain
    bytes_skipped: int = 0
    region_count: int = 0
    regions: list[Region] = field(default_factory=list)
    bad_checksums: int = 0
    truncated: bool = False
    unstamped: int = 0
    unknown: dict[tuple[int, int, int], int] = field(default_factory=dict)
    foreign: int = 0
    private: Mapping[int, int] = field(default_factory=dict)
    _lost_at: int | None = None
    _reason: str = ""
    _expected: int = -1
    _seen: set[int] = field(default_factory=set)

    def scan(self, raw: ByteArray, base: int, limit: int) -> tuple[Frames, int]:
        """Frames of the records that start in raw[:limit], and where in the file the next batch begins.

        Parameters
        ----------
        raw : the batch's bytes: `LOOK_AHEAD` beyond `limit`, or up to it at the file's end.
        base : offset of the batch in the file.
        """
        batch = _Batch(raw.data, base, limit)
        position = 0 if self._lost_at is None else self._search(batch, self.stamp)
        while position < limit and self._lost_at is None:
            starts, position = self.chain(raw, position, limit, self.stamp)
            if len(starts):
                batch.found.append(starts)
                self._seen.add(_sender(batch.buffer, int(starts[-1])))
            if position < limit:
                position = self._recover(batch, position)
        starts = np.concatenate(batch.found) if batch.found else np.empty(0, np.int64)
        self.unstamped += len(batch.bare)
        return read_headers(raw, starts, self.stamp, batch.bare), base + position

    def _recover(self, batch: _Batch, position: int) -> int:
        """What stopped the chain at `position`? Returns where to go on."""
        buffer = batch.buffer
        q = position + self.stamp
        head = read_header(buffer, q)
        self._reason = "no MAVLink frame"
        self._expected = -1
        if head is not None and self._is_known(head.message):
            self.bad_checksums += 1
            self.foreign += seed_of(buffer, q, head) >= 0
            self._reason = "bad checksum"
            self._expected = batch.base + head.end
        elif head is not None and (self._is_private(buffer, q, head) or self._is_confirmed(buffer, head.end)):
            key = (*divmod(_sender(buffer, q), 256), head.message)
            self.unknown[key] = self.unknown.get(key, 0) + 1
            self.foreign += 1
            return head.end
        self._lost_at = batch.base + position
        return self._search(batch, position)

    def _search(self, batch: _Batch, begin: int) -> int:
        """Go on at the next valid frame whose marker is at or after `begin`, or at the end of the batch.

        A frame that follows a damaged one exactly and fails its CRC too is counted; other failures are
        chance markers inside garbage.
        """
        assert self._lost_at is not None
        buffer = batch.buffer
        base = batch.base
        limit = batch.limit
        lost = self._lost_at - base
        last = min(limit + self.stamp, len(buffer))
        for q, end, holds in batch.known_frames(begin, last, self.crc_extra):
            if q == lost + self.stamp:
                continue
            if holds:
                if self._is_plausible(buffer, q, end):
                    start = q - self.stamp if q - self.stamp >= lost else q
                    self._close(base + start, self._reason)
                    batch.found.append(np.array([q], dtype=np.int64))
                    batch.bare.extend([q] if start == q and self.stamp else [])
                    return end
            elif base + q == self._expected + self.stamp:
                self.bad_checksums += 1
                self._expected = base + end
        if limit < len(buffer):
            return limit - self.stamp
        self.truncated = _is_cut(buffer, lost + self.stamp)
        self._close(base + len(buffer), "cut off inside a record" if self.truncated else self._reason)
        return len(buffer)

    def _close(self, end: int, reason: str) -> None:
        """The lost region ends at file offset `end`."""
        start = self._lost_at
        self._lost_at = None
        if start is None or start == end:
            return
        self.bytes_skipped += end - start
        self.region_count += 1
        if len(self.regions) < Damage.MAX_REGIONS:
            self.regions.append(Region(start, end, reason))

    def _is_known(self, message: int) -> bool:
        return message < len(self.crc_extra) and self.crc_extra[message] != UNKNOWN

    def _is_valid(self, buffer: Buffer, q: int, head: Header) -> bool:
        return is_valid(buffer, q, head, int(self.crc_extra[head.message]))

    def _is_private(self, buffer: Buffer, q: int, head: Header) -> bool:
        return head.message in self.private and is_valid(buffer, q, head, self.private[head.message])

    def _is_confirmed(self, buffer: Buffer, position: int) -> bool:
        """Does a checked frame follow exactly, perhaps after more unknown ones?"""
        for _ in range(MAX_UNKNOWN_IN_A_ROW):
            q = position + self.stamp
            head = read_header(buffer, q)
            if head is None:
                return False
            if self._is_known(head.message):
                return self._is_valid(buffer, q, head)
            position = head.end
        return False

    def _is_plausible(self, buffer: Buffer, q: int, end: int) -> bool:
        """A CRC of 16 bits holds by chance once in 65,536: ask for a known sender, or a neighbour."""
        after = end + self.stamp
        return (
            end == len(buffer)
            or (after < len(buffer) and buffer[after] in (V1, V2))
            or _sender(buffer, q) in self._seen
        )


def _judged(
    raw: ByteArray, start: int, stop: int, crc_extra: npt.NDArray[np.int16]
) -> list[tuple[int, int, bool]]:
    """Whole frames of known ids whose markers lie in [start, stop): start, end, and whether the CRC holds."""
    at = np.flatnonzero(raw[start:stop] + 3 < 2) + start  # the markers FD and FE, in 8 bits
    size = len(raw)
    at = at[at + 8 <= size]
    is_v2 = raw[at] == V2
    at = at[~is_v2 | ((at + 12 <= size) & (raw[np.minimum(at + 2, size - 1)] <= SIGNED))]
    is_v2 = raw[at] == V2
    wide = np.flatnonzero(is_v2)
    number = raw[at + np.where(is_v2, 7, 5)].astype(np.int64)
    number[wide] |= (raw[at[wide] + 8].astype(np.int64) << 8) | (raw[at[wide] + 9].astype(np.int64) << 16)
    crc_at = at + raw[at + 1] + np.where(is_v2, 10, 6)
    ends = crc_at + 2 + np.where(is_v2, SIGNATURE_BYTES * raw[at + 2].astype(np.int64), 0)
    seed = np.where(number < len(crc_extra), crc_extra[np.minimum(number, len(crc_extra) - 1)], UNKNOWN)
    whole = (ends <= size) & (seed != UNKNOWN) & ~_are_of_one_byte(raw, at, ends)
    at = at[whole]
    ends = ends[whole]
    holds = crc_holds(raw, at, crc_at[whole], seed[whole])
    return list(zip(at.tolist(), ends.tolist(), holds.tolist(), strict=True))


def _are_of_one_byte(raw: ByteArray, starts: IntArray, ends: IntArray) -> npt.NDArray[np.bool_]:
    """Which spans hold one byte over and over: no frames, and a megabyte of FE is a million of them."""
    if not len(starts):
        return np.zeros(0, dtype=np.bool_)
    some = raw[starts[0] : ends.max()]
    changes = np.append(np.flatnonzero(some[1:] != some[:-1]) + starts[0] + 1, len(raw))
    found: npt.NDArray[np.bool_] = changes[np.searchsorted(changes, starts, side="right")] >= ends
    return found


def read_header(buffer: Buffer, q: int) -> Header | None:
    """The header at q; None where the buffer holds no complete frame there."""
    size = len(buffer)
    if q + 8 > size:
        return None
    if buffer[q] == V1:
        crc_at = q + 6 + buffer[q + 1]
        head = Header(crc_at, crc_at + 2, buffer[q + 5])
    elif buffer[q] == V2 and buffer[q + 2] <= SIGNED and q + 12 <= size:
        crc_at = q + 10 + buffer[q + 1]
        end = crc_at + 2 + SIGNATURE_BYTES * buffer[q + 2]
        head = Header(crc_at, end, int.from_bytes(buffer[q + 7 : q + 10], "little"))
    else:
        return None
    return head if head.end <= size else None


def is_checked(buffer: Buffer, q: int, crc_extra: npt.NDArray[np.int16]) -> bool:
    """Whether a whole frame of a known message stands at q, and its CRC holds."""
    if q + 8 > len(buffer) or buffer[q] not in (V1, V2):
        return False
    head = read_header(buffer, q)
    if head is None or head.message >= len(crc_extra) or crc_extra[head.message] == UNKNOWN:
        return False
    return is_valid(buffer, q, head, int(crc_extra[head.message]))


def _is_cut(buffer: Buffer, q: int) -> bool:
    """Does the buffer end inside a record whose marker is (or would be) at q?"""
    size = len(buffer)
    if q < 0:
        return False  # lost since an earlier buffer: longer than any record
    if q >= size:
        return True
    if buffer[q] not in (V1, V2) or (buffer[q] == V2 and q + 2 < size and buffer[q + 2] > SIGNED):
        return False
    return read_header(buffer, q) is None


def _sender(buffer: Buffer, q: int) -> int:
    """system * 256 + component."""
    at = q + (5 if buffer[q] == V2 else 3)
    return buffer[at] * 256 + buffer[at + 1]


def read_headers(raw: ByteArray, starts: IntArray, stamp: int, bare: list[int]) -> Frames:
    """The header fields of frames that begin at `starts`; those in `bare` have no timestamp.

    Done in blocks that stay in the processor's cache: each field is another pass over the same bytes.
    """
    count = len(starts)
    message, payload, length = (np.empty(count, dtype=np.int64) for _ in range(3))
    system, component, sequence = (np.empty(count, dtype=np.uint8) for _ in range(3))
    stamps = np.empty(count, dtype=np.int64) if stamp else None
    for first in range(0, count, HEADER_BLOCK):
        block = slice(first, first + HEADER_BLOCK)
        q = starts[block]
        is_v2 = raw[q] == V2
        at = q + np.where(is_v2, 4, 2)
        wide = np.flatnonzero(is_v2)
        number = raw[at + 3].astype(np.int64)
        number[wide] |= (raw[at[wide] + 4].astype(np.int64) << 8) | (raw[at[wide] + 5].astype(np.int64) << 16)
        message[block], payload[block], length[block] = number, q + np.where(is_v2, 10, 6), raw[q + 1]
        sequence[block], system[block], component[block] = raw[at], raw[at + 1], raw[at + 2]
        if stamps is not None:
            stamps[block] = gather_stamps(raw, q)
    if stamps is not None and bare:
        stamps[np.isin(starts, bare)] = -1
    return Frames(raw, starts, message, payload, length, system, component, sequence, stamps)


def gather_stamps(raw: ByteArray, starts: IntArray) -> IntArray:
    """The microseconds in the 8 bytes before each frame; 0 where they exceed 2^63 ns (year 2262)."""
    before = np.lib.stride_tricks.sliding_window_view(raw, STAMP_BYTES)[np.maximum(starts - STAMP_BYTES, 0)]
    micros = before.view(">u8").reshape(-1)
    return np.where(micros < (1 << 63) // 1000, micros, np.uint64(0)).astype(np.int64)
