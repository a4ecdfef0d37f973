"""Damage done to the sample log of a format, trial by trial, and what a reader must keep.

The contract tests run these at a small size, `soak` at the full size of the catalogue. Every function
fills an Outcome; its `failures` say where a promise was broken. `goes_on` is asked before each trial.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

from flysid.errors import FormatError
from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import all_formats
from soak import Outcome
from tests.samplelogs import Record, record_at, sample_modules

SAMPLES = {name: module for name, module in sample_modules().items() if hasattr(module, "build")}
FORMATS = sorted(set(all_formats()) & set(SAMPLES))
CARRIED = sorted(name for name, module in SAMPLES.items() if hasattr(module, "FORMAT"))  # in captures
Ask = Callable[[], bool]


def module_of(name: str) -> ModuleType:
    """The module of a format's sample log."""
    return SAMPLES[name]


@cache
def sample(name: str) -> bytes:
    """The sample log of a format."""
    blob = module_of(name).build()
    assert isinstance(blob, bytes)
    return blob


@cache
def records_of(name: str) -> list[Record]:
    """Its records, in order."""
    found: list[Record] = module_of(name).records(sample(name))
    return found


@cache
def intact(name: str) -> Flight:
    """The flight in the undamaged sample log."""
    return read(name, sample(name))


def read(name: str, blob: bytes, **limits: Any) -> Flight:
    """The flight in these bytes, by the reader of one format."""
    module = module_of(name)
    fmt = all_formats()[getattr(module, "FORMAT", name)]
    return collect(memoryview(blob), "sample" + module.SUFFIX, fmt, Limits(**limits))


def read_or_none(name: str, blob: bytes, outcome: Outcome) -> Flight | None:
    """The flight; None where the reader says that nothing can be read. Other errors are failures."""
    with outcome.trial():
        try:
            return read(name, blob)
        except FormatError:
            outcome.raised += 1
        except Exception as error:  # noqa: BLE001 - this is what the trials look for
            outcome.failures.append(f"trial {outcome.trials}: {type(error).__name__}: {error}")
    return None


@cache
def at_risk(name: str, byte: int) -> int:
    """Rows that damage to this byte may cost."""
    module = module_of(name)
    if hasattr(module, "at_risk"):
        return int(module.at_risk(sample(name), byte))
    return record_at(records_of(name), byte).rows


def risk_of(name: str, start: int, end: int) -> int:
    """Rows that damage to the bytes [start, end) may cost: of every record that it hits."""
    hit = [r for r in records_of(name) if r.start < end and r.end > start]
    spans = [range(max(start, r.start), min(end, r.end)) for r in hit]
    return sum(max(at_risk(name, byte) for byte in span) for span in spans)


def left_of(name: str, piece: bytes) -> tuple[int, bool]:
    """Rows that can be read of a record of which this piece is left, and whether nothing of them is lost."""
    module = module_of(name)
    return module.left_of(piece) if hasattr(module, "left_of") else (0, False)


def cut(name: str, every: int, goes_on: Ask) -> Outcome:
    """Truncated at every `every`-th byte: all records before the cut stay, and the cut is noticed."""
    outcome = Outcome(name)
    blob = sample(name)
    records = records_of(name)
    borders = sorted({r.end for r in records})
    kept = {0: 0}
    silent = set() if getattr(module_of(name), "KNOWS_ITS_END", False) else set(borders)
    for record in records:
        kept[record.end] = kept[record.start] + record.rows
    at = 0
    for place in range(1, len(blob), every):
        while at < len(borders) and borders[at] <= place:
            at += 1
        if not goes_on():
            break
        begun = borders[at - 1] if at else 0
        more, is_whole = left_of(name, blob[begun:place])
        flight = read_or_none(name, blob[:place], outcome)
        rows = flight.rows if flight is not None else 0
        expected = kept[begun] + (more if flight is not None else 0)
        outcome.keep(rows, expected)
        if rows != expected:
            outcome.failures.append(f"cut at {place}: {rows} rows of {expected}")
        elif flight is not None and flight.damage.truncated == (is_whole or place in silent):
            outcome.failures.append(f"cut at {place}: truncated is {flight.damage.truncated}")
    return outcome


def is_unseen(name: str, start: int, end: int) -> bool:
    """Whether damage to these bytes may lose a record in silence."""
    module = module_of(name)
    return bool(hasattr(module, "unseen") and module.unseen(sample(name), start, end))


