"""MCAP: every encoding against the mcap libraries' own decoders, then time, units and stream keys."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType

import flysid
from flysid.flight import Flight, field_unit
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import FORMATS
from tests.command import call
from tests.ingest.formats.things import together
from tests.samplelogs import ros
from tests.samplelogs.mcap import Topic, json_topic, mcap_file, ros1_topic, ros2_topic


def read(raw: bytes, limits: Limits | None = None) -> Flight:
    return collect(memoryview(raw), "test.mcap", FORMATS["mcap"], limits or Limits())


def rows_of(table: pa.Table) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = table.drop_columns(["time_ns", "boot", "recv_ns"]).to_pylist()
    return rows


def oracle(raw: bytes, factory: Any) -> dict[str, list[dict[str, Any]]]:
    """Every message of a file by the library's decoder, flattened as ours are."""
    found: dict[str, list[dict[str, Any]]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reader = make_reader(io.BytesIO(raw), decoder_factories=[factory])
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(ros.dotted(ros.plain(message)))
    return found


def assert_same(ours: Sequence[dict[str, Any]], theirs: Sequence[dict[str, Any]]) -> None:
    assert len(ours) == len(theirs)
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_equal(mine, other)


def pose(k: int, frame: str, seconds: str, fraction: str) -> dict[str, Any]:
    x = 0.25 * k
    return {
        "header": {"seq": k, "stamp": {seconds: 5 + k, fraction: 17}, "frame_id": frame},
        "pose": {
            "position": {"x": x, "y": -x, "z": x * x},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8},
        },
    }


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("frames", [["map"], ["map", "base_link", ""]])
def test_ros1_poses_equal_the_library(compression: CompressionType, frames: list[str]) -> None:
    kind = "geometry_msgs/PoseStamped"
    types = ros.ros1_types(kind, ros.POSE_STAMPED_1)
    payloads = [
        ros.encode_ros1(types, kind, pose(k, frames[k % len(frames)], "secs", "nsecs")) for k in range(60)
    ]
    raw = mcap_file([ros1_topic("/pose", kind, ros.POSE_STAMPED_1, payloads)], compression=compression)
    from mcap_ros1.decoder import DecoderFactory

    table = together(read(raw), "/pose")
    assert_same(rows_of(table), oracle(raw, DecoderFactory())["/pose"])
    assert table["time_ns"].to_pylist() == [(5 + k) * 10**9 + 17 for k in range(60)]
    assert table["recv_ns"].to_pylist() == [10**9 + k * 10**7 for k in range(60)]
    assert table.schema.metadata[b"time_source"] == b"header.stamp"


@pytest.mark.parametrize("chunked", [True, False])
def test_ros2_poses_equal_the_library(chunked: bool) -> None:
    kind = "geometry_msgs/msg/PoseStamped"
    payloads = [
        ros.encode_ros2(kind, ros.POSE_STAMPED_2, pose(k, "map"[: k % 4], "sec", "nanosec"))
        for k in range(60)
    ]
    raw = mcap_file([ros2_topic("/pose", kind, ros.POSE_STAMPED_2, payloads)], chunked=chunked)
    from mcap_ros2.decoder import DecoderFactory

    table = together(read(raw), "/pose")
    assert_same(rows_of(table), oracle(raw, DecoderFactory())["/pose"])
    assert table["time_ns"].to_pylist() == [(5 + k) * 10**9 + 17 for k in range(60)]


