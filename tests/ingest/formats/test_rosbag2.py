"""ROS 2 bags in SQLite files against the rosbags library; hostile databases. See also the contract tests."""

from __future__ import annotations

import sqlite3
import struct
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from click.testing import CliRunner, Result

from flysid.cli import root
from flysid.errors import FormatError
from flysid.flight import Flight, stem_of
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.common import compression
from flysid.ingest.formats.registry import FORMATS, read
from flysid.ingest.formats.rosbag2 import ros_types as rostypes
from flysid.ingest.formats.rosbag2 import sqlite_pages
from flysid.ingest.formats.rosbag2.sqlite_pages import PageError, columns
from tests.ingest.formats.things import together
from tests.samplelogs import ros
from tests.samplelogs import rosbag2 as sample

WITHOUT_DEFINITIONS = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
"""
POINT = struct.pack("<4x3d", 1.5, -2.0, 3.25).replace(bytes(4), b"\0\1\0\0", 1)


def parse(blob: bytes, limits: Limits | None = None) -> Flight:
    return collect(memoryview(blob), "bag.db3", FORMATS["rosbag2"], limits or Limits())


def flysid(*words: str | Path) -> Result:
    return CliRunner().invoke(root, [str(word) for word in words], standalone_mode=False)


# ------------------------------------------------------------------------------ agreement with rosbags


def mixed_bag(path: Path, count: int) -> Path:
    """A bag of random messages of every kind of field and of large arrays, by the library's writer."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="the rosbags library is not installed")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    own: dict[str, Any] = {}
    for part in ("MSG: pkg/Mixed\n" + ros.MIXED_ALL).split("=" * 80 + "\n"):
        name, _, text = part.removeprefix("MSG: ").partition("\n")
        own.update(get_types_from_msg(text, name.replace("/", "/msg/")))
    store.register(own)
    rng = np.random.default_rng(7)
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3) as writer:
        first = writer.add_connection("/mixed", "pkg/msg/Mixed", typestore=store)
        second = writer.add_connection("/cloud", "std_msgs/msg/Float64MultiArray", typestore=store)
        make = store.types["std_msgs/msg/Float64MultiArray"]
        layout = store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=3)
        for k in range(count):
            raw = ros.encode_ros2("pkg/msg/Mixed", ros.MIXED_ALL, ros.mixed(rng))
            writer.write(first, 10**18 + k, raw)
            cloud = make(layout=layout, data=rng.normal(size=int(rng.integers(2000))))
            writer.write(second, 10**18 + k, store.serialize_cdr(cloud, second.msgtype))
    return path / f"{path.name}.db3"


