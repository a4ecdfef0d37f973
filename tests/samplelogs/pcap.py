"""A capture of MAVLink over UDP, one frame a packet, without Ethernet, whose types no checksum guards."""

from __future__ import annotations

import math
import struct

from tests.samplelogs import Record
from tests.samplelogs.tlog import EPOCH_US, frame, sender

SUFFIX = ".pcap"
FORMAT = "tlog"
RAW_IPV4 = 228
FILE_HEAD = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, RAW_IPV4)
RESYNC_BYTES = 110  # garbage may pass for the head of a record that takes in the one behind it
COUNT = 150


def packets() -> list[tuple[int, bytes]]:
    """(microseconds, IP packet): attitude at 50 Hz, now and then a heartbeat."""
    vehicle = sender()
    found = []
    for i in range(COUNT):
        ms = 5000 + 20 * i
        message = (
            vehicle.heartbeat_encode(2, 3, 81, i, 4)
            if i % 25 == 3
            else vehicle.attitude_encode(ms, math.sin(0.1 * i), 0.5, -1, 0.25, 0, 0.125)
        )
        found.append((EPOCH_US + 20_000 * i, ip_udp(frame(vehicle, message), number=i + 1)))
    return found


def ip_udp(content: bytes, number: int) -> bytes:
    """A datagram over IPv4; its header's checksum holds."""
    body = struct.pack(">4H", 14550, 14551, 8 + len(content), 0) + content
    head = struct.pack(
        ">BBHHHBBH4s4s", 0x45, 0, 20 + len(body), number, 0x4000, 64, 17, 0, b"\x0a\0\0\1", b"\x0a\0\0\2"
    )
    total = sum(struct.unpack(">10H", head))
    checksum = 0xFFFF - ((total & 0xFFFF) + (total >> 16))
    return head[:10] + struct.pack(">H", checksum) + head[12:] + body


def build() -> bytes:
    """A file head, then a record a packet."""
    out = [FILE_HEAD]
    for micros, packet in packets():
        out.append(struct.pack("<4I", micros // 10**6, micros % 10**6, len(packet), len(packet)) + packet)
    return b"".join(out)


def records(blob: bytes) -> list[Record]:
    """The head of the file, and every packet."""
    found = [Record(0, len(FILE_HEAD), 0)]
    while (at := found[-1].end) < len(blob):
        found.append(Record(at, at + 16 + int.from_bytes(blob[at + 8 : at + 12], "little"), 1))
    return found


def at_risk(blob: bytes, byte: int) -> int:  # noqa: ARG001
    """The head of the file decides over all packets; a record's length, over the one behind it."""
    return COUNT if byte < len(FILE_HEAD) else 2


def unseen(blob: bytes, start: int, end: int) -> bool:
    """Several bytes of the headers at once may make a packet of another program, without a checksum."""
    return holds_headers(records(blob), start, end, 16)


def holds_headers(found: list[Record], start: int, end: int, skip: int) -> bool:
    """Whether at least four bytes are changed, of headers that begin so far behind a record's start."""
    touched = any(r.start + skip < end and r.start + skip + 28 > start for r in found[1:])
    return end - start >= 4 and touched
