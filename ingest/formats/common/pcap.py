"""Packets of a classic pcap capture.

File: u32 magic (a1b2c3d4: microseconds, a1b23c4d: nanoseconds, either byte order), u16 major, u16 minor,
i32 zone, u32 accuracy, u32 snap length, u32 link type; then records of u32 seconds, u32 fraction, u32
captured, u32 length, bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flysid.ingest.formats.base import release
from flysid.ingest.formats.common.clock import BoolArray
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.common.windows import Words, windows, words_at, words_from

FILE_HEAD_BYTES = 24
RECORD_HEAD_BYTES = 16
LEAST_RECORD = RECORD_HEAD_BYTES + 20  # with the head of an IP packet
MAX_CAPTURED = 1 << 18
RELEASE_BYTES = 16 << 20
MAX_STEP_S = 86_400
FAR = 4  # whole records in a row that must agree on a time more than a day away: clocks are set, bits flip


@dataclass(frozen=True)
class Packet:
    """A captured frame.

    Attributes
    ----------
    time_ns : when it was captured, UTC.
    link : what kind of frame it is (LINKTYPE).
    start, stop : its bytes in the file.
    """

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
    at = _first_record(view, style)
    tally.skip(FILE_HEAD_BYTES, at, "no record here")
    last_s = -1
    released = 0
    while at < len(view):
        if at - released > RELEASE_BYTES:
            release(view, released, at)
            released = at
        head = _record(view, at, style)
        if head is None or not (_is_near(head, last_s) or _is_believed(view, at, style)):
            at = _recover(view, at, (style, last_s), tally)
            continue
        last_s = head.seconds
        yield Packet(head.time_ns, style.link, at + RECORD_HEAD_BYTES, head.end)
        at = head.end


def _first_record(view: memoryview, style: _Style) -> int:
    """Where the first record begins that can be believed; where it should, if none can within a record."""
    head = _record(view, FILE_HEAD_BYTES, style)
    if head is not None and head.end >= FILE_HEAD_BYTES + LEAST_RECORD and _is_followed(view, head, style):
        return FILE_HEAD_BYTES
    places = _likely(view, FILE_HEAD_BYTES, MAX_CAPTURED, style)
    return next((at for at in places if _is_believed(view, at, style)), FILE_HEAD_BYTES)


@dataclass(frozen=True)
class _Head:
    """What the head of a record says: seconds, time, where it ends, and whether its packet is whole."""

    seconds: int
    time_ns: int
    end: int
    is_whole: bool


def _record(view: memoryview, at: int, style: _Style) -> _Head | None:
    """The head of the record at `at`; None where it cannot be one."""
    if at + RECORD_HEAD_BYTES > len(view):
        return None
    seconds, fraction, captured, length = struct.unpack_from(style.order + "4I", view, at)
    end = at + RECORD_HEAD_BYTES + captured
    sane = captured <= min(length, MAX_CAPTURED) and fraction * style.unit_ns < 10**9 and end <= len(view)
    time_ns = seconds * 10**9 + fraction * style.unit_ns
    return _Head(seconds, time_ns, end, captured == length) if sane else None


def _is_near(head: _Head, last_s: int) -> bool:
    """Whether a record's time lies within a day of the one before."""
    return last_s < 0 or abs(head.seconds - last_s) <= MAX_STEP_S


def _is_followed(view: memoryview, head: _Head, style: _Style) -> bool:
    """Whether a record near in time stands behind one, or the file ends with it."""
    behind = _record(view, head.end, style)
    return head.end == len(view) or (behind is not None and _is_near(behind, head.seconds))


def _is_believed(view: memoryview, at: int, style: _Style) -> bool:
    """Whether several records of whole packets follow each other from `at` on, near to each other in time."""
    last_s = -1
    for _ in range(FAR):
        head = _record(view, at, style)
        if head is None or not head.is_whole or head.end - at < LEAST_RECORD or not _is_near(head, last_s):
            return False
        if head.end == len(view):
            return True
        at = head.end
        last_s = head.seconds
    return True


def _recover(view: memoryview, at: int, known: tuple[_Style, int], tally: Tally) -> int:
    """After damage: the next record that others, or the end, follow.

    One near in time comes first, where it lies no further than a record is long: heads read from a wrong
    place may agree with each other, too.
    """
    style, _ = known
    close = _likely(view, at + 1, at + MAX_CAPTURED, style)
    near = (place for place in close if _resumes(view, place, known))
    every = _likely(view, at + 1, len(view), style)
    anywhere = (place for place in every if _resumes(view, place, known, far=True))
    place = next(near, None) or next(anywhere, None)
    if place is not None:
        tally.skip(at, place, "no record here")
        return place
    tally.truncated = True
    tally.skip(at, len(view), "cut off inside a record")
    return len(view)


def _likely(view: memoryview, start: int, stop: int, style: _Style) -> Iterator[int]:
    """The places from `start` on and before `stop` where a record of an IP packet could stand.

    Another head, or the end of the file, is behind it.
    """
    stop = min(stop, len(view) - RECORD_HEAD_BYTES + 1)
    least = LEAST_RECORD - RECORD_HEAD_BYTES
    for begin, end in windows(start, stop):
        words = words_at(view, begin, end + RECORD_HEAD_BYTES - 4, style.order)
        fraction, captured, length = (words[k : k + end - begin] for k in (4, 8, 12))
        at = np.flatnonzero(_sane(fraction, captured, length, style) & (captured >= least))
        behind = begin + at + RECORD_HEAD_BYTES + captured[at]
        inside = behind <= len(view) - RECORD_HEAD_BYTES
        fraction, captured, length = (words_from(view, behind + k, style.order) for k in (4, 8, 12))
        followed = (behind == len(view)) | (inside & _sane(fraction, captured, length, style))
        yield from (begin + at[followed]).tolist()


def _sane(fraction: Words, captured: Words, length: Words, style: _Style) -> BoolArray:
    """(n,) whether heads of records with these numbers could be."""
    fits = (captured <= MAX_CAPTURED) & (captured <= length) & (fraction < 10**9 // style.unit_ns)
    return np.asarray(fits, dtype=bool)


def _resumes(view: memoryview, at: int, known: tuple[_Style, int], *, far: bool = False) -> bool:
    """Whether a record that others, or the end, follow begins here; with `far` one of another time, too."""
    style, last_s = known
    head = _record(view, at, style)
    if head is None or head.end - at < LEAST_RECORD:
        return False
    if _is_near(head, last_s):
        return _is_followed(view, head, style)
    return far and _is_believed(view, at, style)
