"""The same traffic as `pcap`, in a pcapng capture."""

from __future__ import annotations

import struct

from tests.samplelogs import Record, pcap

SUFFIX = ".pcapng"
FORMAT = "tlog"
RESYNC_BYTES = 130
COUNT = pcap.COUNT
HEAD_BYTES = 28 + 20


def block(kind: int, body: bytes) -> bytes:
    """One block; its length stands at both ends."""
    padded = body + bytes(-len(body) % 4)
    size = struct.pack("<I", 12 + len(padded))
    return struct.pack("<I", kind) + size + padded + size


def build() -> bytes:
    """A section, an interface, a block a packet."""
    out = [block(0x0A0D0D0A, struct.pack("<I2Hq", 0x1A2B3C4D, 1, 0, -1))]
    out.append(block(1, struct.pack("<2HI", pcap.RAW_IPV4, 0, 65535)))
    for micros, packet in pcap.packets():
        size = len(packet)
        out.append(block(6, struct.pack("<5I", 0, micros >> 32, micros & 0xFFFFFFFF, size, size) + packet))
    return b"".join(out)


def records(blob: bytes) -> list[Record]:
    """Section and interface, and every packet."""
    found = [Record(0, HEAD_BYTES, 0)]
    while (at := found[-1].end) < len(blob):
        found.append(Record(at, at + int.from_bytes(blob[at + 4 : at + 8], "little"), 1))
    return found


def at_risk(blob: bytes, byte: int) -> int:  # noqa: ARG001
    """Section and interface decide over all packets; a block's length, over the one behind it."""
    return COUNT if byte < HEAD_BYTES else 2


def unseen(blob: bytes, start: int, end: int) -> bool:
    """A block may become one of another type; see also `pcap`."""
    found = records(blob)
    is_type = any(r.start < end and r.start + 4 > start for r in found)
    return is_type or pcap.holds_headers(found, start, end, 28)
