"""Packets of a pcapng capture.

A file is a row of blocks, padded to 4 bytes: u32 type, u32 length of the whole block, body, u32 length again.
Section header (0A0D0D0A): u32 1A2B3C4D in the section's byte order. Interface (1): u16 link type, u16 0,
u32 snap length, options (9: resolution of its times, a power of ten or, with the top bit, of two; 14: seconds
to add). Packet (6): u32 interface, u32 and u32 time, u32 captured, u32 length, bytes; the obsolete packet (2)
has u16 interface and u16 drops in front; the simple packet (3) has u32 length and bytes, and no time. Other
blocks are passed over. Source: draft-ietf-opsawg-pcapng.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from flysid.ingest.formats.base import release
from flysid.ingest.formats.common.pcap import RELEASE_BYTES, Packet
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.common.windows import windows, words_at, words_from

ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
MAGIC = b"\x0a\x0d\x0d\x0a"
LEAST_BLOCK = 12
LEAST_INTERFACE = 20
MOST_BLOCK = 16 << 20
MAX_NS = 1 << 62  # in the year 2116


class InterfaceOption(IntEnum):
    """Options of an interface block that times need."""

    RESOLUTION = 9
    OFFSET = 14


class BlockKind(IntEnum):
    """The blocks of a pcapng file that are read."""

    SECTION = 0x0A0D0D0A
    INTERFACE = 1
    OBSOLETE = 2
    SIMPLE = 3
    PACKET = 6


# names, statistics, journals, secrets; what a program adds of its own
WITHOUT_PACKETS = frozenset({4, 5, 9, 10, 0x0BAD, 0x40000BAD})


def is_pcapng(head: bytes) -> bool:
    """Whether bytes begin as a pcapng capture does."""
    return head[:4] == MAGIC and head[8:12] in ORDERS


@dataclass
class _Section:
    """The byte order of a section; the link type, ticks a second and offset of its interfaces."""

    order: str
    interfaces: list[tuple[int, int, int]] = field(default_factory=list)


def packets(view: memoryview, tally: Tally) -> Iterator[Packet]:
    """Packets in file order; damaged blocks are skipped and counted."""
    section = _Section("<")
    at = released = 0
    last_ns = 0
    while at < len(view):
        if at - released > RELEASE_BYTES:
            release(view, released, at)
            released = at
        end = _block_end(view, at, section.order)
        if end is None:
            at = _recover(view, at, section.order, tally)
            continue
        kind = struct.unpack_from(section.order + "I", view, at)[0]
        if kind == BlockKind.SECTION:
            section = _Section(ORDERS[bytes(view[at + 8 : at + 12])])
        elif kind == BlockKind.INTERFACE and end - at >= LEAST_INTERFACE:
            section.interfaces.append(_interface(view, (at + 8, end - 4), section.order))
        elif kind in (BlockKind.SIMPLE, BlockKind.PACKET, BlockKind.OBSOLETE):
            found = _packet(view, (at, end), kind, section, last_ns)
            if found is None:
                tally.skip(at, end, "a packet that does not fit its block, or of no interface")
            elif found.time_ns < MAX_NS:
                last_ns = found.time_ns
                yield found
            else:
                tally.time_outliers["capture"] += 1
                yield replace(found, time_ns=last_ns)
        elif kind not in WITHOUT_PACKETS:
            tally.undecode("blocks", 1, "of a type that is not known")
        at = end


def _block_end(view: memoryview, at: int, order: str) -> int | None:
    """Where the block at `at` ends; None where there is none."""
    if at + LEAST_BLOCK > len(view):
        return None
    if bytes(view[at : at + 4]) == MAGIC:
        order = ORDERS.get(bytes(view[at + 8 : at + 12]), "")
        if not order:
            return None
    size = struct.unpack_from(order + "I", view, at + 4)[0]
    if size < LEAST_BLOCK or size % 4 or size > MOST_BLOCK or at + size > len(view):
        return None
    again = struct.unpack_from(order + "I", view, at + size - 4)[0]
    return at + int(size) if again == size else None


def _recover(view: memoryview, at: int, order: str, tally: Tally) -> int:
    """After damage: the next block that another one, or the end, follows."""
    for place in _likely(view, at + 1, order):
        end = _block_end(view, place, order)
        if end is not None and (end == len(view) or _block_end(view, end, order) is not None):
            tally.skip(at, place, "no block here")
            return place
    tally.truncated = True
    tally.skip(at, len(view), "cut off inside a block")
    return len(view)


def _likely(view: memoryview, start: int, order: str) -> Iterator[int]:
    """The places from `start` on where a block could begin, whose size stands at its end, too."""
    (magic,) = struct.unpack(order + "I", MAGIC)
    for begin, end in windows(start, len(view) - LEAST_BLOCK + 1):
        words = words_at(view, begin, end + 4, order)
        kind = words[: end - begin]
        size = words[4:]
        is_section = kind == magic  # in a byte order of its own
        at = np.flatnonzero(is_section | ((size >= LEAST_BLOCK) & (size <= MOST_BLOCK) & (size % 4 == 0)))
        behind = begin + at + size[at]
        ends = words_from(view, behind - 4, order) == size[at]
        follows = words_from(view, behind, order)
        sizes = words_from(view, behind + 4, order)
        goes_on = (behind == len(view)) | (follows == magic) | ((sizes >= LEAST_BLOCK) & (sizes % 4 == 0))
        yield from (begin + at[is_section[at] | (ends & goes_on)]).tolist()


def _interface(view: memoryview, body: tuple[int, int], order: str) -> tuple[int, int, int]:
    """Link type, ticks a second, and seconds to add."""
    at, end = body
    link = struct.unpack_from(order + "H", view, at)[0]
    ticks = 10**6
    offset_s = 0
    at += 8
    while at + 4 <= end:
        code, size = struct.unpack_from(order + "2H", view, at)
        if code == 0 or at + 4 + size > end:
            break
        if code == InterfaceOption.RESOLUTION and size == 1:
            power = view[at + 4]
            ticks = 1 << (power & 0x7F) if power & 0x80 else 10 ** min(power, 18)
        elif code == InterfaceOption.OFFSET and size == 8:
            offset_s = struct.unpack_from(order + "q", view, at + 4)[0]
        at += 4 + -(-size // 4) * 4
    return link, ticks, offset_s


def _packet(
    view: memoryview, span: tuple[int, int], kind: int, section: _Section, last_ns: int
) -> Packet | None:
    """The packet in a block; None where it does not fit, or is of an interface that nothing describes."""
    at, end = span
    if kind == BlockKind.SIMPLE:
        link = section.interfaces[0][0] if section.interfaces else None
        return None if link is None else Packet(last_ns, link, at + 12, end - 4)
    if end - at < 32:
        return None
    number, high, low, captured = struct.unpack_from(section.order + "4I", view, at + 8)
    if kind == BlockKind.OBSOLETE:
        number = struct.unpack_from(section.order + "H", view, at + 8)[0]
    if number >= len(section.interfaces) or at + 28 + captured > end - 4:
        return None
    link, ticks, offset_s = section.interfaces[number]
    time_ns = (high << 32 | low) * 10**9 // ticks + offset_s * 10**9
    return Packet(time_ns if time_ns >= 0 else MAX_NS, link, at + 28, at + 28 + captured)
