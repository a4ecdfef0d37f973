"""What is decided on a sample: do frames chain, do stamps precede them, which dialect knows them?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from flysid.ingest.formats.base import HEAD_BYTES
from flysid.ingest.formats.common.columns import as_array
from flysid.ingest.formats.mavlink.checksums import is_valid, seed_of
from flysid.ingest.formats.mavlink.dialect import DEFAULT, OTHERS, UNKNOWN, load_dialect
from flysid.ingest.formats.mavlink.frames import (
    MARKER,
    STAMP_BYTES,
    V1,
    V2,
    Chain,
    Scanner,
    plain_chain,
    read_header,
)

LEAST_ALIKE = 3  # frames that hold with one seed by chance: once in 65,536 for each behind the first
COMPILE_ABOVE_BYTES = 64 << 20  # the compiled walk takes 1 s to load and saves 14 ms a megabyte


def may_chain(head: bytes, stamp: int, stop: int = 16384) -> bool:
    """Cheap test before the dialect is imported: do three markers follow one another by their lengths?"""
    for match in MARKER.finditer(head, stamp if stamp else 0, stop):
        at = match.start()
        hops = 0
        while hops < 3 and at + 8 <= len(head) and head[at] in (V1, V2):
            is_v2 = head[at] == V2
            if is_v2 and head[at + 2] > 1:
                break
            at += head[at + 1] + (12 + 13 * (head[at + 2] & 1) if is_v2 else 8)
            hops += 1
            if at == len(head) or hops == 3:
                return True
            at += stamp
    return False


def first_stamp_bytes(view: memoryview) -> int:
    """`_stamp_bytes` where the frames begin: garbage ahead of them would decide by chance."""
    for start in range(
        0, len(view), HEAD_BYTES // 2
    ):  # half of each stretch again: frames may begin at its end
        stretch = bytes(view[start : start + HEAD_BYTES])
        if any(may_chain(stretch, stamp, len(stretch)) for stamp in (STAMP_BYTES, 0)):
            stamp = stamp_bytes(stretch)
            if count_frames(stretch, stamp)[0] >= 3:
                return stamp
    return stamp_bytes(bytes(view[:HEAD_BYTES]))


def stamp_bytes(head: bytes) -> int:
    """8 where frames with timestamps chain better than frames without, else 0."""
    frames, chained = count_frames(head, STAMP_BYTES)
    if frames >= 3 and chained >= 0.9 * frames:
        return STAMP_BYTES
    return STAMP_BYTES if chained >= count_frames(head, 0)[1] else 0


@lru_cache(maxsize=4)
def count_frames(head: bytes, stamp: int) -> tuple[int, int]:
    """(valid frames, valid frames less lost regions) in `head` under one hypothesis."""
    scanner = make_scanner(DEFAULT, stamp)
    frames, _ = scanner.scan(as_array(head), 0, len(head))
    return len(frames), len(frames) - scanner.region_count - scanner.unstamped


def make_scanner(
    dialect: str, stamp: int, size: int = 0, private: Mapping[int, int] | None = None
) -> Scanner:
    """A scanner for a log of `size` bytes: large ones are walked by compiled code.

    `private`: see `private_seeds`; these messages are as unknown as those of unknown ids.
    """
    numbers = frozenset(private or ())
    chain = (_compiled_chain if size > COMPILE_ABOVE_BYTES else _plain_chain)(dialect, numbers)
    return Scanner(_seeds_without(dialect, numbers), stamp, chain, private=private or {})


@lru_cache(maxsize=16)
def _seeds_without(dialect: str, numbers: frozenset[int]) -> npt.NDArray[np.int16]:
    """The seeds of a dialect, less those of some messages."""
    seeds = load_dialect(dialect).crc_extra
    if not numbers:
        return seeds
    seeds = seeds.copy()
    seeds[list(numbers)] = UNKNOWN
    seeds.setflags(write=False)
    return seeds


@lru_cache(maxsize=16)
def _compiled_chain(dialect: str, numbers: frozenset[int]) -> Chain:
    from flysid.ingest.formats.mavlink.kernel import compiled_chain

    return compiled_chain(_seeds_without(dialect, numbers))


@lru_cache(maxsize=16)
def _plain_chain(dialect: str, numbers: frozenset[int]) -> Chain:
    return plain_chain(_seeds_without(dialect, numbers))


def knowing_scanner(sample: bytes, stamp: int, size: int) -> tuple[str, Scanner]:
    """The dialect that knows most of a log that begins so, and a scanner for it."""
    dialect = choose_dialect(sample, stamp)
    return dialect, make_scanner(dialect, stamp, size, private_seeds(sample, stamp, dialect))


def private_seeds(sample: bytes, stamp: int, dialect: str) -> Mapping[int, int]:
    """Messages that a private dialect defines under a number of this one: their seeds, by number.

    Such a message fails the checksum of the message that bears its number here, always, and holds with one
    other seed, always. What damage leaves holds with a given seed once in 65,536.
    """
    known = load_dialect(dialect).crc_extra
    seeds: dict[int, Counter[int]] = {}
    shipped: set[int] = set()
    for match in MARKER.finditer(sample):
        q = match.start()
        head = read_header(sample, q)
        if head is None or head.message >= len(known) or known[head.message] == UNKNOWN:
            continue
        after = head.end + stamp
        if head.message in shipped or (after < len(sample) and sample[after] not in (V1, V2)):
            continue
        if is_valid(sample, q, head, int(known[head.message])):
            shipped.add(head.message)
        elif (seed := seed_of(sample, q, head)) >= 0:
            seeds.setdefault(head.message, Counter())[seed] += 1
    most = {number: found.most_common(1)[0] for number, found in seeds.items() if number not in shipped}
    return {number: seed for number, (seed, count) in most.items() if count >= LEAST_ALIKE}


def choose_dialect(sample: bytes, stamp: int) -> str:
    """ardupilotmega unless another dialect knows, and finds valid, more frames.

    What no seed of a CRC explains fails in every dialect: others, slow to import, decide the rest.
    """
    valid = {}
    for name in (DEFAULT, *OTHERS):
        scanner = make_scanner(name, stamp)
        frames, _ = scanner.scan(as_array(sample), 0, len(sample))
        valid[name] = len(frames) - sum(scanner.unknown.values())
        if not scanner.foreign:
            break
    return max(valid, key=lambda name: valid[name])
