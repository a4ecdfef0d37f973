"""What every log format keeps, tried on all of them: see `tests/samplelogs`.

Nothing here names a format: every row of `registry.FORMATS` is tried, and a format without a sample log fails
the first test.
"""

from __future__ import annotations

import random
from itertools import pairwise
from pathlib import Path

import pyarrow as pa
import pytest

import flysid
from flysid.errors import FormatError
from flysid.flight import BOOT, TIME
from flysid.ingest.formats.base import HEAD_BYTES
from flysid.ingest.formats.registry import all_formats, detect
from tests.format_trials import (
    FORMATS,
    SAMPLES,
    cut,
    delete,
    flip,
    insert,
    intact,
    module_of,
    read,
    records_of,
    sample,
)

# `make soak` makes more of them
CUT_EVERY = 197
FLIPS = 60
INSERTIONS = 24
DELETIONS = 12

each_format = pytest.mark.parametrize("name", FORMATS)


def test_every_format_has_a_sample_log() -> None:
    assert set(all_formats()) <= set(SAMPLES)


def rows_of(name: str, blob: bytes) -> int:
    """Rows read; 0 where the reader says that nothing can be read."""
    try:
        return read(name, blob).rows
    except FormatError:
        return 0


@each_format
def test_the_sample_is_deterministic_and_its_records_cover_it(name: str) -> None:
    blob = sample(name)
    records = records_of(name)
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
@pytest.mark.parametrize("size", [9, 17, 300_000])
def test_zeros_ahead_of_a_log_are_damage_and_hide_nothing(name: str, size: int, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(bytes(size) + sample(name))
    harmless = b"\0" in getattr(module_of(name), "HARMLESS", b"")
    flight = flysid.read(path)
    assert (flight.source.format, flight.rows) == (name, intact(name).rows)
    assert flight.damage.lossy or harmless
    assert flight.damage.bytes_skipped == size
    assert flysid.read(path, format=name).rows == flight.rows


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
    whole = intact(name)
    pieces = read(name, sample(name), batch_bytes=2048)
    assert pieces.streams == whole.streams
    for stream, table in whole.tables.items():
        other = pieces.tables[stream]
        assert other.schema.equals(table.schema, check_metadata=True), stream
        own = [c for c in table.column_names if c != TIME]
        assert other.select(own).equals(table.select(own)), stream
    assert pieces.damage == whole.damage


@each_format
def test_a_cut_keeps_every_whole_record_before_it(name: str) -> None:
    assert not cut(name, CUT_EVERY, lambda: True).failures


@each_format
def test_a_flipped_bit_costs_at_most_its_record_and_is_never_silent(name: str) -> None:
    assert not flip(name, FLIPS, lambda: True).failures


@each_format
def test_garbage_is_skipped_and_counted_to_the_byte(name: str) -> None:
    assert not insert(name, INSERTIONS, lambda: True).failures


@each_format
def test_deletions_cost_only_what_they_touch(name: str) -> None:
    assert not delete(name, DELETIONS, lambda: True).failures


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
