"""A message ends where its definition ends: bytes behind it mean another type, and never become values."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.common.scrub_rules import Scrubber
from flysid.ingest.formats.mcap.scrub import scrub
from flysid.ingest.formats.messages.definitions import (
    Array,
    MessageType,
    Number,
    Text,
    Type,
    parse_definition,
)
from flysid.ingest.formats.registry import FORMATS
from tests.samplelogs import ros
from tests.samplelogs.mcap import Topic, json_topic, mcap_file, ros1_topic, ros2_topic

SURPLUS = "bytes remain after the end of its definition"
HEAD = b"\x00\x01\x00\x00"


def read(*topics: Topic) -> Flight:
    return collect(memoryview(mcap_file(topics)), "test.mcap", FORMATS["mcap"], Limits())


def read_cdr(text: str, *payloads: bytes) -> Flight:
    return read(ros2_topic("/t", "p/msg/T", text, payloads))


def assert_undecoded(flight: Flight, count: int) -> None:
    assert not flight.streams
    assert flight.damage.undecoded == {"/t": count}
    assert flight.damage.reasons["/t"] == SURPLUS
    assert flight.damage.lossy


def test_a_level_of_another_width_is_not_read() -> None:
    """Written as 16 bits, defined as 8: 0x14FB would read 251."""
    payloads = [HEAD + struct.pack("<dH", k, 0x14FB) for k in range(5)]
    assert_undecoded(read_cdr("float64 x\nuint8 level\n", *payloads), 5)


def test_the_same_padded_is_not_read_either() -> None:
    payloads = [HEAD + struct.pack("<dHxx", k, 0x14FB) for k in range(5)]
    assert_undecoded(read_cdr("float64 x\nuint8 level\n", *payloads), 5)


def test_a_newer_message_than_its_definition_is_not_read() -> None:
    assert_undecoded(read_cdr("uint32 k\n", *[HEAD + struct.pack("<If", k, 1.5) for k in range(5)]), 5)


def test_a_ros1_message_ends_exactly() -> None:
    good = [struct.pack("<Id", k, k / 3) for k in range(4)]
    flight = read(ros1_topic("/t", "p/T", "uint32 k\nfloat64 x\n", [*good, good[0] + b"\0"]))
    assert flight["/t"]["k"].to_pylist() == [0, 1, 2, 3]
    assert flight.damage.undecoded == {"/t": 1}
    assert flight.damage.reasons["/t"] == SURPLUS


@pytest.mark.parametrize("body", [b"\x07", b"\x07\x01", b"\x07\x01\x02", b"\x07\x01\x02\x03"])
def test_zeros_up_to_a_multiple_of_four_are_padding(body: bytes) -> None:
    fields = "".join(f"uint8 f{k}\n" for k in range(len(body)))
    flight = read_cdr(fields, HEAD + body + bytes(-len(body) % 4))
    assert flight["/t"]["f0"].to_pylist() == [7]
    assert not flight.damage.lossy
    assert_undecoded(read_cdr(fields, HEAD + body + bytes(-len(body) % 4 + 4)), 1)


def test_room_for_empty_sequences_hides_no_other_definition() -> None:
    """The message has one more number in the middle: where `xs` is empty, 4 bytes too many look like room."""
    empty = [HEAD + struct.pack("<Iff", 0, k, 0.5) for k in range(3)]
    full = [HEAD + struct.pack("<Ixxxxdff", 1, 1.5, k, 0.5) for k in range(4)]
    assert_undecoded(read_cdr("float64[] xs\nfloat32 a\n", *empty, *full), 7)
    flight = read_cdr("float64[] xs\nfloat32 z\nfloat32 a\n", *empty, *full)
    assert flight["/t"]["z"].to_pylist() == [0, 1, 2, 0, 1, 2, 3]
    assert not flight.damage.lossy


def test_a_text_that_ends_without_a_nul_keeps_its_last_letter() -> None:
    payloads = [HEAD + struct.pack("<I", len(text)) + text for text in (b"abcd", b"abc\0", b"\0", b"")]
    assert read_cdr("string s\n", *payloads)["/t"]["s"].to_pylist() == ["abcd", "abc", "", ""]


def estimated(kind: Type, value: Any, at: int) -> int:
    """Where a value ends by the sizes that `rmw_serialize` of rmw_fastrtps and rmw_zenoh asks a buffer for.

    As their generated `get_serialized_size`: the elements of a sequence of numbers are aligned even if it has
    none.
    """
    if isinstance(kind, MessageType):
        for name, inner in kind.fields:
            at = estimated(inner, value[name], at)
        return at
    if isinstance(kind, Number):
        size = np.dtype(kind.dtype).itemsize
        return at + -at % size + size
    if isinstance(kind, Text):
        return at + -at % 4 + 4 + len(value.encode()) + 1
    assert isinstance(kind, Array)
    if kind.size is None:
        at += -at % 4 + 4
    if isinstance(kind.element, Number):
        size = np.dtype(kind.element.dtype).itemsize
        return at + -at % size + size * len(value)
    for item in value:
        at = estimated(kind.element, item, at)
    return at


FIELDS = ("uint8", "uint16", "float32", "float64", "string", "int64[2]", "uint8[]", "float32[]", "float64[]")
UNEVEN_FIELDS = ("uint64[<=3]", "string[]", "p/Inner", "p/Inner[]", "p/Even[]", "p/Odd[]", "p/Odd[2]")
NEEDED = {
    "p__Inner": "uint8 kind\nfloat64[] data\nstring text\n",
    "p__Even": "float64 x\nuint8 y\n",
    "p__Odd": "uint8 x\nuint8[7] y\nfloat64 z\n",
}


def value_of(kind: Type, rng: np.random.Generator) -> Any:
    if isinstance(kind, MessageType):
        return {name: value_of(inner, rng) for name, inner in kind.fields}
    if isinstance(kind, Text):
        return ros.words(rng)
    if isinstance(kind, Array):
        count = int(rng.integers(3)) if kind.size is None else kind.size
        return [value_of(kind.element, rng) for _ in range(count)]
    assert isinstance(kind, Number)
    return float(rng.integers(100)) if kind.dtype.startswith("f") else int(rng.integers(100))


@settings(max_examples=120, deadline=None)
@given(st.lists(st.sampled_from(FIELDS + UNEVEN_FIELDS), min_size=1, max_size=9), st.integers(0, 1 << 30))
def test_room_for_empty_sequences_is_no_surplus(fields: list[str], seed: int) -> None:
    """Any type, any message: buffers as `rmw_serialize` sizes them, what is left in them being anything."""
    text = ros.definition("".join(f"{kind} f{k}\n" for k, kind in enumerate(fields)), **NEEDED)
    kind = parse_definition("p/T", text, 2)
    rng = np.random.default_rng(seed)
    values = [value_of(kind, rng) for _ in range(6)]
    exact = [ros.encode_ros2("p/msg/T", text, value) for value in values]
    sized = [4 + estimated(kind, value, 0) for value in values]
    assert all(size >= len(raw) for size, raw in zip(sized, exact, strict=True))
    roomy = [raw + rng.bytes(size - len(raw)) for raw, size in zip(exact, sized, strict=True)]
    padded = [raw + bytes(-len(raw) % 4) for raw in roomy]
    tables = [
        read_cdr(text, *payloads)["/t"].drop_columns(["recv_ns", "time_ns"])
        for payloads in (exact, roomy, padded)
    ]
    assert tables[0].num_rows == 6
    assert tables[0].equals(tables[1])
    assert tables[0].equals(tables[2])
    longer = [raw + b"\x01" * 5 for raw in roomy]
    assert_undecoded(read_cdr(text, *longer), 6)


def test_a_message_with_a_surplus_is_not_scrubbed_into_a_copy() -> None:
    """Where the definition is not the message's, nobody knows where the position stands."""
    text = "float64 latitude\nfloat64 longitude\n"
    payloads = [HEAD + struct.pack("<dd", 51.5, 7.25), HEAD + struct.pack("<ddd", 51.5, 7.25, 100.0)]
    scrubber = Scrubber()
    raw = mcap_file([ros2_topic("/t", "p/msg/T", text, payloads)])
    copy = b"".join(scrub(memoryview(raw), scrubber, Limits()))
    flight = collect(memoryview(copy), "copy.mcap", FORMATS["mcap"], Limits())
    assert flight["/t"].num_rows == 1
    assert struct.pack("<d", 51.5) not in copy


def test_two_json_objects_in_one_message_are_none() -> None:
    schema = {"type": "object", "properties": {"k": {"type": "integer"}}}
    topic = json_topic("/t", schema, [{"k": k} for k in range(3)])
    odd = [*topic.messages, (2 * 10**9, b'{"k": 7}{"k": 8}'), (2 * 10**9 + 1, b" ")]
    flight = read(Topic("/t", "json", "t", "jsonschema", topic.schema, odd))
    assert flight["/t"]["k"].to_pylist() == [0, 1, 2]
    assert flight.damage.undecoded == {"/t": 2}
