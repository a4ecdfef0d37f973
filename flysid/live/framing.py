"""Cut one peer's bytes into frames as they arrive; an unfinished frame waits for its rest.

Bytes that belong to no frame are given out as well. A frame whose id is unknown has no checksum that could be
judged: it is taken only directly behind a frame, and where its datagram ends with it or a frame
that holds follows.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flysid.ingest.formats.mavlink.dialect import UNKNOWN, load_dialect
from flysid.ingest.formats.mavlink.frames import MARKER, SIGNED, V1, V2, is_checked, read_header
from flysid.ingest.formats.mavlink.kernel import crc_tables, walk
from flysid.live.batches import Arrival, ByteArray, IntArray

# PX4's and ArduPilot's messages; "all" holds every published dialect's, also those of "development".
LIVE_DIALECT = "all"


@dataclass(frozen=True, eq=False)
class Cut:
    """What a stretch of bytes holds.

    `raw`: the stretch, with what was kept from before in front.
    `starts`: (n,) the frames' markers in `raw`.
    `ends`, `stamps_us`: (m,) ends of the datagrams in `raw`, and their times of arrival.
    `rejected`: bytes that belong to no frame.
    `bad_checksums`: frames among them that follow a frame exactly, and whose checksum is wrong.
    """

    raw: ByteArray
    starts: IntArray
    ends: IntArray
    stamps_us: IntArray
    rejected: bytes
    bad_checksums: int


@dataclass
class Framer:
    """Cuts the bytes of one peer into frames.

    `datagrams`: whether bytes come in datagrams; frames may be spread over several.
    """

    datagrams: bool
    _kept: bytes = b""
    _after_frame: bool = True  # a frame ends where the next bytes begin, or nothing was there yet
    _room: IntArray = field(default_factory=lambda: np.empty(1 << 14, np.int64))

    def __post_init__(self) -> None:
        self._extra = load_dialect(LIVE_DIALECT).crc_extra
        self._tables = crc_tables()
        self._ends = np.zeros(1, np.int64)
        self._stamps = np.zeros(1, np.int64)

    def cut(self, arrival: Arrival, *, last: bool = False) -> Cut:
        """The frames of what has arrived, and of what was kept; nothing more will come after the `last`."""
        raw = arrival.raw
        ends = arrival.ends
        if self._kept:
            raw = np.concatenate([np.frombuffer(self._kept, np.uint8), raw])
            ends = ends + len(self._kept)
        size = len(raw)
        position = 0
        lost = 0
        starts: list[IntArray] = []
        rejected: list[bytes] = []
        bad = 0
        self._kept = b""
        self._ends = np.array([0])
        self._stamps = arrival.stamps_us[-1:]
        while position < size:
            before = position
            count, position = walk(raw, position, size, 0, self._extra, self._tables, self._room)
            found = self._room[:count].copy()
            if not count and self._after_frame:
                found, position = self._unchecked(raw, position, ends)
            if len(found):
                starts.append(found)
                rejected.append(raw[lost:before].tobytes())
                lost = position
                self._after_frame = True
                continue
            if may_grow(raw, position) and not last:
                self._kept = raw[position:].tobytes()
                break
            bad += self._after_frame and read_header(raw.data, position) is not None
            self._after_frame = False
            position = _next_marker(raw, position + 1)
        rejected.append(raw[lost : size - len(self._kept)].tobytes())
        found = np.concatenate(starts) if starts else np.empty(0, np.int64)
        return Cut(raw, found, ends, arrival.stamps_us, b"".join(rejected), bad)

    def finish(self) -> Cut:
        """What is kept, now that nothing completes it: what looked like a frame may hide others."""
        return self.cut(Arrival(b"", np.empty(0, np.uint8), self._ends, self._stamps), last=True)

    def _unchecked(self, raw: ByteArray, position: int, ends: IntArray) -> tuple[IntArray, int]:
        """A frame of an unknown id at `position`, if its surroundings speak for it; and where it ends."""
        nothing = np.empty(0, np.int64), position
        head = read_header(raw.data, position)
        if head is None or (head.message < len(self._extra) and self._extra[head.message] != UNKNOWN):
            return nothing
        ends_well = self.datagrams and head.end == ends[np.searchsorted(ends, position, "right")]
        if ends_well or is_checked(raw.data, head.end, self._extra):
            return np.array([position], np.int64), head.end
        return nothing


def may_grow(raw: ByteArray, position: int) -> bool:
    """Whether a frame may have begun at `position` that more bytes would complete."""
    if raw[position] not in (V1, V2):
        return False
    if raw[position] == V2 and position + 2 < len(raw) and raw[position + 2] > SIGNED:
        return False
    return read_header(raw.data, position) is None


def _next_marker(raw: ByteArray, position: int) -> int:
    found = MARKER.search(raw.data, position)
    return found.start() if found else len(raw)
