"""Bytes out of packets, and where in the file they lie: damage to them is located in the file."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Located:
    """Bytes that a file holds in one piece, or in several.

    Attributes
    ----------
    data : the bytes of all pieces, one behind the other.
    spans : place in the file and size of every piece.
    """

    data: bytes = b""
    spans: tuple[tuple[int, int], ...] = ()

    def __len__(self) -> int:
        return len(self.data)

    def __add__(self, other: Located) -> Located:
        return Located(self.data + other.data, self.spans + other.spans)

    def cut(self, start: int, stop: int) -> Located:
        """The bytes [start, stop), as far as there are any."""
        spans = []
        at = 0
        for place, size in self.spans:
            first = max(start - at, 0)
            last = min(stop - at, size)
            if first < last:
                spans.append((place + first, last - first))
            at += size
        return Located(self.data[start:stop], tuple(spans))
