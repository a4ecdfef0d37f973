"""UDP datagrams of a classic pcap capture, over IPv4, with fragments put together.

File: u32 magic (a1b2c3d4: microseconds, a1b23c4d: nanoseconds, either byte order), u16 major, u16 minor,
i32 zone, u32 accuracy, u32 snap length, u32 link type; then records of u32 seconds, u32 fraction, u32
captured, u32 length, bytes. Link types: Ethernet (with VLAN tags), Linux cooked (1 and 2), raw IP, BSD
loopback. Left out: pcapng, IPv6, radiotap. AR.Drone navdata with all options exceed an Ethernet frame, so
that fragments are the rule.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from flysid.ingest.formats.base import release
from flysid.ingest.formats.common.tally import Tally

FILE_HEAD_BYTES = 24
RECORD_HEAD_BYTES = 16
MAX_CAPTURED = 1 << 18
RELEASE_BYTES = 16 << 20
MAX_STEP_S = 86_400
MAX_PENDING = 64
LOOPBACK, ETHERNET, RAW_BSD, RAW_OPENBSD, RAW, SLL, SLL2 = 0, 1, 12, 14, 101, 113, 276
VLAN_TYPES = (0x8100, 0x88A8)
UDP = 17


@dataclass(frozen=True)
class Datagram:
    """A UDP payload; `at` is where its (first) record begins in the file."""

    at: int
    time_ns: int
    source_port: int
    target_port: int
    payload: bytes


@dataclass(frozen=True)
class _Style:
    order: str
    unit_ns: int
    link: int


def is_pcap(head: bytes) -> bool:
    """Whether bytes begin as a classic capture does."""
    return _style(head) is not None


def _style(head: bytes) -> _Style | None:
    if len(head) < FILE_HEAD_BYTES:
        return None
    for order in "<>":
        (magic,) = struct.unpack_from(order + "I", head)
        if magic in (0xA1B2C3D4, 0xA1B23C4D):
            link = struct.unpack_from(order + "I", head, 20)[0] & 0xFFFF
            return _Style(order, 1000 if magic == 0xA1B2C3D4 else 1, link)
    return None


def datagrams(view: memoryview, tally: Tally) -> Iterator[Datagram]:
    """UDP datagrams in file order; damaged records are skipped and counted."""
    style = _style(bytes(view[:FILE_HEAD_BYTES]))
    if style is None:
        return
    pending = _Fragments()
    at, last_s, released = FILE_HEAD_BYTES, -1, 0
    while at < len(view):
        if at - released > RELEASE_BYTES:
            release(view, released, at)
            released = at
        head = _record(view, at, style, last_s)
        if head is None:
            at = _recover(view, at, (style, last_s), tally)
            continue
        last_s, time_ns, end = head
        found = _udp(bytes(view[at + RECORD_HEAD_BYTES : end]), style.link, pending, (at, time_ns))
        if found is not None:
            yield found
        at = end


def _record(view: memoryview, at: int, style: _Style, last_s: int) -> tuple[int, int, int] | None:
    """Seconds, time in ns and end of the record at `at`; None where it cannot be one."""
    if at + RECORD_HEAD_BYTES > len(view):
        return None
    seconds, fraction, captured, length = struct.unpack_from(style.order + "4I", view, at)
    end = at + RECORD_HEAD_BYTES + captured
    sane = captured <= min(length, MAX_CAPTURED) and fraction * style.unit_ns < 10**9 and end <= len(view)
    if not sane or (last_s >= 0 and abs(seconds - last_s) > MAX_STEP_S):
        return None
    return seconds, seconds * 10**9 + fraction * style.unit_ns, end


def _recover(view: memoryview, at: int, known: tuple[_Style, int], tally: Tally) -> int:
    """After damage: the next record that another one, or the end, follows."""
    style, last_s = known
    for place in range(at + 1, len(view) - RECORD_HEAD_BYTES + 1):
        head = _record(view, place, style, last_s)
        if head is None or head[2] - place < RECORD_HEAD_BYTES + 20:
            continue
        if head[2] == len(view) or _record(view, head[2], style, head[0]) is not None:
            tally.skip(at, place, "no record here")
            return place
    tally.truncated = True
    tally.skip(at, len(view), "cut off inside a record")
    return len(view)


def _ip_start(frame: bytes, link: int) -> int:
    """Where the IPv4 packet begins in a frame; -1 where there is none."""
    if link in (RAW, RAW_BSD, RAW_OPENBSD):
        return 0
    if link == LOOPBACK:
        return 4
    if link == SLL:
        return 16 if frame[14:16] == b"\x08\x00" else -1
    if link == SLL2:
        return 20 if frame[:2] == b"\x08\x00" else -1
    if link != ETHERNET:
        return -1
    at = 12
    while at + 2 <= len(frame) and int.from_bytes(frame[at : at + 2], "big") in VLAN_TYPES:
        at += 4
    return at + 2 if frame[at : at + 2] == b"\x08\x00" else -1


@dataclass
class _Fragments:
    """Fragments of datagrams by (source, target, id): offset -> bytes, total size once known, first place."""

    parts: dict[bytes, dict[int, bytes]] = field(default_factory=dict)
    totals: dict[bytes, int] = field(default_factory=dict)
    places: dict[bytes, tuple[int, int]] = field(default_factory=dict)

    def add(
        self, key: bytes, piece: tuple[int, bytes, bool], place: tuple[int, int]
    ) -> tuple[bytes, tuple[int, int]] | None:
        """The whole datagram and its first place, once its last missing piece has come."""
        offset, data, more = piece
        if key not in self.parts and len(self.parts) >= MAX_PENDING:
            self._forget(next(iter(self.parts)))
        self.places.setdefault(key, place)
        held = self.parts.setdefault(key, {})
        held[offset] = data
        if not more:
            self.totals[key] = offset + len(data)
        if self.totals.get(key) != sum(map(len, held.values())):
            return None
        whole = b"".join(held[o] for o in sorted(held))
        first = self.places[key]
        self._forget(key)
        return whole, first

    def _forget(self, key: bytes) -> None:
        for store in (self.parts, self.totals, self.places):
            store.pop(key, None)


def _udp(frame: bytes, link: int, pending: _Fragments, place: tuple[int, int]) -> Datagram | None:
    start = _ip_start(frame, link)
    if start < 0 or len(frame) < start + 20 or frame[start] >> 4 != 4 or frame[start + 9] != UDP:
        return None
    head = 4 * (frame[start] & 15)
    total = int.from_bytes(frame[start + 2 : start + 4], "big")
    flags = int.from_bytes(frame[start + 6 : start + 8], "big")
    body = frame[start + head : start + total]
    if flags & 0x3FFF:  # more to come, or not the first
        key = frame[start + 12 : start + 20] + frame[start + 4 : start + 6]
        whole = pending.add(key, ((flags & 0x1FFF) * 8, body, bool(flags & 0x2000)), place)
        if whole is None:
            return None
        body, place = whole
    if len(body) < 8:
        return None
    source, target, size = struct.unpack_from(">3H", body)
    return Datagram(place[0], place[1], source, target, body[8 : max(size, 8)])
