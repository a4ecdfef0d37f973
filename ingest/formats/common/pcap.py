"""Packets of a classic pcap capture.

File: u32 magic (a1b2c3d4: microseconds, a1b23c4d: nanoseconds, either byte order), u16 major, u16 minor,
i32 zone, u32 accuracy, u32 snap length, u32 link type; then records of u32 seconds, u32 fraction, u32
captured, u32 length, bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from flysid.ingest.formats.base import release
from flysid.ingest.formats.common.tally import Tally

FILE_HEAD_BYTES = 24
RECORD_HEAD_BYTES = 16
MAX_CAPTURED = 1 << 18
RELEASE_BYTES = 16 << 20
MAX_STEP_S = 86_400


@dataclass(frozen=True)
class Packet:
    """A captured frame.

    Attributes
    ----------
    at : where its record begins in the file.
    time_ns : when it was captured, UTC.
    link : what kind of frame it is (LINKTYPE).
    start, stop : its bytes in the file.
    """

    at: int
    time_ns: int
    link: int
    start: int
    stop: int


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


def packets(view: memoryview, tally: Tally) -> Iterator[Packet]:
    """Packets in file order; damaged records are skipped and counted."""
    style = _style(bytes(view[:FILE_HEAD_BYTES]))
    if style is None:
        return
    at = FILE_HEAD_BYTES
    last_s = -1
    released = 0
    while at < len(view):
        if at - released > RELEASE_BYTES:
            release(view, released, at)
            released = at
        head = _record(view, at, style, last_s)
        if head is None:
            at = _recover(view, at, (style, last_s), tally)
            continue
        last_s, time_ns, end = head
        yield Packet(at, time_ns, style.link, at + RECORD_HEAD_BYTES, end)
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
