"""IP packets, version 4 and 6: whose they are, what they carry, and datagrams put together from fragments.

Sources: RFC 791 (IPv4), RFC 8200 (IPv6).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import islice

from flysid.ingest.formats.common.located import Located

MAX_PENDING = 64
MAX_BYTES = 65_535  # of a datagram
WAIT_NS = 60 * 10**9  # for a missing fragment (RFC 8200, section 4.5)
V4_BYTES = 20
V6_BYTES = 40


class NextHeader(IntEnum):
    """What follows an IPv6 header or an extension of it, where that is another extension."""

    HOP_BY_HOP = 0
    ROUTING = 43
    FRAGMENT = 44
    DESTINATION = 60


EXTENSIONS = frozenset(NextHeader)


@dataclass(frozen=True)
class IpPacket:
    """One packet, or one fragment of it.

    Attributes
    ----------
    protocol : of the body.
    hosts : both addresses.
    body : what is carried, or a part of it.
    offset, more : of a fragment, where its body belongs, and whether others follow.
    number : of the datagram that a fragment is of; b"" where the packet is whole.
    identity : what its sender numbers packets with, whole ones too; b"" where it does not.
    """

    protocol: int
    hosts: bytes
    body: Located
    offset: int = 0
    more: bool = False
    number: bytes = b""
    identity: bytes = b""


class HeaderError(ValueError):
    """A header that is cut, whose checksum or length is wrong, or fragments that overlap."""


def ip_packet(frame: Located, start: int, only: int = 0) -> IpPacket | None:
    """The IP packet that begins at `start`; None where there is none. Raises HeaderError.

    `only` : the version that it must be of; 0 where both may be.
    """
    version = frame.data[start] >> 4 if len(frame) > start else 0
    if only and version != only:
        raise HeaderError(f"no IP packet of version {only}")
    if len(frame) < start + {4: V4_BYTES, 6: V6_BYTES}.get(version, 0):
        raise HeaderError("a packet that ends in its header")
    if version == 4:
        return _version_4(frame, start)
    return _version_6(frame, start) if version == 6 else None


def _version_4(frame: Located, start: int) -> IpPacket:
    size = 4 * (frame.data[start] & 15)
    head = frame.data[start : start + size]
    if not _is_sound(head, size):
        raise HeaderError("the checksum of the IP header is wrong")
    total = int.from_bytes(head[2:4], "big") or len(frame) - start  # 0: cut by the card
    if total < size:
        raise HeaderError("the length of the IP packet is less than its header")
    flags = int.from_bytes(head[6:8], "big")
    is_part = flags & 0x3FFF  # more to come, or not the first
    number = head[4:6]
    return IpPacket(
        head[9],
        head[12:20],
        frame.cut(start + size, start + total),
        (flags & 0x1FFF) * 8,
        bool(flags & 0x2000),
        number if is_part else b"",
        number if any(number) else b"",
    )


def _is_sound(head: bytes, size: int) -> bool:
    """Whether an IPv4 header is whole and its checksum holds; 0 where the network card fills it in."""
    if size < V4_BYTES or len(head) < size:
        return False
    words = struct.unpack(f">{size // 2}H", head)
    return bool(words[5] == 0 or sum(words) % 0xFFFF == 0)


def _version_6(frame: Located, start: int) -> IpPacket:
    """An IPv6 packet behind its extension headers; it has no checksum of its own."""
    data = frame.data
    length = int.from_bytes(data[start + 4 : start + 6], "big")
    end = start + V6_BYTES + length if length else len(data)  # 0: cut by the card
    kind = data[start + 6]
    at = start + V6_BYTES
    offset = 0
    more = False
    number = b""
    while kind in EXTENSIONS and at + 8 <= min(end, len(data)):
        following = data[at]
        if kind == NextHeader.FRAGMENT:
            place = int.from_bytes(data[at + 2 : at + 4], "big")
            offset = place & 0xFFF8
            more = bool(place & 1)
            number = data[at + 4 : at + 8] if offset or more else b""
            at += 8
        else:
            at += 8 * (1 + data[at + 1])
        kind = following
        if offset:
            break  # what follows lies in the first fragment
    return IpPacket(kind, data[start + 8 : start + V6_BYTES], frame.cut(at, end), offset, more, number)


@dataclass
class _Pending:
    """A datagram of which fragments are missing: their bytes by offset, and its whole size once known."""

    first: IpPacket
    time_ns: int
    parts: dict[int, Located] = field(default_factory=dict)
    total: int = -1
    size: int = 0

    def take(self, packet: IpPacket) -> None:
        """Another fragment; of two with one offset the last."""
        self.size += len(packet.body) - len(self.parts.get(packet.offset, Located()))
        self.parts[packet.offset] = packet.body
        if not packet.more:
            self.total = packet.offset + len(packet.body)


@dataclass
class Fragments:
    """Puts datagrams together, a bounded number at a time."""

    _pending: dict[bytes, _Pending] = field(default_factory=dict)
    _left: list[_Pending] = field(default_factory=list)

    def add(self, packet: IpPacket, time_ns: int) -> tuple[IpPacket, int] | None:
        """The whole datagram and the time of its first piece, once its last missing one has come.

        Raises HeaderError where fragments overlap: which of them is right cannot be known.
        """
        key = bytes([packet.protocol]) + packet.hosts + packet.number
        held = self._pending.get(key)
        if held is not None and time_ns - held.time_ns > WAIT_NS:
            self._left.append(self._pending.pop(key))  # numbers are used again
            held = None
        if held is None:
            held = self._pending[key] = _Pending(packet, time_ns)
        held.take(packet)
        if held.size > MAX_BYTES:
            del self._pending[key]
            raise HeaderError("its fragments overlap")
        if held.size != held.total:
            return None
        del self._pending[key]
        body = _beginning(held.parts)
        if len(body) != held.total:
            raise HeaderError("its fragments overlap")
        return IpPacket(packet.protocol, packet.hosts, body, identity=packet.number), held.time_ns

    def given_up(self, most: int = MAX_PENDING) -> list[tuple[IpPacket, int]]:
        """The beginnings of datagrams that cannot be completed: all but the `most` that came last.

        Without its first fragment nothing tells whose a datagram was.
        """
        old = list(islice(self._pending, max(len(self._pending) - most, 0)))
        given = [*self._left, *map(self._pending.pop, old)]
        self._left = []
        return [
            (IpPacket(held.first.protocol, held.first.hosts, _beginning(held.parts)), held.time_ns)
            for held in given
            if 0 in held.parts
        ]


def _beginning(parts: dict[int, Located]) -> Located:
    """The bytes from the first on that are known without a gap."""
    body = Located()
    while len(body) in parts and len(parts[len(body)]):
        body += parts[len(body)]
    return body
