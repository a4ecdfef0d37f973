"""ROS 1 bags against the rosbags library, which writes them here; see also the contract tests."""

from __future__ import annotations

import struct
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flysid.errors import FormatError
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import FORMATS, detect, read
from flysid.ingest.formats.rosbag1.records import record_at
from flysid.ingest.formats.rosbag1.runs import message_run
from tests.samplelogs import rosbag as sample

rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="the rosbags library is not installed")


@pytest.mark.parametrize("compression", ["", "BZ2", "LZ4"])
def test_a_bag_of_the_library_comes_back_bit_for_bit(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "a.bag"
    sent = _write(path, compression)
    flight = read(path)
    assert not flight.damage.lossy, flight.damage
    table = flight.tables["/pose"]
    assert flight.source.format == "rosbag"
    assert table["pose.position.x"].to_pylist() == sent[:, 0].tolist()
    assert table["pose.orientation.w"].to_pylist() == sent[:, 1].tolist()
    assert table["time_ns"].to_pylist() == [10**18 + k * 10**7 for k in range(len(sent))]
    assert table["recv_ns"].to_pylist() == [10**18 + k * 10**7 + 999 for k in range(len(sent))]
    assert table["header.frame_id"].to_pylist() == ["world"] * len(sent)


def _write(path: Path, compression: str) -> Any:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    sent = np.random.default_rng(0).normal(size=(300, 2))
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    with writer:
        link = writer.add_connection("/pose", "geometry_msgs/msg/PoseStamped", typestore=store)
        for k, (x, w) in enumerate(sent.tolist()):
            stamp = types["builtin_interfaces/msg/Time"](sec=10**9 + k // 100, nanosec=k % 100 * 10**7)
            header = types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="world")
            point = types["geometry_msgs/msg/Point"](x=x, y=0.0, z=0.0)
            turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=w)
            pose = types["geometry_msgs/msg/Pose"](position=point, orientation=turn)
            message = types["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)
            raw = store.serialize_ros1(message, "geometry_msgs/msg/PoseStamped")
            writer.write(link, 10**18 + k * 10**7 + 999, raw)
    return sent


def test_a_bag_that_was_never_closed_is_read_from_the_connections_in_its_chunks() -> None:
    blob = sample.build()
    cut = blob.index(sample.message(0, 100))  # in the third chunk
    flight = collect(memoryview(blob[:cut]), "a.bag", FORMATS["rosbag"], Limits())
    assert flight.rows == 100
    assert set(flight.tables) == {"/imu", "/pair"}


def test_a_chunk_that_would_fill_the_memory_is_refused_and_counted() -> None:
    bomb = sample.chunk(bytes(50_000_000), b"bz2")
    at = len(sample.MAGIC)
    blob = sample.build()
    flight = collect(memoryview(blob[:at] + bomb + blob[at:]), "a.bag", FORMATS["rosbag"], Limits())
    assert flight.rows == 160
    assert [(r.start, r.end) for r in flight.damage.regions] == [(at, at + len(bomb))]
    assert "beyond the limits" in flight.damage.regions[0].reason


def test_no_record_at_all_is_an_error_that_names_the_file() -> None:
    with pytest.raises(FormatError, match="no record") as caught:
        collect(memoryview(sample.MAGIC + bytes(99)), "a.bag", FORMATS["rosbag"], Limits())
    assert caught.value.path == "a.bag"


def test_it_is_found_by_its_magic_whatever_its_name() -> None:
    assert detect(sample.MAGIC, "flight.dat").name == "rosbag"


def test_a_cut_between_two_records_is_seen_by_the_index_that_is_missing() -> None:
    blob = sample.build()
    for record in sample.records(blob)[2:-1]:
        flight = collect(memoryview(blob[: record.end]), "a.bag", FORMATS["rosbag"], Limits())
        assert flight.damage.truncated, record
    assert not collect(memoryview(blob), "a.bag", FORMATS["rosbag"], Limits()).damage.truncated


def test_a_chunk_refused_for_its_size_is_no_bad_checksum() -> None:
    blob = sample.build()
    at = len(sample.MAGIC)
    bomb = sample.chunk(bytes(50_000_000), b"bz2")
    damaged = bytearray(sample.chunk(bytes(5000), b"bz2"))
    damaged[-8] ^= 1
    for inserted, bad in ((bomb, 0), (bytes(damaged), 1)):
        flight = collect(memoryview(blob[:at] + inserted + blob[at:]), "a.bag", FORMATS["rosbag"], Limits())
        assert flight.damage.bad_checksums == bad
        assert flight.rows == 160


def test_topics_without_a_stamp_are_named_with_the_distance_of_their_clock() -> None:
    note = collect(memoryview(sample.build()), "a.bag", FORMATS["rosbag"], Limits()).info["clock_note"]
    assert note.startswith("/pair: no stamp, on the time of recording, 0.003 s ahead")


def test_a_connection_whose_length_takes_in_messages_is_counted() -> None:
    raw = bytearray(sample.build())
    at = raw.index(b"topic=/pair", raw.index(sample.connection(1))) + len(
        b"topic=/pair"
    )  # where the length of its data stands
    taken = len(sample.message(0, 0)) + len(sample.message(1, 1))
    raw[at : at + 4] = struct.pack("<I", int.from_bytes(raw[at : at + 4], "little") + taken)
    flight = collect(memoryview(raw), "a.bag", FORMATS["rosbag"], Limits())
    assert flight.rows == 158
    assert flight.damage.undecoded == {"(connections)": 1}


@pytest.mark.parametrize("order", list(permutations(("conn", "op", "time"))))
def test_a_run_of_messages_holds_what_its_records_hold_one_by_one(order: tuple[str, ...]) -> None:
    raw = b"".join(_ordered(order, k) for k in range(5)) + sample.chunk_info()
    run = message_run(raw, 0, len(raw))
    assert len(run) == 4  # the last is not followed by a message
    at = 0
    for place in run:
        record = record_at(raw, at, len(raw))
        assert record is not None
        assert (place.connection, place.data_at, place.end) == (record.connection, record.data_at, record.end)
        seconds, fraction = struct.unpack("<II", record.fields[b"time"])
        assert place.log_ns == seconds * 10**9 + fraction
        at = place.end


def _ordered(order: tuple[str, ...], k: int) -> bytes:
    """A message whose header has its fields in this order."""
    values = {"conn": struct.pack("<I", k), "op": b"\x02", "time": struct.pack("<II", 7 + k, 11 * k)}
    inner = b"".join(
        struct.pack("<I", len(name) + 1 + len(values[name])) + name.encode() + b"=" + values[name]
        for name in order
    )
    return struct.pack("<I", len(inner)) + inner + struct.pack("<I", k) + bytes(k)


def test_a_message_of_a_wrong_length_ends_the_run() -> None:
    raw = bytearray(b"".join(sample.message(0, k) for k in range(5)))
    size = len(raw) // 5
    raw[2 * size + 42] ^= 1  # the length of the data of the third
    assert [place.end for place in message_run(bytes(raw), 0, len(raw))] == [size, 2 * size]
