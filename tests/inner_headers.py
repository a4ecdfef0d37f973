"""Headers planted inside the messages of sound DataFlash logs: nothing may be lost, nothing invented.

Every trial is a log of its own: kinds of random formats, rising times, and in one message the bytes A3 95 and
an id, at any place behind the message's header; often so that the inner message would end where the outer one
does, sometimes with a time that would be in order. A header that reaches into TimeUS shifts the whole log,
so that the time it makes is the right one.
"""

from __future__ import annotations

import random
import struct
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.dataflash.frames import Walker
from flysid.ingest.formats.dataflash.layouts import FMT_ID, packed_length
from flysid.ingest.formats.registry import FORMATS
from soak import Outcome
from tests.format_trials import Ask
from tests.samplelogs.dataflash import fmt, pack

HEAD = b"\xa3\x95"
TIME_AT = 3
TIME_END = 11
LONGEST_US = 1 << 41  # 25 days: no vehicle is up for longer


@dataclass
class Message:
    """One message: its id, its time, and what stands behind the time."""

    number: int
    time_us: int
    rest: bytes

    def packed(self, shift_us: int) -> bytes:
        """Its bytes in a log whose times are shifted."""
        return HEAD + bytes([self.number]) + struct.pack("<Q", self.time_us + shift_us) + self.rest


def make_kinds(rng: random.Random) -> dict[int, str]:
    """Message id -> format: TimeUS, then anything."""
    numbers = rng.sample([n for n in range(256) if n != FMT_ID], rng.randrange(3, 60))
    return {number: _make_format(rng) for number in numbers}


def _make_format(rng: random.Random) -> str:
    """A format of 255 bytes at most."""
    form = "Q" + "".join(rng.choices("bBhHiIfdcCeELMqQnNZ", k=rng.randrange(1, 15)))
    while packed_length(form) > 255:
        form = form[:-1]
    return form


def make_messages(rng: random.Random, kinds: dict[int, str]) -> list[Message]:
    """Messages with rising times; what they hold is random, or mostly zeros."""
    time_us = rng.choice((0, rng.randrange(10**6), rng.randrange(10**10)))
    found = []
    for _ in range(rng.randrange(8, 60)):
        number = rng.choice(list(kinds))
        size = packed_length(kinds[number]) - TIME_END
        rest = (
            rng.randbytes(size)
            if rng.random() < 0.5
            else bytes(rng.choice((0, 0, 0, 1)) for _ in range(size))
        )
        found.append(Message(number, time_us, rest))
        time_us += rng.choice((0, 17, 2500, 20_000, 1_000_000, 3_000_000))
    return found


def plant(rng: random.Random, kinds: dict[int, str], messages: list[Message]) -> int:
    """Write a header into one of the messages; returns by how many microseconds the log must be shifted."""
    victim = rng.choice([messages[0], messages[-1], *messages])
    raw = bytearray(victim.packed(0))
    number = rng.choice([*kinds, FMT_ID, rng.randrange(256)])
    ends_there = len(raw) - (packed_length(kinds[number]) if number in kinds else 89)
    place = ends_there if TIME_AT <= ends_there <= len(raw) - 3 and rng.random() < 0.7 else -1
    place = rng.randrange(TIME_AT, len(raw) - 2) if place < 0 else place
    raw[place : place + 3] = HEAD + bytes([number])
    if place >= TIME_END and place + 11 <= len(raw) and rng.random() < 0.3:
        raw[place + 3 : place + 11] = struct.pack("<Q", victim.time_us)
    (time_us,) = struct.unpack_from("<Q", raw, TIME_AT)
    shift_us = int(time_us) - victim.time_us
    if messages[0].time_us + shift_us < 0 or messages[-1].time_us + shift_us > LONGEST_US:
        return plant(rng, kinds, messages)
    victim.rest = bytes(raw[TIME_END:])
    return shift_us


def trial(rng: random.Random) -> tuple[int, int, int, bool]:
    """Rows of one log, rows lost, rows invented, and whether damage was reported."""
    kinds = make_kinds(rng)
    messages = make_messages(rng, kinds)
    shift_us = plant(rng, kinds, messages)
    names = {number: f"K{number:02X}" for number in kinds}
    labels = {n: ",".join(["TimeUS", *(f"f{i}" for i in range(1, len(form)))]) for n, form in kinds.items()}
    head = fmt(FMT_ID) + b"".join(
        pack(FMT_ID, n, packed_length(form), names[n], form, labels[n]) for n, form in kinds.items()
    )
    blob = head + b"".join(message.packed(shift_us) for message in messages)
    limits = Limits(batch_bytes=rng.choice((256, 1024, 1 << 20)))
    flight = collect(memoryview(blob), "planted.bin", FORMATS["dataflash"], limits)
    truth = Counter((names[m.number], m.time_us + shift_us) for m in messages)
    truth["FMT", 0] = len(kinds) + 1
    found: Counter[tuple[str, int]] = Counter()
    for stream, table in flight.tables.items():
        times = table["TimeUS"].to_pylist() if stream != "FMT" else [0] * table.num_rows
        found.update((stream, time_us) for time_us in times)
    return truth.total(), (truth - found).total(), (found - truth).total(), flight.damage.lossy


def plant_headers(count: int, goes_on: Ask) -> Outcome:
    """`count` logs of random kinds, each with one header planted."""
    outcome = Outcome("logs of random formats")
    rng = random.Random("headers")
    while outcome.trials < count and goes_on():
        seed = rng.getrandbits(64)
        with outcome.trial():
            rows, lost, invented, lossy = trial(random.Random(seed))
        outcome.keep(rows - lost, rows)
        if lost or invented or lossy:
            outcome.failures.append(f"seed {seed}: {lost} lost, {invented} invented, lossy is {lossy}")
    return outcome


def plant_in_log(path: Path, count: int, goes_on: Ask) -> Outcome:
    """`count` times a header of a known id planted behind the time of a message of a real log."""
    outcome = Outcome(path.name)
    rng = random.Random(path.name)
    blob = path.read_bytes()
    starts, lengths, damage = _walked(blob)
    known = [number for number, length in lengths.items() if length]
    victims = [int(s) for s in starts if blob[s + 2] != FMT_ID and lengths[blob[s + 2]] > TIME_END + 3]
    while outcome.trials < count and goes_on():
        at = rng.choice(victims)
        number = rng.choice(known)
        size = lengths[blob[at + 2]]
        ends_there = size - lengths[number]
        place = ends_there if TIME_END <= ends_there <= size - 3 else rng.randrange(TIME_END, size - 2)
        changed = bytearray(blob)
        changed[at + place : at + place + 3] = HEAD + bytes([number])
        with outcome.trial():
            found, _, now = _walked(bytes(changed))
        outcome.keep(int(np.isin(starts, found).sum()), len(starts))
        if not np.array_equal(found, starts) or now != damage:
            outcome.failures.append(f"id {number} at {at + place} in the message at {at}")
    return outcome


def _walked(blob: bytes) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], dict[int, int], int]:
    """Where messages begin, the lengths of their ids, and how many bytes are none."""
    walker = Walker()
    messages, _ = walker.walk(memoryview(blob), 0, len(blob))
    lengths = dict(enumerate(walker.lengths.tolist()))
    return messages.start, lengths, walker.damage().bytes_skipped
