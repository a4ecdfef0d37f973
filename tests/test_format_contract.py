"""What every log format keeps, tried on all of them: see `tests/samplelogs`.

Nothing here names a format: a module in `ingest/` that ends with `FORMAT = Format(...)` is picked up, and a
format without a sample log fails the first test.
"""

from __future__ import annotations

import os
import random
from functools import cache
from itertools import pairwise
from types import ModuleType

import pyarrow as pa
import pytest

from flysid.errors import FormatError
from flysid.flight import BOOT, TIME, Flight
from flysid.ingest.base import HEAD_BYTES, Limits, all_formats, collect, detect
from tests.samplelogs import Record, record_at, sample_modules

SAMPLES = {name: module for name, module in sample_modules().items() if hasattr(module, "build")}
FORMATS = sorted(set(all_formats()) & set(SAMPLES))
SOAK = os.environ.get("FLYSID_SOAK") == "1"  # `make soak`: the long run
CUT_EVERY = 1 if SOAK else 7
FLIPS = 10_000 if SOAK else 500
INSERTIONS = 3000 if SOAK else 200

each_format = pytest.mark.parametrize("name", FORMATS)


def test_every_format_has_a_sample_log() -> None:
    assert set(all_formats()) <= set(SAMPLES)


def module_of(name: str) -> ModuleType:
    return SAMPLES[name]


@cache
def sample(name: str) -> bytes:
    blob = module_of(name).build()
    assert isinstance(blob, bytes)
    return blob


@cache
def records_of(name: str) -> list[Record]:
    found: list[Record] = module_of(name).records(sample(name))
    return found


def read(name: str, blob: bytes, **limits: int) -> Flight:
    return collect(memoryview(blob), "sample" + module_of(name).SUFFIX, all_formats()[name], Limits(**limits))


def rows_of(name: str, blob: bytes) -> int:
    """Rows read; 0 where the reader says that nothing can be read."""
    try:
        return read(name, blob).rows
    except FormatError:
        return 0


def at_risk(name: str, byte: int) -> int:
    module = module_of(name)
    if hasattr(module, "at_risk"):
        return int(module.at_risk(sample(name), byte))
    return record_at(records_of(name), byte).rows


@cache
def intact(name: str) -> Flight:
    return read(name, sample(name))


@each_format
def test_the_sample_is_deterministic_and_its_records_cover_it(name: str) -> None:
    blob, records = sample(name), records_of(name)
    assert module_of(name).build() == blob
    assert 4_000 < len(blob) < 80_000
    assert records[0].start == 0
    assert records[-1].end == len(blob)
    assert all(a.end == b.start for a, b in pairwise(records))
    assert sum(r.rows for r in records) == intact(name).rows > 100


@each_format
def test_it_is_recognised_by_its_bytes_alone(name: str) -> None:
    head = sample(name)[:HEAD_BYTES]
    for file_name in ("log", "log.bin", "log.txt", "log" + module_of(name).SUFFIX):
        assert detect(head, file_name).name == name


@each_format
def test_nothing_is_lost_from_an_intact_log(name: str) -> None:
    assert not intact(name).damage.lossy, intact(name).damage
    assert not intact(name).damage.truncated


@each_format
def test_tables_begin_with_time_and_boot_and_are_named_once(name: str) -> None:
    for stream, table in intact(name).tables.items():
        assert table.column_names[:2] == [TIME, BOOT], stream
        assert table.schema.field(TIME).type == pa.int64()
        assert table.schema.field(BOOT).type == pa.int32()
        assert len(set(table.column_names)) == len(table.column_names)
        assert b"time_source" in (table.schema.metadata or {}), stream
        assert table[TIME].null_count == table[BOOT].null_count == 0
        table.validate(full=True)


@each_format
def test_small_batches_give_the_same_fields(name: str) -> None:
    """The log in many batches: the same rows in the same order, whatever the batch's border cuts."""
    whole, pieces = intact(name), read(name, sample(name), batch_bytes=2048)
    assert pieces.streams == whole.streams
    for stream, table in whole.tables.items():
        other = pieces.tables[stream]
        assert other.schema.equals(table.schema, check_metadata=True), stream
        own = [c for c in table.column_names if c != TIME]
        assert other.select(own).equals(table.select(own)), stream
    assert pieces.damage == whole.damage