def flip(name: str, count: int, goes_on: Ask) -> Outcome:
    """Single bits flipped: at most the record hit is lost, and never in silence."""
    outcome = Outcome(name)
    blob = sample(name)
    rng = random.Random(name)
    whole = intact(name).rows
    for _ in range(count):
        byte = rng.randrange(len(blob))
        bit = rng.randrange(8)
        if not goes_on():
            break
        damaged = bytearray(blob)
        damaged[byte] ^= 1 << bit
        where = f"bit {bit} of byte {byte}"
        flight = read_or_none(name, bytes(damaged), outcome)
        rows = flight.rows if flight is not None else 0
        risk = at_risk(name, byte)
        outcome.keep(rows, whole)
        if rows < whole - risk:
            outcome.failures.append(f"{where}: {rows} rows of {whole}, {risk} at risk")
        elif is_silent(flight, whole) and not is_unseen(name, byte, byte + 1):
            outcome.failures.append(f"{where}: {whole - rows} rows lost in silence")
    return outcome


def is_silent(flight: Flight | None, whole: int) -> bool:
    """Whether rows were lost without a word."""
    return flight is not None and flight.rows < whole and not flight.damage.lossy


def insert(name: str, count: int, goes_on: Ask) -> Outcome:
    """Garbage between two records: all rows stay, and exactly the garbage is skipped."""
    if is_addressed(name):
        return overwrite(name, count, goes_on)
    outcome = Outcome(name)
    blob = sample(name)
    rng = random.Random(name)
    whole = intact(name).rows
    borders = [r.end for r in records_of(name) if r.end < len(blob) and at_risk(name, r.end) < whole]
    harmless = getattr(module_of(name), "HARMLESS", b"")
    for turn in itertools.count():
        at = rng.choice(borders)
        size = rng.choice((1, 7, 64, 511, 4096))
        garbage = bytes(size) if turn % 4 == 0 else rng.randbytes(size)
        if outcome.trials >= count or not goes_on():
            break
        if not garbage.strip(harmless):
            continue
        flight = read_or_none(name, blob[:at] + garbage + blob[at:], outcome)
        outcome.keep(flight.rows if flight is not None else 0, whole)
        if (wrong := _judge_insertion(name, at, size, flight)) is not None:
            outcome.failures.append(f"{size} bytes at {at}: {wrong}")
    return outcome


def is_addressed(name: str) -> bool:
    """Whether records refer to each other by their place, so that nothing may move."""
    return bool(getattr(module_of(name), "ADDRESSED", False))


def overwrite(name: str, count: int, goes_on: Ask) -> Outcome:
    """Records overwritten by garbage or zeros: at most their rows are lost, and never in silence."""
    outcome = Outcome(name)
    blob = sample(name)
    rng = random.Random(name)
    whole = intact(name).rows
    records = records_of(name)
    for turn in range(count):
        first = rng.randrange(len(records))
        hit = records[first : first + rng.choice((1, 1, 1, 2, 8))]
        start = hit[0].start
        end = hit[-1].end
        garbage = bytes(end - start) if turn % 4 == 0 else rng.randbytes(end - start)
        if not goes_on():
            break
        flight = read_or_none(name, blob[:start] + garbage + blob[end:], outcome)
        rows = flight.rows if flight is not None else 0
        outcome.keep(rows, whole)
        if rows < whole - sum(at_risk(name, record.start) for record in hit):
            outcome.failures.append(f"bytes {start} to {end}: {rows} rows of {whole}")
        elif flight is not None and rows < whole and not flight.damage.lossy:
            outcome.failures.append(f"bytes {start} to {end}: rows lost in silence")
    return outcome


def _judge_insertion(name: str, at: int, size: int, flight: Flight | None) -> str | None:
    """What is wrong with the reading of a log with `size` bytes of garbage at `at`; None if nothing."""
    if flight is None:
        return "nothing was read"
    slack = int(getattr(module_of(name), "RESYNC_BYTES", 0))
    whole = intact(name).rows
    damage = flight.damage
    if not damage.lossy:
        return "the garbage was not noticed"
    near = sum(r.rows for r in records_of(name) if at - slack <= r.start <= at + slack) if slack else 0
    if flight.rows < (0.99 * (whole - near) if slack else whole):
        return f"{flight.rows} rows of {whole}"
    if not size <= damage.bytes_skipped <= size + slack:
        return f"{damage.bytes_skipped} bytes skipped"
    if not slack and [(r.start, r.end) for r in damage.regions] != [(at, at + size)]:
        return f"regions {damage.regions}"
    return None


