"""What went over a network: UDP datagrams and TCP segments of a capture (pcap, pcapng), over IPv4 and IPv6.

Link types: Ethernet (with VLAN tags), Linux cooked (1 and 2), raw IP, BSD loopback. Fragments of datagrams
are put together: AR.Drone navdata with all options exceed an Ethernet frame. Left out: Wi-Fi, tunnels.

A capture on several interfaces sees what passes through its host twice: in on one, out on another. A datagram
that says the same within REPEAT_NS is such a second sight, unless one flow numbers it as another packet.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from socket import IPPROTO_TCP, IPPROTO_UDP

from flysid.ingest.formats.common import pcap, pcapng
from flysid.ingest.formats.common.internet import Fragments, HeaderError, IpPacket, ip_packet
from flysid.ingest.formats.common.pcap import Packet
from flysid.ingest.formats.common.tally import Tally


class LinkType(IntEnum):
    """What a capture's packets begin with: the link types of pcap."""

    LOOPBACK = 0
    ETHERNET = 1
    RAW_BSD = 12
    RAW_OPENBSD = 14
    RAW = 101
    LOOPBACK_OPENBSD = 108
    SLL = 113
    RAW_IPV4 = 228
    RAW_IPV6 = 229
    SLL2 = 276


UDP_BYTES = 8  # of a header
TCP_BYTES = 20
REPEAT_NS = 10 * 10**6  # MAVLink's 256 numbers come round within 10 ms only at 25,600 frames a second
MOST_SEEN = 4096
VLAN_TYPES = (0x8100, 0x88A8)
IP_TYPES = (b"\x08\x00", b"\x86\xdd")  # IPv4, IPv6
IP_STARTS = {
    LinkType.LOOPBACK: 4,
    LinkType.LOOPBACK_OPENBSD: 4,
    LinkType.RAW: 0,
    LinkType.RAW_BSD: 0,
    LinkType.RAW_OPENBSD: 0,
    LinkType.RAW_IPV4: 0,
    LinkType.RAW_IPV6: 0,
}
ONLY_VERSION: Mapping[int, int] = {LinkType.RAW_IPV4: 4, LinkType.RAW_IPV6: 6}


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
    identity : of the IP packet, by its sender; b"" where it has none.
    """

    at: int
    time_ns: int
    flow: bytes
    source_port: int
    target_port: int
    content: bytes
    sequence: int | None = None
    identity: bytes = b""


def is_capture(head: bytes) -> bool:
    """Whether bytes begin as a capture does."""
    return pcap.is_pcap(head) or pcapng.is_pcapng(head)


def datagrams(view: memoryview, tally: Tally) -> Iterator[Payload]:
    """UDP datagrams in file order; damaged records are skipped and counted."""
    return (found for found in payloads(view, tally) if found.sequence is None)


def payloads(view: memoryview, tally: Tally) -> Iterator[Payload]:
    """UDP datagrams and TCP segments in file order; damaged records are skipped and counted.

    Of a datagram whose fragments are not all there its beginning is given, later than others: what it is of
    tells whether anything is lost.
    """
    head = bytes(view[: pcap.FILE_HEAD_BYTES])
    read = pcapng.packets if pcapng.is_pcapng(head) else pcap.packets
    seen = _Seen()
    pending = Fragments()
    for packet in read(view, tally):
        found = _whole(packet, bytes(view[packet.start : packet.stop]), pending, tally)
        for carried in (found, *pending.given_up()):
            yield from seen.first_sights(_carried(carried, tally), tally)
    for cut in pending.given_up(0):
        yield from seen.first_sights(_carried(cut, tally), tally)


@dataclass
class _Seen:
    """The datagrams of the last REPEAT_NS by what they say: when, in which flow and packet."""

    last: dict[bytes, Payload] = field(default_factory=dict)

    def first_sights(self, found: Iterator[Payload], tally: Tally) -> Iterator[Payload]:
        """Payloads without those datagrams that were seen just before; the others are counted."""
        for payload in found:
            if payload.sequence is None and self._is_repeat(payload):
                tally.repeats += 1
            else:
                yield payload

    def _is_repeat(self, found: Payload) -> bool:
        while self.last:
            content, oldest = next(iter(self.last.items()))
            if len(self.last) <= MOST_SEEN and abs(found.time_ns - oldest.time_ns) <= REPEAT_NS:
                break
            del self.last[content]
        before = self.last.pop(found.content, None)
        is_repeat = before is not None and not _is_another(before, found)
        self.last[found.content] = before if before is not None and is_repeat else found
        return is_repeat


def _is_another(before: Payload, found: Payload) -> bool:
    """Whether one flow numbers a datagram that says the same as another packet."""
    is_numbered = before.identity and found.identity and before.flow == found.flow
    return bool(is_numbered) and before.identity != found.identity


def _ip_start(frame: bytes, link: int) -> int:
    """Where the IP packet begins in a frame; -1 where there is none."""
    if link in IP_STARTS:
        return IP_STARTS[LinkType(link)]
    if link == LinkType.SLL:
        return 16 if frame[14:16] in IP_TYPES else -1
    if link == LinkType.SLL2:
        return 20 if frame[:2] in IP_TYPES else -1
    if link != LinkType.ETHERNET:
        return -1
    at = 12
    while at + 2 <= len(frame) and int.from_bytes(frame[at : at + 2], "big") in VLAN_TYPES:
        at += 4
    return at + 2 if frame[at : at + 2] in IP_TYPES else -1


def _whole(
    packet: Packet, frame: bytes, pending: Fragments, tally: Tally
) -> tuple[IpPacket, tuple[int, int]] | None:
    """The IP packet of a frame and its place; of fragments, once all are there."""
    start = _ip_start(frame, packet.link)
    if start < 0:
        return None
    try:
        found = ip_packet(frame, start, ONLY_VERSION.get(packet.link, 0))
    except HeaderError as error:
        tally.undecode("packets", 1, str(error))
        return None
    if found is None or found.protocol not in (IPPROTO_UDP, IPPROTO_TCP):
        return None
    place = (packet.at, packet.time_ns)
    if not found.number:
        return found, place
    try:
        return pending.add(found, place)
    except HeaderError as error:
        tally.undecode("packets", 1, str(error))
        return None


def _carried(found: tuple[IpPacket, tuple[int, int]] | None, tally: Tally) -> Iterator[Payload]:
    """The payload of a packet; none where it carries nothing."""
    if found is None:
        return
    packet, place = found
    body = packet.body
    if len(body) < (UDP_BYTES if packet.protocol == IPPROTO_UDP else TCP_BYTES):
        tally.undecode("packets", 1, "a packet that ends in its header")
        return
    source, target = struct.unpack_from(">2H", body)
    flow = bytes([packet.protocol]) + packet.hosts + body[:4]
    if packet.protocol == IPPROTO_UDP:
        size = int.from_bytes(body[4:6], "big")
        if size < UDP_BYTES:
            tally.undecode("packets", 1, "the length of the UDP datagram is less than its header")
            return
        yield Payload(*place, flow, source, target, body[UDP_BYTES:size], identity=packet.identity)
        return
    start = 4 * (body[12] >> 4)
    if start < TCP_BYTES:
        tally.undecode("packets", 1, "the length of the TCP header is less than its fields")
        return
    content = body[start:]
    if content:
        yield Payload(*place, flow, source, target, content, int.from_bytes(body[4:8], "big"))