@each_format
def test_a_cut_keeps_every_whole_record_before_it(name: str) -> None:
    blob, records = sample(name), records_of(name)
    borders = {r.end for r in records}
    ends = sorted(borders)
    kept = {0: 0}
    for record in records:
        kept[record.end] = kept[record.start] + record.rows
    at = 0
    for cut in range(1, len(blob), CUT_EVERY):
        while at < len(ends) and ends[at] <= cut:
            at += 1
        expected = kept[ends[at - 1]] if at else 0
        try:
            flight = read(name, blob[:cut])
        except FormatError:
            assert expected == 0, f"cut at {cut}: {expected} rows were there"
            continue
        assert flight.rows == expected, f"cut at {cut}"
        assert flight.damage.truncated == (cut not in borders), f"cut at {cut}"


@each_format
def test_a_flipped_bit_costs_at_most_its_record_and_is_never_silent(name: str) -> None:
    blob, rng, whole = sample(name), random.Random(name), intact(name).rows
    for _ in range(FLIPS):
        byte, bit = rng.randrange(len(blob)), rng.randrange(8)
        damaged = bytearray(blob)
        damaged[byte] ^= 1 << bit
        where = f"bit {bit} of byte {byte}"
        try:
            flight = read(name, bytes(damaged))
        except FormatError:
            assert at_risk(name, byte) == whole, where
            continue
        assert flight.rows >= whole - at_risk(name, byte), where
        if flight.rows < whole:
            assert flight.damage.lossy, where


@each_format
def test_garbage_is_skipped_and_counted_to_the_byte(name: str) -> None:
    """Garbage between two records: all rows stay, and exactly the garbage is skipped."""
    blob, rng, whole = sample(name), random.Random(name), intact(name).rows
    borders = [r.end for r in records_of(name) if r.end < len(blob) and at_risk(name, r.end) < whole]
    slack = int(getattr(module_of(name), "RESYNC_BYTES", 0))
    for turn in range(INSERTIONS):
        at = rng.choice(borders)
        size = rng.choice((1, 7, 64, 511, 4096))
        garbage = bytes(size) if turn % 4 == 0 else rng.randbytes(size)
        if not garbage.strip(getattr(module_of(name), "HARMLESS", b"")):
            continue
        flight = read(name, blob[:at] + garbage + blob[at:])
        assert flight.damage.lossy, f"{size} bytes at {at}"
        if slack == 0:
            assert flight.rows == whole, f"{size} bytes at {at}"
            assert flight.damage.bytes_skipped == size, f"{size} bytes at {at}: {flight.damage}"
            assert [(r.start, r.end) for r in flight.damage.regions] == [(at, at + size)]
        else:
            assert flight.rows >= 0.99 * (whole - sum(r.rows for r in _within(name, at, slack)))
            assert size <= flight.damage.bytes_skipped <= size + slack


def _within(name: str, at: int, slack: int) -> list[Record]:
    return [r for r in records_of(name) if at - slack <= r.start <= at + slack]


@each_format
def test_deletions_cost_only_what_they_touch(name: str) -> None:
    blob, rng, whole = sample(name), random.Random(name + "-"), intact(name).rows
    slack = int(getattr(module_of(name), "RESYNC_BYTES", 0))
    for _ in range(INSERTIONS // 4):
        at = rng.randrange(len(blob) - 64)
        if max(at_risk(name, byte) for byte in range(at, at + 64)) == whole:
            continue
        touched = [r for r in records_of(name) if r.start < at + 64 + slack and r.end > at - slack]
        risk = sum({r: max(r.rows, at_risk(name, max(at, r.start))) for r in touched}.values())
        flight = read(name, blob[:at] + blob[at + 64 :])
        assert flight.rows >= whole - risk, f"64 bytes from {at}"


@pytest.mark.parametrize(
    "blob", [b"\0" * 5000, b"\xff" * 5000, b"hello\n" * 900], ids=["zeros", "ones", "text"]
)
@each_format
def test_what_is_no_log_is_refused_or_all_counted(name: str, blob: bytes) -> None:
    try:
        flight = read(name, blob)
    except FormatError:
        return
    assert flight.rows == 0
    assert flight.damage.lossy


@each_format
def test_random_bytes_never_crash_a_reader(name: str) -> None:
    rng = random.Random(name)
    for size in (1, 2, 15, 16, 17, 300, 5000):
        for _ in range(5):
            assert rows_of(name, rng.randbytes(size)) >= 0