def delete(name: str, count: int, goes_on: Ask) -> Outcome:
    """64 bytes deleted (zeroed in a log of places): what they do not touch stays."""
    outcome = Outcome(name)
    blob = sample(name)
    rng = random.Random(name + "-")
    whole = intact(name).rows
    slack = int(getattr(module_of(name), "RESYNC_BYTES", 0))
    while outcome.trials < count and goes_on():
        at = rng.randrange(len(blob) - 64)
        if max(at_risk(name, byte) for byte in range(at, at + 64)) == whole:
            continue
        end = max(at + 64, chimera_end(name, at))
        touched = [r for r in records_of(name) if r.start < end + slack and r.end > at - slack]
        risk = risk_of(name, at, at + 64) + sum(r.rows for r in touched if r.start >= at + 64 or r.end <= at)
        rest = bytes(64) + blob[at + 64 :] if is_addressed(name) else blob[at + 64 :]
        flight = read_or_none(name, blob[:at] + rest, outcome)
        rows = flight.rows if flight is not None else 0
        outcome.keep(rows, whole)
        if rows < whole - risk:
            outcome.failures.append(f"64 bytes from {at}: {rows} rows of {whole}, {risk} at risk")
    return outcome


def chimera_end(name: str, at: int) -> int:
    """Where the record ends that takes in what follows the 64 bytes deleted from `at`; 0 if it shows."""
    if not getattr(module_of(name), "UNCHECKED", False):
        return 0
    hit = record_at(records_of(name), at)
    shows = at == hit.start or all(hit.end + 64 != r.end for r in records_of(name))
    return 0 if shows else hit.end + 64


def definitions_of(name: str) -> list[tuple[int, int, int]]:
    """Bytes [start, end) that decide over one stream, and rows at risk; the shortest up to 100 bytes."""
    module = module_of(name)
    whole = intact(name).rows
    if hasattr(module, "defining"):
        found: list[tuple[int, int, int]] = module.defining(sample(name))
        return found
    risks = [(r, at_risk(name, r.start)) for r in records_of(name) if r.rows < 2]
    spans = [(r.start, r.end, risk) for r, risk in risks if max(9, r.rows) < risk < whole]
    spans.sort(key=lambda span: span[1] - span[0])
    sizes = itertools.accumulate(end - start for start, end, _ in spans)
    return [span for k, (span, size) in enumerate(zip(spans, sizes, strict=True)) if not k or size <= 100]


def edit(name: str, goes_on: Ask) -> Outcome:
    """Every byte of definitions set to every value: only their stream's rows are lost, and not in silence."""
    outcome = Outcome(name)
    blob = sample(name)
    whole = intact(name).rows
    edits = [
        (byte, value, risk)
        for start, end, risk in definitions_of(name)
        for byte in range(start, end)
        for value in range(256)
        if blob[byte] != value
    ]
    random.Random(name).shuffle(edits)
    for byte, value, risk in edits:
        if not goes_on():
            outcome.remark = f"of {len(edits):,}"
            break
        flight = read_or_none(name, blob[:byte] + bytes([value]) + blob[byte + 1 :], outcome)
        rows = flight.rows if flight is not None else 0
        where = f"byte {byte} set to {value}"
        outcome.keep(rows, whole)
        if rows < whole - risk:
            outcome.failures.append(f"{where}: {rows} rows of {whole}, {risk} at risk")
        elif flight is not None and rows < whole and not flight.damage.lossy:
            outcome.failures.append(f"{where}: {whole - rows} rows lost in silence")
    return outcome


LENGTHS = (0, 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1)


def length(name: str, count: int, goes_on: Ask) -> Outcome:
    """Extreme numbers of 1, 2, 4 and 8 bytes written anywhere; the first bytes of the log more often."""
    outcome = Outcome(name)
    blob = sample(name)
    rng = random.Random(name + "=")
    whole = intact(name).rows
    for turn in range(count):
        width = rng.choice((1, 2, 4, 8))
        value = rng.choice(LENGTHS)
        at = rng.randrange((len(blob) if turn % 2 else 2048) - 8)
        raw = (value & (1 << 8 * width) - 1).to_bytes(width, rng.choice(("little", "big")))
        if not goes_on():
            break
        flight = read_or_none(name, blob[:at] + raw + blob[at + width :], outcome)
        rows = flight.rows if flight is not None else 0
        outcome.keep(rows, whole)
        risk = risk_of(name, at, at + width)
        if rows < whole - risk:
            outcome.failures.append(
                f"{width} bytes of {value} at {at}: {rows} rows of {whole}, {risk} at risk"
            )
        elif is_silent(flight, whole) and not is_unseen(name, at, at + width):
            outcome.failures.append(f"{width} bytes of {value} at {at}: {whole - rows} rows lost in silence")
    return outcome
