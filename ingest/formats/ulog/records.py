"""Finding ULog records: vectorised over data records, one by one over the rest, again after damage.

A file is the 7-byte magic, u8 version, u64 start time, then records of u16 size, u8 type, `size` bytes
(little-endian). A data record ("D") begins with the u16 id of a subscription, and its size follows from the
subscribed format. That decides how they are found: every byte "D" of a window whose size and id agree is a
candidate; candidates that touch each other form runs, and runs are taken whole. Candidates inside other
records are never reached. After damage the next record is a candidate that another record follows, a sync
record, or any other record of sound shape that another follows.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from flysid.ingest.formats.common.gather import Bytes, Index, as_bytes, numbers
from flysid.ingest.formats.ulog.layouts import NUMBERS

MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"
SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
FILE_HEAD_BYTES = 16
HEAD_BYTES = 3
HEAD = struct.Struct("<HB")
OTHER_TYPES = frozenset(b"BFIMPQARSOLC")
FIRST_WINDOW_BYTES = 1 << 18  # after every change of subscriptions; then larger ones up to
WINDOW_BYTES = 8 << 20
MAX_TEXT = 300
MAX_UNKNOWN = 4
MAX_KEYS = 1 << 13
ANY_SIZE = -1
FLAGS, FORMAT_TYPE, ADDED, LOGGED, TAGGED, SYNC_TYPE, DATA, PARAMETER = b"BFALCSDP"
_KEY = re.compile(rb"[a-z0-9_]+(\[\d+\])? [\x21-\x7e]+")
_NAME = re.compile(rb"[!-~]+")
_SIZED = re.compile(rb"(\w+?)(?:\[(\d{1,5})\])? ")
_TEXT_AT = {LOGGED: 9, TAGGED: 11}
_FORMAT = re.compile(rb"[\w/-]+:[ -~]*")  # all of it: a length that swallows the next record is none


@dataclass(frozen=True)
class DataRun:
    """Data records one after the other: places and subscription numbers, (n,) each."""

    at: Index
    subscription: Index


@dataclass(frozen=True)
class _Window:
    """Candidates of [start, end): places, ends, subscriptions, and the last one of the run each is in."""

    start: int
    end: int
    at: Index
    stop: Index
    subscription: Index
    run_end: Index


class Sizes:
    """What a data record of an id must measure: payload from `least` to `most` bytes behind the id."""

    def __init__(self) -> None:
        self.subscription: NDArray[np.int32] = np.full(65536, -1, dtype=np.int32)
        self.least: NDArray[np.int32] = np.full(65536, 1 << 20, dtype=np.int32)
        self.most: NDArray[np.int32] = np.full(65536, -1, dtype=np.int32)
        self.known: NDArray[np.bool_] = np.zeros(65536, dtype=np.bool_)  # was ever subscribed

    def subscribe(self, number: int, subscription: int, least: int, most: int) -> None:
        self.subscription[number] = subscription
        self.least[number] = least
        self.most[number] = most
        self.known[number] = True

    def remove(self, number: int) -> None:
        self.subscribe(number, -1, 1 << 20, -1)


class Framer:
    """Records of one file up to `stop`; the caller tells of subscriptions through `sizes` and `changed`."""

    def __init__(self, view: memoryview, stop: int) -> None:
        self.view = view
        self.stop = stop
        self.sizes = Sizes()
        self.topics: set[bytes] = set()  # names of formats, which subscriptions name
        self.data = as_bytes(view)
        self._window: _Window | None = None
        self._reach = FIRST_WINDOW_BYTES
        self._sound_at = -1  # a place where a sound record is known to lie

    def changed(self) -> None:
        """Subscriptions changed: candidates must be looked for again."""
        self._window = None
        self._sound_at = -1

    def data_run(self, at: int) -> DataRun | None:
        """The run of data records that begins at `at`; None where none does."""
        window = self._window_at(at)
        first = int(np.searchsorted(window.at, at))
        if first == len(window.at) or window.at[first] != at:
            return None
        last = int(window.run_end[first]) + 1
        return DataRun(window.at[first:last], window.subscription[first:last])

    def head(self, at: int) -> tuple[int, int, int]:
        """Type, payload start and end of the record at `at`; type -1 where not even a head fits."""
        if at + HEAD_BYTES > self.stop:
            return -1, at, self.stop + 1
        size, kind = HEAD.unpack_from(self.view, at)
        return kind, at + HEAD_BYTES, at + HEAD_BYTES + size

    def is_sound(self, at: int) -> bool:
        """Whether a record of fitting size or shape lies at `at`.

        Asked twice of most records: as what follows another, then on its own.
        """
        if at == self._sound_at:
            return True
        kind, body, end = self.head(at)
        if end > self.stop:
            return False
        if kind == DATA:
            return self._fits(body, end)
        if kind in OTHER_TYPES and has_shape(kind, self.view[body:end]):
            self._sound_at = at
            return True
        return False

    def keyed_run(self, at: int) -> list[tuple[int, int, int, bytes]]:
        """Heads and keys of the records of a key and its value from `at` on: exact, and followed by one more.

        A log begins with some thousand of these.
        """
        found = []
        while at + HEAD_BYTES < self.stop:
            size, kind = HEAD.unpack_from(self.view, at)
            body = at + HEAD_BYTES
            end = at + HEAD_BYTES + size
            key = body + (kind in b"MQ")
            if kind not in b"IMPQ" or not key + 2 <= end <= self.stop:
                break
            width = self.view[key]
            value = end - key - 1 - width
            if width < 3 or value < 1:
                break
            named = bytes(self.view[key + 1 : key + 1 + width])
            if _value_size(named) not in (ANY_SIZE, value):
                break
            found.append((kind, body, end, named))
            at = end
        return found[:-1]

    def is_followed(self, end: int) -> bool:
        """Whether at `end` is the end, a sound record, one that the end cuts, or data of a known id.

        A few records of data whose subscriptions are lost may stand before it.
        """
        if end >= self.stop:
            return end == self.stop
        if self.is_sound(end) or self.is_cut(end):
            return True
        for _ in range(MAX_UNKNOWN):
            if self.is_sound(end):
                return True
            kind, body, after = self.head(end)
            if kind != DATA or not body + 2 <= after <= self.stop:
                return False
            if self.sizes.known[self._id(body)]:
                return True
            end = after
        return False

    def is_unit(self, at: int) -> bool:
        """Whether an unusable record lies at `at`: another follows, a sound one if its type is new."""
        kind, body, end = self.head(at)
        if kind <= 0 or not body < end <= self.stop:
            return False
        is_known = kind in OTHER_TYPES or kind == DATA
        return (self.is_followed if is_known else self.is_sound)(end) and self.next_record(at + 1, end) == end

    def fits_better(self, number: int, at: int, ours: range, theirs: range) -> bool:
        """Whether data of an id behind `at` are rather `ours` than `theirs`, sizes without the id."""
        places = np.flatnonzero(self.data[at + 2 : min(at + WINDOW_BYTES, self.stop)] == DATA) + at
        places = places[places + 5 <= self.stop]
        places = places[numbers(self.data, places + 3, "<u2") == number]
        sizes = (numbers(self.data, places, "<u2").astype(np.int64) - 2).tolist()
        return sum(size in ours for size in sizes) > sum(size in theirs for size in sizes)

    def is_exact(self, head: tuple[int, int, int]) -> bool:
        """Whether a sound record, not of data, is as long as its content asks and another one follows.

        Texts and values take any length: where a wrong one swallows records, only this tells.
        """
        kind, body, end = head
        content = self.view[body:end]
        if kind in b"LC" and not is_text(content[_TEXT_AT[kind] :]):
            return False
        if kind in b"IPMQ" and not _has_its_value(content[1:] if kind in b"MQ" else content):
            return False
        return self.is_followed(end)

    def is_cut(self, at: int) -> bool:
        """Whether a record of a known type starts at `at` that the end cuts."""
        kind, body, end = self.head(at)
        if kind < 0:
            return at < self.stop
        known = kind in OTHER_TYPES or (
            kind == DATA and (body + 2 > self.stop or bool(self.sizes.known[self._id(body)]))
        )
        return known and end > self.stop

    def knows(self, body: int) -> bool:
        """Whether the data record with its payload at `body` is of an id that was ever subscribed."""
        return body + 2 <= self.stop and bool(self.sizes.known[self._id(body)])

    def is_cut_data(self, at: int) -> bool:
        """Whether a data record of the right size starts at `at` and the end cuts it."""
        kind, body, end = self.head(at)
        if kind != DATA or end <= self.stop or body + 2 > self.stop:
            return False
        number = self._id(body)
        return bool(self.sizes.least[number] <= end - body - 2 <= self.sizes.most[number])

    def next_record(self, at: int, stop: int | None = None) -> int:
        """The first place in [at, stop) where a sound record lies that another follows; else `stop`."""
        stop = self.stop if stop is None else stop
        while at < stop:
            window = self._window_at(at)
            end = min(window.end, stop)
            data = self._next_data(window, at, end)
            other = self._next_other(at, end if data < 0 else data)
            if data >= 0 or other >= 0:
                return other if other >= 0 else data
            at = end
        return stop

    def _next_data(self, window: _Window, at: int, end: int) -> int:
        first, last = np.searchsorted(window.at, [at, end]).tolist()
        for k in range(first, last):
            if window.run_end[k] > k or self.is_followed(int(window.stop[k])):
                return int(window.at[k])
        return -1

    def _next_other(self, at: int, end: int) -> int:
        kinds = self.data[at + 2 : end + 2]
        known = np.zeros(256, dtype=np.bool_)
        known[list(OTHER_TYPES)] = True
        for place in (np.flatnonzero(known[kinds]) + at).tolist():
            if not self.is_sound(place):
                continue
            kind, body, after = self.head(place)
            if kind in b"LC" and not is_text(self.view[body + _TEXT_AT[kind] : after]):
                continue
            if self.is_sound(after) or (kind not in b"RO" and self.is_followed(after)):
                return int(place)
            if kind == ADDED and self._is_subscription(body, after):
                return int(place)
        return -1

    def _is_subscription(self, body: int, end: int) -> bool:
        """Whether a topic of a known format is subscribed, and data of an id that nobody knows follow.

        So it is where the subscriptions before it are lost.
        """
        kind, data, after = self.head(end)
        named = bytes(self.view[body + 3 : end]) in self.topics
        return named and kind == DATA and data + 2 <= after <= self.stop

    def _id(self, body: int) -> int:
        return self.view[body] | self.view[body + 1] << 8

    def _fits(self, body: int, end: int) -> bool:
        if end - body < 2:
            return False
        number = self._id(body)
        return bool(self.sizes.least[number] <= end - body - 2 <= self.sizes.most[number])

    def _window_at(self, at: int) -> _Window:
        if self._window is None or not self._window.start <= at < self._window.end:
            self._reach = FIRST_WINDOW_BYTES if self._window is None else min(4 * self._reach, WINDOW_BYTES)
            self._window = self._candidates(at, min(at + self._reach, self.stop))
        return self._window

    def _candidates(self, start: int, end: int) -> _Window:
        data: Bytes = self.data
        places = np.flatnonzero(data[start + 2 : end + 2] == DATA).astype(np.int64) + start
        places = places[places + 5 <= self.stop]
        size = numbers(data, places, "<u2").astype(np.int64)
        number = numbers(data, places + 3, "<u2")
        fits = (size - 2 >= self.sizes.least[number]) & (size - 2 <= self.sizes.most[number])
        fits &= places + HEAD_BYTES + size <= self.stop
        places = places[fits]
        number = number[fits]
        stop = places + HEAD_BYTES + size[fits]
        breaks = np.append(np.flatnonzero(stop[:-1] != places[1:]), max(len(places) - 1, 0))
        run_end = np.repeat(breaks, np.diff(breaks, prepend=-1))[: len(places)]
        return _Window(start, end, places, stop, self.sizes.subscription[number].astype(np.int64), run_end)


def is_text(body: memoryview) -> bool:
    """Whether a logged message may be text: short, no control characters."""
    return len(body) <= MAX_TEXT and min(body, default=32) >= 9


def has_shape(kind: int, body: memoryview) -> bool:
    """Whether the payload of a record other than data is built as its type asks."""
    size = len(body)
    if kind == SYNC_TYPE:
        return bytes(body) == SYNC
    if kind in b"RO":
        return size == 2
    if kind == FLAGS:
        return 40 <= size <= 64
    if kind == ADDED:
        return _NAME.fullmatch(body, 3) is not None
    if kind == LOGGED:
        return size >= 9 and 48 <= body[0] <= 55
    if kind == TAGGED:
        return size >= 11 and 48 <= body[0] <= 55
    if kind == FORMAT_TYPE:
        return _FORMAT.fullmatch(bytes(body)) is not None
    return _has_key(body[1:] if kind in b"MQ" else body)


def _has_key(body: memoryview) -> bool:
    """u8 length, "type name", value."""
    if len(body) < 2 or not 3 <= body[0] < len(body):
        return False
    return _value_size(bytes(body[1 : 1 + body[0]])) is not None


def _has_its_value(body: memoryview) -> bool:
    """Whether the value behind a key has the size of its type; any size where the type is unknown."""
    size = _value_size(bytes(body[1 : 1 + body[0]]))
    return size in (ANY_SIZE, len(body) - 1 - body[0])


@lru_cache(maxsize=MAX_KEYS)
def _value_size(key: bytes) -> int | None:
    """Bytes of the value behind "type name", or ANY_SIZE; None where this is no key."""
    if _KEY.fullmatch(key) is None:
        return None
    found = _SIZED.match(key)
    kind = NUMBERS.get(found[1].decode("latin-1")) if found else None
    return ANY_SIZE if found is None or kind is None else np.dtype(kind).itemsize * int(found[2] or 1)