def plain(value: Any) -> Any:
    """A message of the rosbags library as dictionaries and lists."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [plain(v) for v in value]
    if hasattr(value, "__msgtype__"):
        names = [f.name for f in fields(value) if not (f.name.startswith("__") or f.name.isupper())]
        return {n: plain(getattr(value, n)) for n in names}
    return value


def test_every_field_of_every_message_equals_rosbags(tmp_path: Path) -> None:
    path = mixed_bag(tmp_path / "bag", 60)
    from rosbags.highlevel import AnyReader

    theirs: dict[str, list[dict[str, Any]]] = {}
    with AnyReader([path.parent]) as reader:
        for link, when, raw in reader.messages():
            message = ros.dotted(plain(reader.deserialize(raw, link.msgtype)))
            theirs.setdefault(link.topic, []).append({"recv_ns": when, **message})
    flight = read(path)
    assert flight.source.format == "rosbag2"
    assert not flight.damage.lossy, flight.damage
    assert {stem_of(name) for name in flight.tables} == set(theirs) == {"/mixed", "/cloud"}
    for topic, rows in theirs.items():
        ours = together(flight, topic).drop_columns(["time_ns", "boot"]).to_pylist()
        assert len(ours) == len(rows) == 60
        for mine, other in zip(ours, rows, strict=True):
            np.testing.assert_equal(mine, other)


def test_a_bag_folder_is_ingested_by_its_files(tmp_path: Path) -> None:
    path = mixed_bag(tmp_path / "bag", 5)
    (tmp_path / "bag" / "bag_1.db3.zstd").write_bytes(
        zstandard.compress(mixed_bag(tmp_path / "b", 6).read_bytes())
    )
    seen = flysid("doctor", tmp_path / "bag")
    assert not seen.return_value
    assert "bag.db3 " in seen.stdout
    assert "bag_1.db3.zstd" in seen.stdout
    done = flysid("ingest", path.parent, "-o", tmp_path / "data")
    assert not done.return_value
    assert len(done.stdout.splitlines()) == 2


# --------------------------------------------------------------------- bags that hold no message text


def test_types_that_the_bag_does_not_define_are_those_of_ros_2_humble() -> None:
    pytest.importorskip("rosbags.typesys", reason="the rosbags library is not installed")
    topics = [("/p", "geometry_msgs/msg/Point", "", ""), ("/mine", "my_msgs/msg/Own", "", "")]
    flight = parse(sample.database(topics, [(1, 5, POINT), (2, 6, POINT)], tables=WITHOUT_DEFINITIONS))
    assert flight.tables["/p"].select(["x", "y", "z"]).to_pylist() == [{"x": 1.5, "y": -2.0, "z": 3.25}]
    assert flight.info["definitions"] == "ROS 2 Humble, by rosbags"
    assert flight.damage.undecoded == {"/mine": 1}
    assert "no definition of my_msgs/msg/Own in the bag" in flight.damage.reasons["/mine"]


def test_without_the_library_the_reason_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rostypes, "_has_rosbags", lambda: False)
    topics = [("/p", "geometry_msgs/msg/Point", "", "")]
    flight = parse(sample.database(topics, [(1, 5, POINT)], tables=WITHOUT_DEFINITIONS))
    assert "pip install 'flysid[bags]'" in flight.damage.reasons["/p"]
    assert flight.damage.lossy


def test_definitions_in_idl_need_no_library() -> None:
    head = "=" * 80 + "\nIDL: p/msg/Pair\n"
    idl = head + "module p { module msg { struct Pair { double x; int32 k; }; }; };\n"
    data = struct.pack("<4xdi", 2.5, -7).replace(bytes(4), b"\0\1\0\0", 1)
    flight = parse(sample.database([("/pair", "p/msg/Pair", "ros2idl", idl)], [(1, 5, data)]))
    assert flight.tables["/pair"].select(["x", "k"]).to_pylist() == [{"x": 2.5, "k": -7}]
    broken = parse(sample.database([("/pair", "p/msg/Pair", "ros2idl", "module {")], [(1, 5, data)]))
    assert "IDL" in broken.damage.reasons["/pair"]


def test_the_reason_is_shown_by_ingest_and_doctor(tmp_path: Path) -> None:
    topics = [
        ("/w", "p/msg/W", "ros2msg", "float128 w\n"),
        ("/p", "p/msg/P", "ros2msg", "float64 x\nfloat64 y\n"),
    ]
    path = tmp_path / "a.db3"
    path.write_bytes(sample.database(topics, [(1, 5, POINT), (2, 6, POINT)]))
    for done in (flysid("doctor", path), flysid("ingest", path, "-o", tmp_path / "data")):
        assert done.return_value == 3
        assert "/w: type p/float128 is not defined" in done.stderr


# ---------------------------------------------------------------------------------------- compression


def test_messages_compressed_one_by_one_are_expanded() -> None:
    rows = [sample.payload(k) for k in range(20)]
    packed = [(topic, when, zstandard.compress(data)) for topic, when, data in rows]
    plain_flight, flight = (parse(sample.database(sample.TOPICS, r)) for r in (rows, packed))
    assert flight.tables == plain_flight.tables


def test_bombs_stop_at_the_limits() -> None:
    bomb = zstandard.compress(bytes(1 << 26))
    flight = parse(sample.database(sample.TOPICS, [(1, 5, bomb), sample.payload(1)]))
    assert flight.rows == 1
    assert "beyond the limits" in flight.damage.reasons["/stamped"]


# ------------------------------------------------------------------------------------ hostile databases


def test_another_database_is_refused_with_words(tmp_path: Path) -> None:
    blob = sample.database([], [], tables="CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, a, b);")
    with pytest.raises(FormatError, match="no table of messages"):
        parse(blob)
    path = tmp_path / "contacts.sqlite"
    path.write_bytes(blob)
    with pytest.raises(FormatError, match="an SQLite database that is no ROS 2 bag: it defines topics"):
        read(path)


def test_a_bag_without_messages_is_an_empty_flight() -> None:
    flight = parse(sample.database(sample.TOPICS, []))
    assert flight.rows == 0
    assert not flight.damage.lossy


def test_without_the_table_of_topics_every_message_is_counted() -> None:
    blob = sample.build()
    flight = parse(
        blob.replace(b"CREATE TABLE topics", b"CREATE TABLE topicz").replace(b"topicstopics", b"topiczxopicz")
    )
    assert flight.rows == 0
    assert sum(flight.damage.undecoded.values()) == sample.ROWS


def test_rows_on_pages_that_no_tree_reaches_are_found_and_deleted_ones_are_not(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    path.write_bytes(sample.database(sample.TOPICS, [sample.payload(k) for k in range(600)], 4096))
    link = sqlite3.connect(path)
    link.execute("DELETE FROM messages WHERE id <= 300")
    (root,) = link.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    link.commit()
    link.close()
    blob = bytearray(path.read_bytes())
    assert parse(bytes(blob)).rows == 300
    blob[(root - 1) * 4096 : root * 4096] = bytes(4096)
    flight = parse(bytes(blob))
    assert flight.rows == 300
    assert [(r.start, r.end) for r in flight.damage.regions] == [((root - 1) * 4096, root * 4096)]


def test_pages_that_refer_to_each_other_do_not_hang() -> None:
    blob = bytearray(sample.build())
    for place in range(sample.PAGE_BYTES, len(blob), sample.PAGE_BYTES):
        if blob[place] == 5:  # every child of an inner page is the page itself
            number = struct.pack(">I", place // sample.PAGE_BYTES + 1)
            blob[place + 8 : place + 12] = number
    assert parse(bytes(blob)).rows == sample.ROWS


def test_an_inner_page_whose_cell_runs_past_its_end_costs_no_row() -> None:
    raw = bytearray(sample.build())
    size = sample.PAGE_BYTES
    at = next(k for k in range(0, len(raw), size) if raw[k] == sqlite_pages.PageKind.INNER)
    raw[at + 12 : at + 14] = struct.pack(">H", size - 6)
    raw[at + size - 6 : at + size] = raw[at + 300 : at + 304] + b"\xff\xff"  # a key without an end
    flight = parse(bytes(raw))
    assert flight.rows == sample.ROWS
    assert flight.damage.lossy


def test_overflow_pages_shared_by_many_rows_are_no_bomb(monkeypatch: pytest.MonkeyPatch) -> None:
    blob = sample.database(sample.TOPICS, [(2, k, bytes(100_000)) for k in range(60)], 4096)
    assert parse(blob).damage.bytes_skipped == 0
    monkeypatch.setattr(sqlite_pages, "SHARED_TIMES", 0.5)  # as if every chain were read four times
    flight = parse(blob)
    assert "rows share overflow pages" in {region.reason for region in flight.damage.regions}


@pytest.mark.parametrize(
    "raw", [b"", b"\xff" * 8, b"\x09\x01", b"\x03\x0a\x01", b"\x02\x07abc", b"\x02\x0dab"]
)
def test_rows_that_do_not_hold_together_are_refused(raw: bytes) -> None:
    with pytest.raises(PageError):
        columns(raw)


def test_values_of_every_type_are_those_of_sqlite(tmp_path: Path) -> None:
    values = [
        None,
        0,
        1,
        -1,
        127,
        -40000,
        10**6,
        -(2**31),
        2**40,
        -(2**62),
        2.5,
        "ä\0b",
        b"\x00\xff",
        "",
        b"",
    ]
    link = sqlite3.connect(tmp_path / "a.db3")
    link.execute("CREATE TABLE t(" + ", ".join(f"c{k}" for k in range(len(values))) + ")")
    link.execute("INSERT INTO t VALUES (" + ", ".join("?" * len(values)) + ")", values)
    link.commit()
    link.close()
    from flysid.ingest.formats.rosbag2.sqlite_tables import Tables

    tables = Tables(memoryview((tmp_path / "a.db3").read_bytes()))
    (row,) = tables.rows("t", lambda _: True)
    assert list(row) == [1, *values[1:]]  # a null first column is the row id
    assert not tables.faults


def test_what_one_step_of_expanding_a_file_gives_is_bounded() -> None:
    packed = zstandard.compress(bytes(1 << 27))
    assert max(len(piece) for piece in compression.unpacked_pieces(memoryview(packed), 1e6)) < 20 << 20
