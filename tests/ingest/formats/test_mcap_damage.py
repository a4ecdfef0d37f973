"""MCAP under damage and hostility: only FormatError, everything outside the damage kept and counted."""

from __future__ import annotations

import struct
import time
import tracemalloc
import zlib
from functools import cache

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from flysid.errors import FormatError
from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.mcap.records import MAGIC
from flysid.ingest.formats.registry import FORMATS
from tests.samplelogs.mcap import Topic, json_topic, mcap_file, prefixed, record, records, ros1_topic

SCHEMA = {"type": "object", "properties": {"k": {"type": "integer"}, "x": {"type": "number"}}}
ROWS = 36


@cache
def sample(kind: str) -> bytes:
    """A log of two topics, in chunks of about 20 messages (or none)."""
    rows = [{"k": k, "x": k / 7} for k in range(ROWS)]
    numbers = [struct.pack("<Id", k, k / 3) for k in range(ROWS)]
    topics = [json_topic("/a", SCHEMA, rows), ros1_topic("/b", "p/Pair", "uint32 k\nfloat64 x\n", numbers)]
    compression = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}.get(kind, CompressionType.NONE)
    return mcap_file(topics, compression=compression, chunked=kind != "plain", chunk_size=600)


KINDS = ["zstd", "lz4", "none", "plain"]


def read(raw: bytes, limits: Limits | None = None) -> Flight | None:
    """The flight; None where there is nothing at all to read."""
    try:
        return collect(memoryview(raw), "test.mcap", FORMATS["mcap"], limits or Limits())
    except FormatError:
        return None


def kept(flight: Flight | None) -> dict[str, list[int]]:
    return {s: flight[s]["k"].to_pylist() for s in flight.streams} if flight is not None else {}


def ends_of_records(raw: bytes) -> dict[int, int]:
    """End of every message-bearing top-level record -> messages complete by then (from the index records)."""
    ends = {}
    count = 0
    at = len(MAGIC)
    while at + 9 <= len(raw) - len(MAGIC):
        op, length = struct.unpack_from("<BQ", raw, at)
        if op == 5:
            count += 1
        at += 9 + length
        if op == 7:
            count += (length - 6) // 16
        if op in (5, 7):
            ends[at] = count
    return ends


@pytest.mark.parametrize("kind", KINDS)
def test_cut_at_every_31st_byte(kind: str) -> None:
    raw = sample(kind)
    ends = ends_of_records(raw)
    borders = {record.end for record in records(raw)}
    assert max(ends.values()) == 2 * ROWS
    complete = 0
    for cut in range(1, len(raw), 31):
        complete = max((n for end, n in ends.items() if end <= cut), default=0)
        flight = read(raw[:cut])
        if flight is None:
            assert complete == 0
            continue
        assert flight.rows >= complete
        assert flight.damage.truncated or cut in borders
        for stream in flight.streams:
            assert flight[stream]["k"].to_pylist() == list(range(flight[stream].num_rows))


