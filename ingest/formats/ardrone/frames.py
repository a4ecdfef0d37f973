"""Finding AR.Drone navdata packets and checking them, all packets of one make-up at once.

A packet is u32 0x55667788 (or ...89), u32 state, u32 sequence, u32 vision flag, then options of u16 tag,
u16 size (these four bytes included) and body; the last has tag 0xFFFF and holds the sum of all bytes before
it. Packets of a flight have few make-ups (which options of which sizes), so one is parsed, and all others
that carry the same tags and sizes at the same places are checked and summed as one matrix.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from flysid.ingest.formats.ardrone.layouts import CHECKSUM_TAG
from flysid.ingest.formats.common.gather import Bytes, Index, rows

HEAD_BYTES = 16
MAX_PACKET_BYTES = 1 << 16
MAX_OPTIONS = 200
MAX_MAKEUPS = 512
HEADERS = (b"\x88\x77\x66\x55", b"\x89\x77\x66\x55")


class Fate(IntEnum):
    """What became of a place that could begin a packet."""

    GOOD = 0
    BAD_SUM = 1
    BROKEN = 2
    CUT = 3


@dataclass(frozen=True)
class MakeUp:
    """Places (from the packet's start) and sizes of the bodies of its options, and its length."""

    options: Mapping[int, tuple[int, int]]
    heads: tuple[int, ...]
    size: int


@dataclass(frozen=True)
class Packets:
    """Packets of one make-up: their places, in file order, (n,)."""

    makeup: MakeUp
    at: Index


@dataclass(frozen=True)
class Sorted:
    """Good packets by make-up, and what became of every candidate: GOOD, BAD_SUM, BROKEN or CUT, (n,)."""

    groups: tuple[Packets, ...]
    fate: NDArray[np.uint8]
    end: Index


def find_headers(data: Bytes, start: int, stop: int) -> Index:
    """Places in [start, stop) where a packet may begin."""
    low = np.flatnonzero((data[start:stop] & 0xFE) == 0x88) + start
    low = low[low + 4 <= len(data)]
    fits = (data[low + 1] == 0x77) & (data[low + 2] == 0x66) & (data[low + 3] == 0x55)
    found: Index = low[fits].astype(np.int64)
    return found


def parse_makeup(data: Bytes, at: int, stop: int) -> MakeUp | None:
    """The make-up of the packet at `at`; None where its options do not end with a checksum before `stop`.

    Raises
    ------
    EOFError : the options run past `stop`.
    """
    options: dict[int, tuple[int, int]] = {}
    heads: list[int] = []
    place = at + HEAD_BYTES
    window = data.data
    for _ in range(MAX_OPTIONS):
        if place + 4 > stop:
            raise EOFError
        tag, size = struct.unpack_from("<HH", window, place)
        if size < 4 or place + size - at > MAX_PACKET_BYTES:
            return None
        heads.append(place - at)
        options.setdefault(tag, (place + 4 - at, size - 4))
        place += size
        if tag == CHECKSUM_TAG:
            if size != 8:
                return None
            if place > stop:
                raise EOFError
            return MakeUp(options, tuple(heads), place - at)
    return None


def sort_packets(data: Bytes, at: Index, stop: Index) -> Sorted:
    """Check the candidates at `at`, each of which must end by its own `stop`; both (n,)."""
    fate = np.full(len(at), Fate.BROKEN, dtype=np.uint8)
    end = at.copy()
    todo = np.arange(len(at))
    groups = []
    for _ in range(MAX_MAKEUPS):
        if not len(todo):
            break
        first = int(todo[0])
        try:
            makeup = parse_makeup(data, int(at[first]), int(stop[first]))
        except EOFError:
            makeup = None
            fate[first] = Fate.CUT
        if makeup is None:
            todo = todo[1:]
            continue
        alike = _alike(data, at, stop, (todo, first, makeup))
        same = todo[alike]
        good = same[_sums(data, at[same], makeup)]
        fate[same] = Fate.BAD_SUM
        fate[good] = Fate.GOOD
        end[same] = at[same] + makeup.size
        groups.append(Packets(makeup, at[good]))
        todo = todo[~alike]
    return Sorted(tuple(g for g in groups if len(g.at)), fate, end)


def _alike(data: Bytes, at: Index, stop: Index, among: tuple[Index, int, MakeUp]) -> NDArray[np.bool_]:
    """Which of the candidates have the same option heads at the same places as candidate `first`."""
    todo, first, makeup = among
    fits = at[todo] + makeup.size <= stop[todo]
    places = np.add.outer(np.array(makeup.heads), np.arange(4)).reshape(-1)
    model = data[at[first] + places]
    safe = np.where(fits, at[todo], at[first])
    same: NDArray[np.bool_] = fits & (data[safe[:, None] + places] == model).all(axis=1)
    return same


def _sums(data: Bytes, at: Index, makeup: MakeUp) -> NDArray[np.bool_]:
    """Which packets add up to their checksums."""
    matrix = rows(data, at, makeup.size).view(np.uint8).reshape(len(at), makeup.size)
    total = matrix[:, :-8].sum(axis=1, dtype=np.uint32)
    stated = np.ascontiguousarray(matrix[:, -4:]).view("<u4")[:, 0]
    equal: NDArray[np.bool_] = total == stated
    return equal
