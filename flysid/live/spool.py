"""Records of a tlog on their way from the thread that receives to the one that writes."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

from flysid.ingest.formats.mavlink.frames import STAMP_BYTES, read_header


@dataclass(frozen=True)
class SpoolPiece:
    """Whole records of a tlog, or bytes that are no frame.

    `content`: the bytes.
    `frames`: how many records they hold; 0 for bytes that are no frame.
    `boots`: a vehicle was started anew: what follows may begin a new part.
    `peer`: who sent it, a number.
    """

    content: bytes
    frames: int
    boots: bool = False
    peer: int = 0


class Spool:
    """Pieces that wait to be written; beyond `limit` bytes the oldest go, and are counted."""

    def __init__(self, limit: int = 64 << 20) -> None:
        self.peak_bytes = 0
        self.dropped_frames = 0
        self._limit = limit
        self._pieces: deque[SpoolPiece] = deque()
        self._bytes = 0
        self._guard = threading.Lock()

    def put(self, piece: SpoolPiece) -> None:
        """Add a piece; never waits."""
        with self._guard:
            self._pieces.append(piece)
            self._bytes += len(piece.content)
            while self._bytes > self._limit and len(self._pieces) > 1:
                gone = self._pieces.popleft()
                self._bytes -= len(gone.content)
                self.dropped_frames += gone.frames
            self.peak_bytes = max(self.peak_bytes, self._bytes)

    def take(self) -> list[SpoolPiece]:
        """All that waits, oldest first."""
        with self._guard:
            pieces = list(self._pieces)
            self._pieces.clear()
            self._bytes = 0
        return pieces


def whole_records(content: bytes, size: int) -> tuple[int, int]:
    """Bytes and number of the records that `size` bytes hold whole."""
    at = count = 0
    while at + STAMP_BYTES < size:
        head = read_header(content[:size], at + STAMP_BYTES)
        if head is None:
            break
        at = head.end
        count += 1
    return at, count