@pytest.mark.parametrize("kind", KINDS)
def test_single_bit_flips(kind: str) -> None:
    raw = sample(kind)
    rng = np.random.default_rng(5)
    for place in rng.integers(len(MAGIC) * 8, len(raw) * 8, 60).tolist():
        hit = bytearray(raw)
        hit[place // 8] ^= 1 << place % 8
        flight = read(bytes(hit))
        assert flight is not None
        if kind != "plain":  # one chunk holds at most 30 messages; without chunks there is no checksum
            assert flight.rows >= 2 * ROWS - 30
            if flight.rows < 2 * ROWS:
                assert flight.damage.lossy
            assert all(set(ks) <= set(range(ROWS)) for ks in kept(flight).values())
        else:
            assert flight.rows >= 2 * ROWS - 30


@pytest.mark.parametrize("kind", KINDS)
def test_garbage_and_deletions(kind: str) -> None:
    raw = sample(kind)
    rng = np.random.default_rng(6)
    for trial in range(24):
        at = int(rng.integers(len(MAGIC), len(raw) - 8))
        if trial % 3 == 0:
            hit = raw[:at] + raw[at + 64 :]
        elif trial % 3 == 1:
            hit = raw[:at] + rng.bytes(int(rng.integers(1, 4096))) + raw[at:]
        else:
            hit = raw[:at] + bytes(4096) + raw[at:]
        flight = read(hit)
        assert flight is not None
        assert flight.rows >= 2 * ROWS - 30
        if trial % 3:
            assert flight.damage.lossy


def test_a_bad_chunk_is_skipped_counted_and_located() -> None:
    raw = bytearray(sample("none"))
    place = raw.index(b'{"k": 27,')
    raw[place + 6] ^= 1
    flight = read(bytes(raw))
    assert flight is not None
    damage = flight.damage
    assert damage.bad_checksums == 1
    assert damage.region_count == 1
    assert damage.regions[0].start < place < damage.regions[0].end
    assert damage.regions[0].reason == "chunk checksum failed"
    assert damage.bytes_skipped == damage.regions[0].size
    assert 27 not in kept(flight)["/a"]
    assert not damage.truncated


def test_definitions_from_the_summary_serve_when_their_chunk_is_lost() -> None:
    raw = bytearray(sample("zstd"))
    first_chunk = raw.index(b"\x04\x00\x00\x00zstd")
    raw[first_chunk + 30] ^= 0xFF
    flight = read(bytes(raw))
    assert flight is not None
    assert set(flight.streams) == {"/a", "/b"}
    assert flight.damage.bad_checksums + flight.damage.region_count > 0


def test_the_part_of_a_cut_chunk_that_was_written_is_kept() -> None:
    for kind in ("none", "lz4"):
        rows = [{"k": k, "x": float(np.random.default_rng(k).normal())} for k in range(9000)]
        compression = CompressionType.LZ4 if kind == "lz4" else CompressionType.NONE
        raw = mcap_file([json_topic("/a", SCHEMA, rows)], compression=compression, chunk_size=1 << 22)
        flight = read(raw[: len(raw) // 2])
        assert flight is not None
        assert flight["/a"].num_rows > 1000


# ---- hostile files


def chunk(records: bytes, *, size: int | None = None, name: str = "", packed: bytes | None = None) -> bytes:
    body = records if packed is None else packed
    fixed = struct.pack("<QQQI", 0, 0, len(records) if size is None else size, zlib.crc32(records))
    return record(6, fixed + prefixed(name) + struct.pack("<Q", len(body)) + body)


def definitions(schema: bytes = b"", *, encoding: str = "json", kind: str = "jsonschema") -> bytes:
    first = record(3, struct.pack("<H", 1) + prefixed("p/T") + prefixed(kind) + prefixed(schema))
    second = record(4, struct.pack("<HH", 1, 1) + prefixed("/t") + prefixed(encoding) + prefixed(""))
    return first + second


def message(payload: bytes, channel: int = 1) -> bytes:
    return record(5, struct.pack("<HIQQ", channel, 0, 10**9, 10**9) + payload)


def whole(*records: bytes) -> bytes:
    tail = record(15, bytes(4)) + record(2, bytes(20))
    return MAGIC + record(1, prefixed("") + prefixed("")) + b"".join(records) + tail + MAGIC


LENGTHS = [0, 1, 2**31, 2**63, 2**64 - 1]


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("op", [1, 2, 3, 4, 5, 6, 7, 9, 12, 15])
def test_declared_lengths(op: int, length: int) -> None:
    good = definitions() + message(b'{"k": 1}')
    raw = whole(
        good, record(op, bytes(40), length), definitions(), message(b'{"k": 2}'), message(b'{"k": 3}')
    )
    flight = read(raw)
    assert flight is not None
    assert kept(flight)["/t"][0] == 1
    assert kept(flight)["/t"][-1] == 3
    assert flight.damage.lossy or op == 15


@pytest.mark.parametrize("length", [1, 2**31, 2**32 - 1])
def test_lengths_inside_messages(length: int) -> None:
    for text in ("string s", "float64[] s", "string[] s", "p/Q[] s\n===\nMSG: p/Q\nfloat64 x\nstring t\n"):
        raw = whole(
            definitions(text.encode(), encoding="ros1", kind="ros1msg"),
            message(struct.pack("<I", length)),
            message(struct.pack("<I", 0)),
        )
        flight = read(raw)
        assert flight is not None
        assert flight["/t"].num_rows == 1
        assert flight.damage.undecoded == {"/t": 1}


@pytest.mark.parametrize(
    "text",
    [
        "p/T again",
        "p/A a\n===\nMSG: p/A\np/B b\n===\nMSG: p/B\np/A[] a\n",
        "float64[1000000000] x",
        "float64[99999999999999999999] x",
        "p/Missing m",
        "wstring w",
        "????",
        "p/A0[9] a\n"
        + "".join(f"===\nMSG: p/A{k}\n" + "".join(f"p/A{k + 1} f{j}\n" for j in range(10)) for k in range(12))
        + "===\nMSG: p/A12\nfloat64 x\n",
    ],
)
def test_ros_types_without_a_layout_are_named(text: str) -> None:
    raw = whole(definitions(text.encode(), encoding="cdr", kind="ros2msg"), message(bytes(64)))
    flight = read(raw)
    assert flight is not None
    assert flight.damage.undecoded == {"/t": 1}
    assert flight.damage.reasons["/t"]


def test_a_cut_between_two_records_is_seen_by_the_magic_that_is_missing() -> None:
    raw = sample("zstd")
    for one in records(raw)[3:-1]:
        flight = read(raw[: one.end])
        assert flight is not None
        assert flight.damage.truncated


def test_long_uneven_sequences_are_bounded() -> None:
    raw = whole(
        definitions(b"string[] s", encoding="ros1", kind="ros1msg"),
        message(struct.pack("<I", 1_000_000) + bytes(4_000_000)),
    )
    flight = read(raw)
    assert flight is not None
    assert flight.damage.undecoded == {"/t": 1}


def bombs() -> dict[str, bytes]:
    zeros = bytes(1 << 26)
    zstd = zstandard.ZstdCompressor(level=1).compress(zeros)
    lz4_data = lz4.frame.compress(zeros)
    unsized = zstandard.ZstdCompressor(level=1, write_content_size=False).compress(zeros)
    return {
        "zstd, honest": chunk(zeros, name="zstd", packed=zstd),
        "lz4, honest": chunk(zeros, name="lz4", packed=lz4_data),
        "zstd, small size declared": chunk(b"", size=1000, name="zstd", packed=zstd),
        "zstd without size, small size declared": chunk(b"", size=1000, name="zstd", packed=unsized),
        "lz4, small size declared": chunk(b"", size=1000, name="lz4", packed=lz4_data),
        "huge size declared": chunk(b"", size=2**63, name="zstd", packed=zstd),
        "huge plain": chunk(b"", size=2**64 - 1, packed=b"1234"),
        "many small": b"".join(
            [chunk(zeros[: 1 << 20], name="zstd", packed=zstandard.compress(zeros[: 1 << 20]))] * 300
        ),
    }


@pytest.mark.parametrize("name", list(bombs()))
def test_bombs_stop_at_the_limits(name: str) -> None:
    raw = whole(definitions(), bombs()[name], message(b'{"k": 1}'), message(b'{"k": 2}'))
    tracemalloc.start()
    flight = read(raw)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert flight is not None
    assert kept(flight)["/t"] == [1, 2]
    assert flight.damage.lossy
    assert flight.damage.bad_checksums == 0  # refused for its size: no checksum was looked at
    assert peak < 64 << 20


def test_the_ratio_can_be_raised() -> None:
    records = definitions() + message(b'{"k": 1, "pad": "' + bytes(b" " * 4_000_000) + b'"}')
    raw = whole(definitions(), chunk(records, name="zstd", packed=zstandard.compress(records)))
    refused = read(raw)
    allowed = read(raw, Limits(max_ratio=1e6))
    assert refused is not None
    assert refused.rows == 0
    assert "above 200 times" in refused.damage.regions[0].reason
    assert allowed is not None
    assert allowed.rows == 1


def test_a_great_many_topics_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flysid.ingest.formats.messages.topics.MAX_TOPICS", 100)
    topics = []
    for k in range(3000):
        body = struct.pack("<HH", k, 1) + prefixed(f"/t{k}") + prefixed("json") + prefixed("")
        topics.append(record(4, body) + message(b'{"k": 1}', k))
    flight = read(whole(definitions(), *topics))
    assert flight is not None
    assert len(flight.streams) == 100
    assert flight.damage.undecoded == {"(topics beyond 100)": 2900}


def test_channels_by_the_ten_thousand_do_not_slow_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flysid.ingest.formats.messages.topics.MAX_TOPICS", 10)
    topics = []
    for k in range(20_000):
        body = struct.pack("<HH", k, 1) + prefixed(f"/t{k}") + prefixed("json") + prefixed("")
        topics.append(record(4, body) + message(b'{"k": 1}', k))
    raw = whole(definitions(), *topics)
    began = time.process_time()
    flight = read(raw)
    assert flight is not None
    assert sum(flight.damage.undecoded.values()) == 19_990
    assert time.process_time() - began < 8  # quadratic behaviour took minutes


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=400))
def test_any_bytes_behind_the_magic(tail: bytes) -> None:
    read(MAGIC + tail)


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=120), st.sampled_from(["ros1", "cdr", "protobuf", "json"]))
def test_any_payload_and_any_schema(payload: bytes, encoding: str) -> None:
    kind = {"ros1": "ros1msg", "cdr": "ros2msg", "protobuf": "protobuf", "json": "jsonschema"}[encoding]
    text = b"string s\nfloat64[] d\nstring[] w\nbool[2] b\nint16 z\n"
    read(whole(definitions(text, encoding=encoding, kind=kind), message(payload)))
    read(whole(definitions(payload, encoding=encoding, kind=kind), message(payload)))


def test_topics_named_by_an_enemy_are_streams_like_others() -> None:
    names = ["../x", "/etc/passwd", "a\x00b", "x" * 300, "a\nb", "\x1b[31m"]
    flight = read(mcap_file([Topic(n, "json", "", "", b"", [(1, b'{"k": 1}')]) for n in names]))
    assert flight is not None
    assert set(flight.streams) == set(names)
