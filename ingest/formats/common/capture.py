"""What went over a network: UDP datagrams and TCP segments of a capture (pcap, pcapng), over IPv4.

Link types: Ethernet (with VLAN tags), Linux cooked (1 and 2), raw IP, BSD loopback. Fragments of datagrams
are put together: AR.Drone navdata with all options exceed an Ethernet frame. Left out: IPv6, radiotap.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from socket import IPPROTO_TCP, IPPROTO_UDP

from flysid.ingest.formats.common import pcap, pcapng
from flysid.ingest.formats.common.pcap import Packet
from flysid.ingest.formats.common.tally import Tally


class LinkType(IntEnum):
    """What a capture's packets begin with: the link types of pcap."""

    LOOPBACK = 0
    ETHERNET = 1
    RAW_BSD = 12
    RAW_OPENBSD = 14
    RAW = 101
    SLL = 113
    SLL2 = 276


VLAN_TYPES = (0x8100, 0x88A8)
MAX_PENDING = 64


@dataclass(frozen=True)
class Payload:
    """What one datagram or segment carries.

    Attributes
    ----------
    at : where its (first) record begins in the file.
    time_ns : when it was captured.
    flow : protocol, addresses and ports: who sends to whom.
    source_port, target_port : of these.
    content : the bytes.
    sequence : of TCP, the number of the first byte; None of UDP.
    """

    at: int
    time_ns: int
    flow: bytes
    source_port: int
    target_port: int
    content: bytes
    sequence: int | None = None


def is_capture(head: bytes) -> bool:
    """Whether bytes begin as a capture does."""
    return pcap.is_pcap(head) or pcapng.is_pcapng(head)


def datagrams(view: memoryview, tally: Tally) -> Iterator[Payload]:
    """UDP datagrams in file order; damaged records are skipped and counted."""
    return (found for found in payloads(view, tally) if found.sequence is None)


def payloads(view: memoryview, tally: Tally) -> Iterator[Payload]:
    """UDP datagrams and TCP segments in file order; damaged records are skipped and counted."""
    head = bytes(view[: pcap.FILE_HEAD_BYTES])
    read = pcapng.packets if pcapng.is_pcapng(head) else pcap.packets
    pending = _Fragments()
    for packet in read(view, tally):
        found = _payload(packet, bytes(view[packet.start : packet.stop]), pending, tally)
        if found is not None:
            yield found


def _ip_start(frame: bytes, link: int) -> int:
    """Where the IPv4 packet begins in a frame; -1 where there is none."""
    if link in (LinkType.RAW, LinkType.RAW_BSD, LinkType.RAW_OPENBSD):
        return 0
    if link == LinkType.LOOPBACK:
        return 4
    if link == LinkType.SLL:
        return 16 if frame[14:16] == b"\x08\x00" else -1
    if link == LinkType.SLL2:
        return 20 if frame[:2] == b"\x08\x00" else -1
    if link != LinkType.ETHERNET:
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


def _is_sound(head: bytes, size: int) -> bool:
    """Whether an IPv4 header is whole and its checksum holds; 0 where the network card fills it in."""
    if size < 20 or len(head) < size:
        return False
    words = struct.unpack(f">{size // 2}H", head)
    return bool(words[5] == 0 or sum(words) % 0xFFFF == 0)


def _payload(packet: Packet, frame: bytes, pending: _Fragments, tally: Tally) -> Payload | None:
    start = _ip_start(frame, packet.link)
    if start < 0 or len(frame) < start + 20 or frame[start] >> 4 != 4:
        return None
    head = 4 * (frame[start] & 15)
    if not _is_sound(frame[start : start + head], head):
        tally.undecode("packets", 1, "the checksum of the IP header is wrong")
        return None
    protocol = frame[start + 9]
    place = (packet.at, packet.time_ns)
    if protocol not in (IPPROTO_UDP, IPPROTO_TCP):
        return None
    total = int.from_bytes(frame[start + 2 : start + 4], "big") or len(frame) - start  # 0: cut by the card
    flags = int.from_bytes(frame[start + 6 : start + 8], "big")
    body = frame[start + head : start + total]
    hosts = frame[start + 12 : start + 20]
    if flags & 0x3FFF:  # more to come, or not the first
        key = hosts + frame[start + 4 : start + 6]
        whole = pending.add(key, ((flags & 0x1FFF) * 8, body, bool(flags & 0x2000)), place)
        if whole is None:
            return None
        body, place = whole
    if len(body) < (8 if protocol == IPPROTO_UDP else 20):
        return None
    source, target = struct.unpack_from(">2H", body)
    flow = bytes([protocol]) + hosts + body[:4]
    if protocol == IPPROTO_UDP:
        size = int.from_bytes(body[4:6], "big")
        return Payload(*place, flow, source, target, body[8 : max(size, 8)])
    content = body[4 * (body[12] >> 4) :]
    number = int.from_bytes(body[4:8], "big")
    return Payload(*place, flow, source, target, content, number) if content else None
