"""A small fuzzer for readers: mutations, checksums made right again, kept where they reach new code.

Coverage is that of blocks inside `ingest/` and the magnitude of their counts (`instrument`). A mutation that
reaches a new one joins the corpus and is mutated further. Checksums are repaired, as otherwise every mutation
would end at them.
"""

from __future__ import annotations

import random
import signal
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from types import FrameType
from typing import Any

import fastcrc

MAX_BYTES = 60_000
HANG_S = 20
NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)


class Corpus:
    """Inputs that reached new blocks, newest last, and the blocks reached so far."""

    def __init__(self, seeds: list[bytes], rng: random.Random) -> None:
        self.inputs = list(seeds)
        self._rng = rng
        self._seen: set[tuple[int, int]] = set()

    @property
    def blocks(self) -> int:
        """How many have been reached."""
        return len({place for place, _ in self._seen})

    def propose(self, repair: Callable[[bytearray], None]) -> bytes:
        """A mutated input; new ones are mutated more often than old ones."""
        rng = self._rng
        recent = self.inputs[-8:] if rng.random() < 0.5 else self.inputs
        blob = bytearray(rng.choice(recent))
        for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
            mutate(blob, rng, self.inputs)
        del blob[MAX_BYTES:]
        if rng.random() < 0.9:
            repair(blob)
        return bytes(blob)

    def judge(self, blob: bytes, taken: set[tuple[int, int]]) -> None:
        """Keep an input that reached a block, or reached it much more often than ever."""
        if not taken <= self._seen:
            self._seen |= taken
            self.inputs.append(blob)


def mutate(blob: bytearray, rng: random.Random, others: list[bytes]) -> None:
    """One change in place."""
    if not blob:
        blob += rng.randbytes(8)
    at = rng.randrange(len(blob))
    kind = rng.randrange(8)
    span = min(len(blob) - at, rng.choice((1, 2, 4, 8, 16, 64, 512)))
    if kind == 0:
        blob[at] ^= 1 << rng.randrange(8)
    elif kind == 1:
        blob[at] = rng.randrange(256)
    elif kind == 2:
        width = rng.choice((1, 2, 4, 8))
        number = rng.choice(NUMBERS) & (1 << 8 * width) - 1
        blob[at : at + width] = number.to_bytes(width, rng.choice(("little", "big")))
    elif kind == 3:
        del blob[at : at + span]
    elif kind == 4:
        blob[at:at] = blob[at : at + span]
    elif kind == 5:
        blob[at : at + span] = rng.randbytes(span)
    elif kind == 6:
        other = rng.choice(others)
        start = rng.randrange(len(other) or 1)
        blob[at : at + span] = other[start : start + span]
    else:
        blob[at:at] = rng.randbytes(rng.choice((1, 3, 16)))


@contextmanager
def no_longer_than(seconds: int) -> Iterator[None]:
    """Raise TimeoutError inside a block that does not end."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"not done after {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


# ------------------------------------------------------------------------------- checksums made right


def repair_mavlink(blob: bytearray) -> None:
    """The CRC of every frame, as far as frames chain by their lengths or a marker follows."""
    extra = _crc_extra()
    at = 0
    while at < len(blob) - 8:
        size = blob[at + 1]
        if blob[at] == 0xFE:
            head = 6
            message = blob[at + 5]
        elif blob[at] == 0xFD and at + 10 <= len(blob):
            head = 10
            message = int.from_bytes(blob[at + 7 : at + 10], "little")
        else:
            at += 1
            continue
        end = at + head + size
        seed = int(extra[message]) if message < len(extra) else -1
        if seed < 0 or end + 2 > len(blob):
            at += 1
            continue
        crc = fastcrc.crc16.mcrf4xx(bytes(blob[at + 1 : end]) + bytes([seed & 0xFF]))
        struct.pack_into("<H", blob, end, crc)
        at = end + 2


@cache
def _crc_extra() -> Any:
    from flysid.ingest.formats.mavlink.dialect import load_dialect  # not before `instrument` can count

    return load_dialect().crc_extra


def repair_navdata(blob: bytearray) -> None:
    """The sum of every packet whose options chain up to the checksum option."""
    at = 0
    while (at := blob.find(b"\x55", at + 1)) > 0:
        start = at - 3
        if start < 0 or blob[start + 1 : at + 1] != b"\x77\x66\x55":
            continue
        place = start + 16
        while place + 8 <= len(blob):
            tag, size = struct.unpack_from("<HH", blob, place)
            if tag == 0xFFFF:
                struct.pack_into("<I", blob, place + 4, sum(blob[start:place]) & 0xFFFFFFFF)
                break
            if size < 4:
                break
            place += size


def repair_mcap(blob: bytearray) -> None:
    """No checksum at all: 0 means that none was written."""
    at = 8
    while at + 9 <= len(blob):
        op, size = struct.unpack_from("<BQ", blob, at)
        body = at + 9
        if op == 6 and body + 28 <= len(blob):
            struct.pack_into("<I", blob, body + 24, 0)
        elif op == 2 and body + 20 <= len(blob):
            struct.pack_into("<I", blob, body + 16, 0)
        elif op == 15 and body + 4 <= len(blob):
            struct.pack_into("<I", blob, body, 0)
        if size > len(blob):
            return
        at = body + size


def leave(blob: bytearray) -> None:
    """The format has no checksums."""


REPAIR: Mapping[str, Callable[[bytearray], None]] = {
    "tlog": repair_mavlink,
    "navdata": repair_navdata,
    "mcap": repair_mcap,
}
