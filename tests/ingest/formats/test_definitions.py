"""Definitions in IDL, wide strings, service events and CBOR: decoded, or named with their count."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

import flysid
from flysid.flight import Flight, field_unit
from flysid.ingest.formats.messages.cbor import cbor_as_json
from flysid.ingest.formats.messages.definitions import DefinitionError
from flysid.ingest.formats.messages.idl import parse_idl
from tests.command import call
from tests.samplelogs.mcap import SECOND, Topic, mcap_file

CDR = b"\0\1\0\0"
POSE_IDL = """
#include "geometry_msgs/msg/Point.idl"
module geometry_msgs { module msg {
  // a comment with struct { in it
  module Pose_Constants { const unsigned long COUNT = 3; };
  typedef double double__3[3];
  enum Mode { MANUAL, AUTO };
  struct Pose;
  @verbatim (language="comment", text="position ( and )" "more")
  struct Pose {
    @unit (value="m")
    geometry_msgs::msg::Point position;
    @default (value=1.5) double__3 gains;
    Mode mode;
    sequence<float, 4> few;  /* bounded */
    sequence<Point> many;
    string<20> name;
    unsigned short flags[2][Pose_Constants::COUNT], one;
  };
}; };
================================================================================
IDL: geometry_msgs/msg/Point
module geometry_msgs { module msg {
  struct Point { @unit(value="m") double x; @unit(value="m") double y; };
}; };
"""


def mcap_of(kind: str, encoding: str, schema: str, payloads: Sequence[bytes], wire: str = "cdr") -> bytes:
    messages = [(SECOND + k * 10**7, payload) for k, payload in enumerate(payloads)]
    return mcap_file([Topic("/t", wire, kind, encoding, schema.encode(), messages)])


def flight_of(folder: Path, *about: Any, **more: Any) -> Flight:
    path = folder / "a.mcap"
    path.write_bytes(mcap_of(*about, **more))
    return flysid.read(path)


def pose(k: int, *, with_flags: bool = True) -> bytes:
    name = b"n" * (k % 5) + b"\0"
    body = struct.pack("<2d3dI", k, -k, 1, 2, 3, k % 2)
    body += struct.pack("<I", k % 3) + struct.pack(f"<{k % 3}f", *range(k % 3))
    body += struct.pack("<I", k % 2)
    if k % 2:
        body += bytes(-len(body) % 8) + struct.pack("<2d", 7, 8)
    body += struct.pack("<I", len(name)) + name
    if with_flags:
        body += bytes(-len(body) % 2) + struct.pack("<7H", *range(7))
    return CDR + body


@pytest.mark.parametrize("encoding", ["ros2idl", "omgidl"])
def test_definitions_in_idl_are_read(encoding: str, tmp_path: Path) -> None:
    flight = flight_of(tmp_path, "geometry_msgs/msg/Pose", encoding, POSE_IDL, [pose(k) for k in range(30)])
    assert not flight.damage.lossy, flight.damage
    row = flight.tables["/t"].to_pylist()[5]
    assert (row["position.x"], row["position.y"], row["gains"], row["mode"]) == (5, -5, [1, 2, 3], 1)
    assert (row["few"], row["many"], row["name"], row["one"]) == ([0, 1], [{"x": 7, "y": 8}], "", 6)
    assert row["flags"] == [[0, 1, 2], [3, 4, 5]]
    assert field_unit(flight.tables["/t"].schema.field("position.x")) == "m"


def test_idl_lays_out_what_rosbags_lays_out(tmp_path: Path) -> None:
    typesys = pytest.importorskip("rosbags.typesys", reason="the rosbags library is not installed")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    plain = """module geometry_msgs { module msg {
      typedef double double__3[3];
      struct Pose {
        geometry_msgs::msg::Point position; double__3 gains; unsigned long mode;
        sequence<float, 4> few; sequence<geometry_msgs::msg::Point> many; string<20> name;
      }; }; };
    """
    point = "module geometry_msgs { module msg { struct Point { double x; double y; }; }; };"
    for part in (plain, point):
        store.register(typesys.get_types_from_idl(part))
    plain = plain.rstrip() + "\n" + "=" * 80 + "\nIDL: geometry_msgs/msg/Point\n" + point
    text = store.generate_msgdef("geometry_msgs/msg/Pose", ros_version=2)[0]
    raws = [pose(k, with_flags=False) for k in range(20)]
    mine = flight_of(tmp_path, "geometry_msgs/msg/Pose", "ros2idl", plain, raws).tables["/t"]
    theirs = flight_of(tmp_path, "geometry_msgs/msg/Pose", "ros2msg", text, raws).tables["/t"]
    assert mine.num_rows == 20
    assert mine.to_pylist() == theirs.to_pylist()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("module a { struct B { B b; }; };", "contains itself"),
        ("module a { struct B { C c; }; };", "a?/?C is not defined"),
        ("module a { union B switch (long) { case 1: long x; }; };", "union"),
        ("module a { struct B { @optional long x; }; };", "optional"),
        ("module a { struct B { map<long, long> x; }; };", "map"),
        ("module a { struct B { long x[0]; }; };", "0 elements"),
        ("module a { struct B { long x", "ends in the middle"),
        ("module a { typedef B B; };", "contains itself"),
        ("module a { struct B { long double x; }; };", "no agreed layout"),
        ("module a { struct B : D { long x; }; };", "D is not defined"),
    ],
)
def test_idl_that_gives_no_layout_is_named_with_its_count(text: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(DefinitionError, match=why):
        parse_idl("a/B", text)
    damage = flight_of(tmp_path, "a/B", "omgidl", text, [CDR + bytes(4)] * 7).damage
    assert damage.undecoded == {"/t": 7}


def test_random_idl_ends_in_a_layout_or_an_error(fresh_seed: int) -> None:
    rng = random.Random(fresh_seed)
    words = POSE_IDL.split()
    for _ in range(300):
        some = [rng.choice(words) if rng.random() < 0.05 else word for word in words if rng.random() > 0.03]
        try:
            parse_idl("geometry_msgs/msg/Pose", " ".join(some))
        except DefinitionError:
            continue
        except Exception as error:  # noqa: BLE001 - this is what the test looks for
            pytest.fail(f"{type(error).__name__}: {error}")


WIDE = {
    "4 bytes a character": lambda text: struct.pack("<I", len(text)) + text.encode("utf-32-le"),
    "2 bytes a character": lambda text: struct.pack("<I", len(text)) + text.encode("utf-16-le"),
    "length in bytes": lambda text: struct.pack("<I", 2 * len(text)) + text.encode("utf-16-le"),
}


@pytest.mark.parametrize("way", WIDE)
def test_a_wide_string_costs_no_topic(way: str, tmp_path: Path) -> None:
    texts = ["", "a", "größer", "Flug 7"] * 5
    raws = []
    for k, text in enumerate(texts):
        body = struct.pack("<i", k) + WIDE[way](text)
        raws.append(CDR + body + bytes(-len(body) % 8) + struct.pack("<d", k / 2))
    text = "int32 k\nwstring name\nfloat64 x\n"
    flight = flight_of(tmp_path, "p/msg/Named", "ros2msg", text, raws)
    assert not flight.damage.lossy, flight.damage
    table = flight.tables["/t"]
    assert table["name"].to_pylist() == texts
    assert table["x"].to_pylist() == [k / 2 for k in range(len(texts))]


def test_a_wide_string_is_never_copied_unseen(tmp_path: Path) -> None:
    secret = WIDE["4 bytes a character"]("secret")
    (tmp_path / "a.mcap").write_bytes(mcap_of("p/msg/N", "ros2msg", "wstring name\n", [CDR + secret] * 5))
    done = call("scrub", "a.mcap", "-o", "b.mcap", cwd=tmp_path)
    assert done.returncode in (0, 3), done.stderr
    assert "secret".encode("utf-32-le") not in (tmp_path / "b.mcap").read_bytes()


def event(k: int) -> bytes:
    """A request or a response of AddTwoInts, as the introspection of a service publishes it."""
    body = struct.pack("<B3xiI16B4xq", k % 4, 1_700_000_000 + k, 5, *range(16), k)
    asked = k % 2 == 0
    body += struct.pack("<I", asked)
    if asked:
        body += bytes(-len(body) % 8) + struct.pack("<qq", k, 2 * k)
    body += struct.pack("<I", not asked)
    if not asked:
        body += bytes(-len(body) % 8) + struct.pack("<q", 3 * k)
    return CDR + body


def test_service_events_are_read_from_the_file_of_the_service(tmp_path: Path) -> None:
    text = "int64 a\nint64 b\n---\nint64 sum\n"
    kind = "example_interfaces/srv/AddTwoInts_Event"
    flight = flight_of(tmp_path, kind, "ros2msg", text, [event(k) for k in range(20)])
    assert not flight.damage.lossy, flight.damage
    rows = flight.tables["/t"].to_pylist()
    assert rows[4]["request"] == [{"a": 4, "b": 8}]
    assert (rows[5]["response"], rows[5]["info.sequence_number"]) == ([{"sum": 15}], 5)
    assert rows[5]["info.stamp.sec"] == 1_700_000_005


def test_feedback_of_actions_is_read_from_the_file_of_the_action(tmp_path: Path) -> None:
    text = "int32 order\n---\nint32[] sequence\n---\nfloat32 done\n"
    raws = [CDR + bytes(range(16)) + struct.pack("<f", k / 4) for k in range(9)]
    flight = flight_of(tmp_path, "p/action/Fly_FeedbackMessage", "ros2msg", text, raws)
    assert flight.tables["/t"]["feedback.done"].to_pylist() == [k / 4 for k in range(9)]


def head(kind: int, count: int) -> bytes:
    if count < 24:
        return bytes([kind << 5 | count])
    size = next(k for k in range(4) if count < 1 << (8 << k))
    return bytes([kind << 5 | 24 + size]) + count.to_bytes(1 << size, "big")


def cbor(value: Any) -> bytes:
    """An encoder, for tests."""
    if value is None or isinstance(value, bool):
        return bytes([{False: 0xF4, True: 0xF5, None: 0xF6}[value]])
    if isinstance(value, int):
        return head(0, value) if value >= 0 else head(1, -1 - value)
    if isinstance(value, float):
        return b"\xfb" + struct.pack(">d", value)
    if isinstance(value, str):
        return head(3, len(value.encode())) + value.encode()
    if isinstance(value, list):
        return head(4, len(value)) + b"".join(map(cbor, value))
    return head(5, len(value)) + b"".join(cbor(key) + cbor(item) for key, item in value.items())


def test_cbor_is_read_as_json_is(tmp_path: Path) -> None:
    rows = [
        {"k": k - 3, "x": k / 7, "ok": k % 2 == 0, "at": {"lat": k * 1.5, "name": f"p{k}"}}
        for k in range(300)
    ]
    mine = flight_of(tmp_path, "s", "", "", [cbor(row) for row in rows], wire="cbor")
    assert not mine.damage.lossy, mine.damage
    theirs = flight_of(
        tmp_path, "s", "jsonschema", "{}", [json.dumps(row).encode() for row in rows], wire="json"
    )
    assert mine.tables["/t"].to_pylist() == theirs.tables["/t"].to_pylist()
    damaged = [cbor(row) for row in rows[:10]]
    damaged[3] = damaged[3][:-4]
    damaged[7] = b"\xff" * 9
    flight = flight_of(tmp_path, "s", "", "", damaged, wire="cbor")
    assert flight.tables["/t"].num_rows == 8
    assert flight.damage.undecoded == {"/t": 2}


def test_cbor_of_the_standard() -> None:
    """Examples of RFC 8949, appendix A."""
    examples = {
        "f93c00": 1.0,
        "fa47c35000": 100000.0,
        "1b000000e8d4a51000": 1000000000000,
        "3903e7": -1000,
        "c11a514b67b0": 1363896240,
        "5f42010243030405ff": "AQI=AwQF",
        "7f657374726561646d696e67ff": "streaming",
        "9f018202039f0405ffff": [1, [2, 3], [4, 5]],
        "bf61610161629f0203ffff": {"a": 1, "b": [2, 3]},
        "f7": None,
    }
    import numpy as np

    for text, value in examples.items():
        raw = np.frombuffer(bytes.fromhex(text), np.uint8)
        (found,) = cbor_as_json(raw, np.array([0]), np.array([len(raw)]))
        assert found is not None, text
        assert json.loads(found) == value, text


def test_flatbuffers_are_named_with_their_count(tmp_path: Path) -> None:
    damage = flight_of(tmp_path, "s", "flatbuffer", "", [b"\x0c\0\0\0"] * 11, wire="flatbuffer").damage
    assert damage.undecoded == {"/t": 11}
    assert "flatbuffer" in damage.reasons["/t"]