@pytest.mark.parametrize("seed", range(4))
def test_every_ros2_field_equals_the_library(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kind = "pkg/msg/Mixed"
    payloads = [ros.encode_ros2(kind, ros.MIXED_ALL, ros.mixed(rng)) for _ in range(40)]
    raw = mcap_file([ros2_topic("/mixed", kind, ros.MIXED_ALL, payloads)])
    from mcap_ros2.decoder import DecoderFactory

    assert_same(rows_of(together(read(raw), "/mixed")), oracle(raw, DecoderFactory())["/mixed"])


@pytest.mark.parametrize("seed", range(4))
def test_every_ros1_field_equals_the_library(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kind = "pkg/Mixed"
    types = ros.ros1_types(kind, ros.MIXED_ALL)
    payloads = [ros.encode_ros1(types, kind, ros.mixed(rng)) for _ in range(40)]
    raw = mcap_file([ros1_topic("/mixed", kind, ros.MIXED_ALL, payloads)])
    from mcap_ros1.decoder import DecoderFactory

    assert_same(rows_of(together(read(raw), "/mixed")), oracle(raw, DecoderFactory())["/mixed"])


def test_protobuf_equals_the_library() -> None:
    pytest.importorskip("google.protobuf")
    from mcap_protobuf.decoder import DecoderFactory
    from mcap_protobuf.schema import build_file_descriptor_set

    from tests.samplelogs.proto import sample_class, sample_message

    cls = sample_class()
    messages = [sample_message(cls, k) for k in range(50)]
    stamped = [(k * 10**7 + 10**9, m.SerializeToString()) for k, m in enumerate(messages)]
    schema = build_file_descriptor_set(cls).SerializeToString()
    raw = mcap_file([Topic("/proto", "protobuf", "test.Sample", "protobuf", schema, stamped)])
    table = read(raw)["/proto"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        decoded = [
            m
            for *_, m in make_reader(
                io.BytesIO(raw), decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        ]
    assert table["position.x"].to_pylist() == [m.position.x for m in decoded]
    assert table["name"].to_pylist() == [m.name for m in decoded]
    assert table["values"].to_pylist() == [list(m.values) for m in decoded]
    assert table["mode"].to_pylist() == [m.mode for m in decoded]
    assert b'"HOVER"' in table.schema.field("mode").metadata[b"enum"]
    assert table["blob"].to_pylist() == [m.blob for m in decoded]
    assert [[p["x"] for p in row] for row in table["path"].to_pylist()] == [
        [p.x for p in m.path] for m in decoded
    ]
    assert [{e["key"]: e["value"] for e in row} for row in table["gains"].to_pylist()] == [
        dict(m.gains) for m in decoded
    ]
    assert table["time_ns"].to_pylist() == [m.stamp.seconds * 10**9 + m.stamp.nanos for m in decoded]
    assert table.schema.metadata[b"time_source"] == b"stamp"


VELOCITY = {
    "type": "object",
    "properties": {
        "stamp": {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
        "velocity": {"type": "object", "properties": {"x": {"type": "number", "unit": "m/s"}}},
        "label": {"type": "string"},
        "gains": {"type": "array", "items": {"type": "number"}},
        "armed": {"type": "boolean"},
    },
}


def velocity(k: int) -> dict[str, Any]:
    return {
        "stamp": {"sec": k, "nsec": 5},
        "velocity": {"x": k / 7},
        "label": f"row {k}\n\u00e9",
        "gains": [0.1] * (k % 3),
        "armed": k % 2 == 0,
    }


def test_json_columns_units_and_stamps() -> None:
    rows = [velocity(k) for k in range(30)]
    table = read(mcap_file([json_topic("/velocity", VELOCITY, rows)]))["/velocity"]
    assert rows_of(table) == [ros.dotted(r) for r in rows]
    assert field_unit(table.schema.field("velocity.x")) == "m/s"
    assert table["time_ns"].to_pylist() == [k * 10**9 + 5 for k in range(30)]


def test_json_that_strict_readers_refuse_is_read_as_python_does() -> None:
    rows = [velocity(k) for k in range(4)]
    rows[2]["velocity"]["x"] = float("nan")
    table = read(mcap_file([json_topic("/velocity", VELOCITY, rows)]))["/velocity"]
    assert np.isnan(table["velocity.x"].to_pylist()[2])
    assert table["label"].to_pylist() == [r["label"] for r in rows]


def test_json_without_schema_is_inferred_and_bad_messages_are_counted() -> None:
    good = [(k * 10**7, b'{"a": %d, "b": {"c": "2020-01-01"}}' % k) for k in range(5)]
    topic = Topic("/free", "json", "", "", b"", [*good, (10**9, b"{not json"), (10**9 + 1, b"[1, 2]")])
    flight = read(mcap_file([topic]))
    assert flight["/free"]["a"].to_pylist() == [0, 1, 2, 3, 4]
    assert flight["/free"]["b.c"].to_pylist() == ["2020-01-01"] * 5
    assert flight.damage.undecoded == {"/free": 2}
    assert flight.damage.lossy


def test_a_topic_whose_layout_changes_goes_on_under_another_key() -> None:
    rows = [{"a": 1}] * 3
    first = json_topic("/t", {"type": "object", "properties": {"a": {"type": "integer"}}}, rows)
    second = json_topic("/t", {"type": "object", "properties": {"a": {"type": "number"}}}, rows)
    flight = read(mcap_file([first, second]))
    assert flight["/t"].schema.field("a").type == pa.int64()
    assert flight["/t~2"].schema.field("a").type == pa.float64()


def test_an_unknown_encoding_is_named_and_the_rest_is_read() -> None:
    odd = Topic("/odd", "cbor", "x", "whatever", b"", [(1, b"1"), (2, b"2")])
    flight = read(mcap_file([odd, json_topic("/velocity", VELOCITY, [velocity(1)])]))
    assert flight.damage.undecoded == {"/odd": 2}
    assert flight.streams == ("/velocity",)


def test_fields_named_like_ours_are_kept_under_another_name() -> None:
    flight = read(mcap_file([json_topic("/t", {}, [{"time_ns": 3, "boot": 4}])]))
    assert flight["/t"]["time_ns_"].to_pylist() == [3]
    assert flight["/t"]["boot_"].to_pylist() == [4]


def test_small_batches_give_the_same_tables() -> None:
    kind = "pkg/msg/Mixed"
    rng = np.random.default_rng(9)
    payloads = [ros.encode_ros2(kind, ros.MIXED_ALL, ros.mixed(rng)) for _ in range(60)]
    raw = mcap_file([ros2_topic("/mixed", kind, ros.MIXED_ALL, payloads)], chunk_size=1000)
    np.testing.assert_equal(
        rows_of(together(read(raw, Limits(batch_bytes=2000)), "/mixed")),
        rows_of(together(read(raw), "/mixed")),
    )


@pytest.mark.parametrize("chunked", [True, False])
def test_messages_without_a_log_time_have_that_of_their_publishing(chunked: bool, tmp_path: Path) -> None:
    topic = json_topic("/a", {"properties": {"k": {"type": "integer"}}}, [{"k": k} for k in range(80)])
    (tmp_path / "a.mcap").write_bytes(mcap_file([topic], chunked=chunked, recorded=False))
    flight = flysid.read(tmp_path / "a.mcap")
    whole = read(mcap_file([topic], chunked=chunked))
    assert flight.tables["/a"].equals(whole.tables["/a"])
    assert np.diff(flight.tables["/a"]["time_ns"].to_numpy()).min() == 10**7
    assert "80 messages without a log time: the time of publishing stands for it" in flight.info["clock_note"]
    assert "clock_note" not in whole.info
    done = call("doctor", "a.mcap", cwd=tmp_path)
    assert "the time of publishing stands for it" in " ".join(done.stderr.split())


def test_front_door(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    path.write_bytes(mcap_file([json_topic("/velocity", VELOCITY, [velocity(k) for k in range(5)])]))
    flight = flysid.read(path)
    assert flight.source.format == "mcap"
    assert flight["velocity"].num_rows == 5
    assert not flight.damage.lossy
    assert flight.clocks[0].first_ns == 5


@pytest.mark.parametrize("seed", range(6))
def test_protobuf_payloads_damaged_anywhere_are_read_as_the_library_reads_them_or_counted(seed: int) -> None:
    pytest.importorskip("google.protobuf")
    from google.protobuf.message import DecodeError
    from mcap_protobuf.schema import build_file_descriptor_set

    from tests.samplelogs.proto import sample_class, sample_message

    rng = np.random.default_rng(seed)
    cls = sample_class()
    payloads = []
    for k in range(120):
        raw = bytearray(sample_message(cls, k % 7 + 1).SerializeToString())
        if k % 3 == 0:
            raw = raw[: rng.integers(len(raw))]
        elif k % 3 == 1:
            raw[rng.integers(len(raw))] ^= 1 << int(rng.integers(8))
        payloads.append(bytes(raw))
    schema = build_file_descriptor_set(cls).SerializeToString()
    stamped = [(10**9 + k, p) for k, p in enumerate(payloads)]
    flight = read(mcap_file([Topic("/p", "protobuf", "test.Sample", "protobuf", schema, stamped)]))
    table = flight["/p"]
    assert table.num_rows + flight.damage.undecoded.get("/p", 0) == 120
    ours = dict(zip(table["recv_ns"].to_pylist(), table.to_pylist(), strict=True))
    for when, payload in stamped:
        try:
            theirs = cls.FromString(payload)
        except DecodeError:
            continue  # the library also refuses text that is not UTF-8; ours replaces it
        mine = ours[when]
        np.testing.assert_equal(mine["values"], list(theirs.values))
        np.testing.assert_equal(mine["counts"], list(theirs.counts))
        np.testing.assert_equal(mine["words"], list(theirs.words))
        for name in ("signed", "fixed", "flag", "mode", "name", "blob"):
            assert mine[name] == getattr(theirs, name), name
        np.testing.assert_equal(mine["position.x"], theirs.position.x)


NAVDATA_FIELDS = """Header header
float32 batteryPercent
uint32 state
int32 magX
int32 magY
int32 magZ
int32 pressure
int32 temp
float32 wind_speed
float32 wind_angle
float32 wind_comp_angle
float32 rotX
float32 rotY
float32 rotZ
int32 altd
float32 vx
float32 vy
float32 vz
float32 ax
float32 ay
float32 az
uint8 motor1
uint8 motor2
uint8 motor3
uint8 motor4
uint32 tags_count
uint32[] tags_type
uint32[] tags_xc
uint32[] tags_yc
uint32[] tags_width
uint32[] tags_height
float32[] tags_orientation
float32[] tags_distance
float32 tm
"""
ARDRONE = Path(__file__).resolve().parents[4] / "shared" / "logs" / "ardrone"
NAMES = {"rotX": "rotX_deg", "rotY": "rotY_deg", "rotZ": "rotZ_deg", "vx": "vx_mm_s", "vy": "vy_mm_s"}
NAMES |= {"vz": "vz_mm_s", "ax": "ax_g", "ay": "ay_g", "az": "az_g", "altd": "altd_mm"}
NAMES |= {f"motor{k}": f"motor{k}" for k in range(1, 5)}


def split_stamp(seconds: np.ndarray[Any, Any]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    whole = np.floor(seconds).astype(np.int64)
    return whole, np.round((seconds - whole) * 1e9).astype(np.int64)


@pytest.mark.skipif(not ARDRONE.exists(), reason="no ../shared/logs/ardrone here")
def test_a_real_ardrone_flight_as_ros1_navdata_comes_back_equal(tmp_path: Path) -> None:
    import struct

    import pyarrow.parquet as pq

    table = pq.read_table(ARDRONE / "ardrone2_flight_nav_198hz.parquet")
    source = {name: table[name].to_numpy() for name in table.column_names}
    seconds, nanos = split_stamp(source["stamp"])
    payloads = []
    order = ["rotX", "rotY", "rotZ", "altd", "vx", "vy", "vz", "ax", "ay", "az"]
    columns = [source[NAMES[n]].tolist() for n in order] + [source[f"motor{k}"].tolist() for k in range(1, 5)]
    for k, values in enumerate(zip(*columns, strict=True)):
        head = struct.pack("<III", k, seconds[k], nanos[k]) + struct.pack("<I", 9) + b"base_link"
        body = struct.pack("<fI3i2i3f", 80.0, 3, 0, 0, 0, 0, 0, 0.0, 0.0, 0.0)
        body += struct.pack("<3fi6f4B", *values)
        tags = k % 3
        body += struct.pack("<I", tags)
        body += b"".join(struct.pack(f"<I{tags}I", tags, *range(tags)) for _ in range(5))
        body += b"".join(struct.pack(f"<I{tags}f", tags, *([0.5] * tags)) for _ in range(2))
        payloads.append(head + body + struct.pack("<f", k))
    text = ros.definition(NAVDATA_FIELDS, std_msgs__Header=ros.HEADER_1)
    path = tmp_path / "ardrone.mcap"
    topic = ros1_topic("/ardrone/navdata", "ardrone_autonomy/Navdata", text, payloads)
    path.write_bytes(mcap_file([topic], chunk_size=1 << 20))
    flight = flysid.read(path)
    back = flight["/ardrone/navdata"]
    assert not flight.damage.lossy
    assert back["time_ns"].to_pylist() == (seconds * 10**9 + nanos).tolist()
    for name, column in NAMES.items():
        expected = source[column]
        if expected.dtype == np.float64:
            expected = expected.astype(np.float32)
        np.testing.assert_array_equal(back[name].to_numpy(), expected, err_msg=name)
    assert back["tags_type"].to_pylist()[:3] == [[], [0], [0, 1]]


@pytest.mark.skipif(not ARDRONE.exists(), reason="no ../shared/logs/ardrone here")
def test_motion_capture_as_ros1_poses_comes_back_equal(tmp_path: Path) -> None:
    import struct

    import pyarrow.parquet as pq

    table = pq.read_table(ARDRONE / "ardrone2_flight_optitrack_120hz.parquet")
    source = {name: table[name].to_numpy() for name in table.column_names}
    seconds, nanos = split_stamp(source["stamp"])
    names = ["x", "y", "z", "qx", "qy", "qz", "qw"]
    rows = zip(*(source[n].tolist() for n in names), strict=True)
    payloads = [
        struct.pack("<III", k, seconds[k], nanos[k])
        + struct.pack("<I", 5)
        + b"world"
        + struct.pack("<7d", *row)
        for k, row in enumerate(rows)
    ]
    path = tmp_path / "optitrack.mcap"
    topic = ros1_topic("/optitrack/pose", "geometry_msgs/PoseStamped", ros.POSE_STAMPED_1, payloads)
    path.write_bytes(mcap_file([topic], chunk_size=1 << 20))
    back = flysid.read(path)["/optitrack/pose"]
    assert back["time_ns"].to_pylist() == (seconds * 10**9 + nanos).tolist()
    for name in "xyz":
        np.testing.assert_array_equal(back[f"pose.position.{name}"].to_numpy(), source[name])
    for name in "xyzw":
        np.testing.assert_array_equal(back[f"pose.orientation.{name}"].to_numpy(), source[f"q{name}"])
