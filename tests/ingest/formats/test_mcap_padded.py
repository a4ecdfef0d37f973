"""MCAP records longer than today's fields: the same messages, no damage; real damage is still found."""

from __future__ import annotations

import io
import itertools
import random
import struct

import pytest
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

from flysid.errors import FormatError
from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.mcap.records import MAGIC
from flysid.ingest.formats.registry import FORMATS
from tests.samplelogs.mcap import prefixed, record, records
from tests.samplelogs.mcap_padded import EXTENSIBLE, FEATURES, ROWS, padded_mcap

BARE: frozenset[str] = frozenset()
FULL = frozenset(FEATURES)
SHAPES = {"plain": FULL - {"ch"}, "plain, bare": BARE, "chunk": FULL - {"zstd"}, "zstd": FULL}


def read(raw: bytes) -> Flight:
    return collect(memoryview(raw), "test.mcap", FORMATS["mcap"], Limits())


def assert_whole(raw: bytes) -> None:
    flight = read(raw)
    assert flight["/a"]["k"].to_pylist() == list(range(ROWS))
    assert flight["/b"]["x"].to_pylist() == [k / 3 for k in range(ROWS)]
    assert not flight.damage.lossy
    assert not flight.damage.bad_checksums
    assert flight.info["profile"] == "test"
    assert flight.info["library"] == "flysid tests"
    assert flight.info["craft.mass"] == "2 kg"


def test_the_files_are_what_the_mcap_library_reads() -> None:
    kinds = [type(one).__name__ for one in StreamReader(io.BytesIO(padded_mcap(FULL, {}))).records]
    assert kinds.count("Message") == 2 * ROWS
    assert {"Statistics", "ChunkIndex", "AttachmentIndex", "MetadataIndex", "SummaryOffset"} <= set(kinds)


def combinations() -> list[frozenset[str]]:
    """Features that go together."""
    chosen = itertools.product((False, True), repeat=len(FEATURES))
    found = [frozenset(itertools.compress(FEATURES, wanted)) for wanted in chosen]
    return [features for features in found if "ch" in features or not features & {"mx", "chx", "zstd"}]


def test_combinations_of_features() -> None:
    """As in the format's own conformance files, whose padding this is; all of them in `soak/`."""
    for features in combinations()[::5]:
        assert_whole(padded_mcap(features, dict.fromkeys(EXTENSIBLE, b"\x01\xff\xff")))


def pads(size: int) -> list[bytes]:
    """Content of one size: zeros, what looks like opcodes, text, noise."""
    noise = random.Random(size).randbytes(size)
    return [bytes(size), b"\x05" * size, bytes([1 + size % 15]) + bytes(size - 1), b"x" * size, noise]


@pytest.mark.parametrize("shape", SHAPES)
def test_every_record_kind_longer_together(shape: str) -> None:
    for size in range(1, 65):
        assert_whole(padded_mcap(SHAPES[shape], dict.fromkeys(EXTENSIBLE, pads(size)[size % 5])))


@pytest.mark.parametrize("op", EXTENSIBLE)
def test_every_record_kind_longer_alone(op: int) -> None:
    for size, features in itertools.product((1, 2, 3, 8, 9, 17, 64), SHAPES.values()):
        assert_whole(padded_mcap(features, {op: pads(size)[size % 5]}))


def whole_records() -> dict[str, bytes]:
    """Padding that is a record, or several, of this version."""
    message = record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 99, 10**9, 10**9) + b'{"k": 77}')
    topic = struct.pack("<HH", 1, 2) + prefixed("/z") + prefixed("ros1") + bytes(4)
    return {
        "message": message,
        "messages": 3 * message,
        "metadata": record(Opcode.METADATA, prefixed("n") + bytes(4)),
        "channel": record(Opcode.CHANNEL, topic),
        "data end": record(Opcode.DATA_END, bytes(4)),
    }


@pytest.mark.parametrize("pad", whole_records().values(), ids=whole_records())
def test_padding_that_is_a_record_stays_padding_where_checksums_hold(pad: bytes) -> None:
    """Without them nothing tells it from a length that takes in the next records, and it is counted."""
    for shape, op in itertools.product(SHAPES, (*EXTENSIBLE, None)):
        longer = dict.fromkeys(EXTENSIBLE, pad) if op is None else {op: pad}
        if "crc" in SHAPES[shape]:
            assert_whole(padded_mcap(SHAPES[shape], longer))
            continue
        try:
            flight = read(padded_mcap(SHAPES[shape], longer))
        except FormatError:
            continue
        is_whole = {name: len(table) for name, table in flight.tables.items()} == {"/a": ROWS, "/b": ROWS}
        assert is_whole or flight.damage.lossy, (shape, op)


SUMMARY_ONLY = (8, 10, Opcode.STATISTICS, 13, 14)  # records that stand nowhere else


@pytest.mark.parametrize("op", SUMMARY_ONLY)
def test_a_summary_is_believed_for_its_own_checksum(op: int) -> None:
    """Most writers leave the checksum of the data out, and state that of the summary."""
    raw = bytearray(padded_mcap(FULL, {op: whole_records()["message"]}))
    data_end = next(one.start for one in records(bytes(raw)) if raw[one.start] == Opcode.DATA_END)
    raw[data_end + 9 : data_end + 13] = bytes(4)
    assert_whole(bytes(raw))


@pytest.mark.parametrize("pad", [b"", b"\x01\xff\xff"])
def test_a_log_without_messages_is_empty_and_sound(pad: bytes) -> None:
    header = record(Opcode.HEADER, prefixed("") + prefixed("") + pad)
    flight = read(
        MAGIC + header + record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20)) + MAGIC
    )
    assert not flight.streams
    assert not flight.damage.lossy


def test_every_record_of_another_length() -> None:
    rng = random.Random(7)
    for _, features in itertools.product(range(20), SHAPES.values()):
        assert_whole(padded_mcap(features, lambda _op: rng.randbytes(rng.randrange(65))))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("pad", [b"", b"\x01\xff\xff", bytes(40)])
def test_a_length_that_takes_in_the_next_records_is_damage(shape: str, pad: bytes) -> None:
    """Whole records lie in the surplus: nothing in it is lost in silence."""
    raw = padded_mcap(SHAPES[shape], dict.fromkeys(EXTENSIBLE, pad))
    starts = [one.start for one in records(raw)[1:-1]]
    for number, start in enumerate(starts):
        for end in starts[number + 2 :: 3]:
            if raw[start] in (Opcode.MESSAGE, Opcode.ATTACHMENT):
                continue  # messages take any length; what an attachment holds is not looked at
            hit = bytearray(raw)
            struct.pack_into("<Q", hit, start + 1, end - start - 9)
            flight = read(bytes(hit))
            assert flight.damage.lossy, (raw[start], start, end)


@pytest.mark.parametrize("shape", SHAPES)
def test_padded_files_cut_anywhere(shape: str) -> None:
    raw = padded_mcap(SHAPES[shape], dict.fromkeys(EXTENSIBLE, b"\x01\xff\xff\x00\x07"))
    previous = 0
    for cut in range(len(raw) // 3, len(raw), 11):
        try:
            flight = read(raw[:cut])
        except ValueError:
            assert previous == 0
            continue
        assert flight.damage.truncated or flight.damage.lossy
        assert flight.rows >= previous, cut
        previous = flight.rows
    assert previous == 2 * ROWS
