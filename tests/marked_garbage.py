"""Garbage that is dense with what records begin with, and the processor time that a reader spends on it."""

from __future__ import annotations

import contextlib
import random
import time
from collections.abc import Callable, Mapping

from flysid.errors import FormatError
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import FORMATS
from tests.format_trials import sample
from tests.samplelogs.dataflash import TYPES

MARKS: Mapping[str, tuple[bytes, ...]] = {
    "blackbox": (b"H Product", b"\nI", b"P", b"E\0", b"S"),
    "crazyflie": (b"\xff",),
    "dataflash": (b"\xa3\x95", *(b"\xa3\x95" + bytes([number]) for number in TYPES)),
    "mcap": tuple(bytes([op, 0x40]) + bytes(7) for op in (3, 4, 5, 6)),
    "navdata": (b"\x88\x77\x66\x55", b"\x89\x77\x66\x55"),
    "rosbag": (b"\x20\0\0\0\4\0\0\0op=\2", b"op=\5"),
    "tlog": (b"\xfd\x09\0\0", b"\xfe\x1c"),
    "ulog": (b"\x08\0D\0\0", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"),
}
Garbage = Callable[[str, int, random.Random], bytes]
MARK_EVERY = (6, 9, 16)
SECONDS_A_MB = 0.05


def marked(name: str, size: int, rng: random.Random) -> bytes:
    """Random bytes with a mark of the format every few bytes."""
    out = bytearray(rng.randbytes(size))
    step = rng.choice(MARK_EVERY)
    for at in range(0, size - 2 * max(MARK_EVERY), step):
        mark = rng.choice(MARKS[name])
        out[at : at + len(mark)] = mark
    return bytes(out)


def runs_of(name: str, size: int, rng: random.Random) -> bytes:  # noqa: ARG001 - as `marked`
    """Each mark of the format, and each of its letters, over and over."""
    marks = MARKS[name]
    every = [*marks, *(bytes([letter]) for letter in sorted(set(b"".join(marks))))]
    return b"".join((mark * size)[: size // len(every)] for mark in every)


def seconds_a_mb(name: str, size: int, rng: random.Random, garbage: Garbage = marked) -> float:
    """Processor seconds a megabyte of garbage inside a sound log, the best of two readings."""
    sound = sample(name)
    middle = len(sound) // 2
    times = []
    for blob in (sound, sound[:middle] + garbage(name, size, rng) + sound[middle:]) * 2:
        began = time.process_time()
        with contextlib.suppress(FormatError):
            collect(memoryview(blob), "log", FORMATS[name], Limits())
        times.append(time.process_time() - began)
    return max(0.0, min(times[1::2]) - min(times[::2])) / (size / 1e6)
