"""What went over a network: UDP datagrams and TCP segments of a capture (pcap, pcapng), over IPv4 and IPv6.

Link types: Ethernet (with VLAN tags), Linux cooked (1 and 2), raw IP, BSD loopback. Fragments of datagrams
are put together: AR.Drone navdata with all options exceed an Ethernet frame. Left out: Wi-Fi, tunnels.

A capture on several interfaces sees what passes through its host twice: in on one, out on another. A datagram
that says the same within REPEAT_NS is such a second sight, unless one flow numbers it as another packet.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from socket import IPPROTO_TCP, IPPROTO_UDP

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import pcap, pcapng
from flysid.ingest.formats.common.internet import Fragments, HeaderError, IpPacket, ip_packet
from flysid.ingest.formats.common.located import Located
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
SYN = 2  # the flag of a TCP header that opens a connection
SEQUENCES = 1 << 32  # of the bytes of a TCP stream
JOINED_BYTES = 1 << 22  # at a time
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
    time_ns : when it was captured.
    flow : protocol, addresses and ports: who sends to whom.
    source_port, target_port : of these.
    body : the bytes, and where in the file they lie.
    sequence : of TCP, the number of the first byte; None of UDP.
    opens : of TCP, whether a connection begins here.
    identity : of the IP packet, by its sender; b"" where it has none.
    """

    time_ns: int
    flow: bytes
    source_port: int
    target_port: int
    body: Located
    sequence: int | None = None
    opens: bool = False
    identity: bytes = b""

    @property
    def content(self) -> bytes:
        """The bytes alone."""
        return self.body.data


def is_capture(head: bytes) -> bool:
    """Whether bytes begin as a capture does."""
    return pcap.is_pcap(head) or pcapng.is_pcapng(head)


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001 - as readers have it
    """1 for the beginning of a capture."""
    return float(is_capture(head))


def listen(view: memoryview, limits: Limits) -> Iterator[tuple[str, int]]:  # noqa: ARG001 - as readers have it
    """The flow and the time of each datagram and segment; flows of captures of other kinds are others."""
    kind = _kind_of(view).hex()
    for found in payloads(view, Tally()):
        yield f"{kind} {found.flow.hex()}", found.time_ns


def _kind_of(view: memoryview) -> bytes:
    """Byte order, resolution of times and link of a capture; of pcapng, which states them anew, only that."""
    head = bytes(view[: pcap.FILE_HEAD_BYTES])
    return head[:4] if pcapng.is_pcapng(head) else head[:4] + head[20:]


def join_captures(views: Sequence[memoryview]) -> Iterator[bytes]:
    """Captures of one kind as one: the head of the first, and the packets of all."""
    head = bytes(views[0][: pcap.FILE_HEAD_BYTES])
    skipped = 0 if pcapng.is_pcapng(head) else pcap.FILE_HEAD_BYTES
    yield head[:skipped]
    for view in views:
        for start in range(skipped, len(view), JOINED_BYTES):
            yield bytes(view[start : start + JOINED_BYTES])


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
        found = _whole(packet, view, pending, tally)
        for carried in (found, *pending.given_up()):
            yield from seen.first_sights(_carry(carried, tally), tally)
    for cut in pending.given_up(0):
        yield from seen.first_sights(_carry(cut, tally), tally)


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


def _whole(packet: Packet, view: memoryview, pending: Fragments, tally: Tally) -> tuple[IpPacket, int] | None:
    """The IP packet of a frame and its time; of fragments, once all are there."""
    frame = bytes(view[packet.start : packet.stop])
    start = _ip_start(frame, packet.link)
    if start < 0:
        return None
    try:
        located = Located(frame, ((packet.start, len(frame)),))
        found = ip_packet(located, start, ONLY_VERSION.get(packet.link, 0))
    except HeaderError as error:
        tally.undecode("packets", 1, str(error))
        return None
    if found is None or found.protocol not in (IPPROTO_UDP, IPPROTO_TCP):
        return None
    if not found.number:
        return found, packet.time_ns
    try:
        return pending.add(found, packet.time_ns)
    except HeaderError as error:
        tally.undecode("packets", 1, str(error))
        return None


def _carry(found: tuple[IpPacket, int] | None, tally: Tally) -> Iterator[Payload]:
    """The payload of a packet; none where it carries nothing."""
    if found is None:
        return
    packet, time_ns = found
    body = packet.body
    head = body.data[:TCP_BYTES]
    if len(head) < (UDP_BYTES if packet.protocol == IPPROTO_UDP else TCP_BYTES):
        tally.undecode("packets", 1, "a packet that ends in its header")
        return
    source, target = struct.unpack_from(">2H", head)
    flow = bytes([packet.protocol]) + packet.hosts + head[:4]
    if packet.protocol == IPPROTO_UDP:
        size = int.from_bytes(head[4:6], "big")
        if size < UDP_BYTES:
            tally.undecode("packets", 1, "the length of the UDP datagram is less than its header")
            return
        content = body.cut(UDP_BYTES, size)
        yield Payload(time_ns, flow, source, target, content, identity=packet.identity)
        return
    start = 4 * (head[12] >> 4)
    if start < TCP_BYTES:
        tally.undecode("packets", 1, "the length of the TCP header is less than its fields")
        return
    content = body.cut(start, len(body))
    opens = bool(head[13] & SYN)
    first = (int.from_bytes(head[4:8], "big") + opens) % SEQUENCES  # the opening itself counts as a byte
    if opens or len(content):
        yield Payload(time_ns, flow, source, target, content, first, opens)
