"""MCAP in four encodings, a ROS 2 bag in SQLite, and ULog, against the libraries of their makers."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.harness import LOGS, Case

HERE = "bench.cases_bags"
OURS = "bench.readers:flysid_tables"
TARGET_BYTES = 150_000_000
DB3_BYTES = 60_000_000
PARQUET = "ardrone/ardrone2_flight_nav_198hz.parquet"
ULOG = "ulog/quad_stabilised_92s.ulg"

Encoded = Iterator[tuple[int, int, bytes]]  # (channel, log time in ns, payload)


def flight() -> dict[str, np.ndarray[Any, Any]]:
    """Columns of the real AR.Drone flight."""
    import pyarrow.parquet as pq

    table = pq.read_table(LOGS / PARQUET)
    return {name: table[name].to_numpy() for name in table.column_names}


def samples(bytes_each: int) -> Iterator[tuple[int, int, list[float]]]:
    """(number, time in ns, angles and speeds) of the flight over and over, until the file is full."""
    columns = flight()
    stamp = ((columns["stamp"] - columns["stamp"][0]) * 1e9).astype(np.int64)
    values = np.stack(
        [columns[n] for n in ("rotX_deg", "rotY_deg", "rotZ_deg", "vx_mm_s", "vy_mm_s")], axis=1
    )
    rows = values.tolist()
    for k in range(TARGET_BYTES // bytes_each):
        turn, row = divmod(k, len(rows))
        yield k, 1_603_996_437 * 10**9 + int(stamp[row]) + turn * 75 * 10**9, rows[row]


def write_mcap(path: Path, channels: list[tuple[str, str, str, str, bytes]], messages: Encoded) -> None:
    """A file of (topic, encoding, type, schema encoding, schema) with the writer's default chunks."""
    from mcap.writer import Writer

    with path.open("wb") as out:
        writer = Writer(out)
        writer.start()
        ids = []
        for topic, encoding, kind, schema_encoding, schema in channels:
            ids.append(
                writer.register_channel(
                    topic, encoding, writer.register_schema(kind, schema_encoding, schema)
                )
            )
        for channel, time_ns, payload in messages:
            writer.add_message(ids[channel], time_ns, payload, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def build_ros(ros: int, uneven: bool) -> Callable[[Path], None]:
    """ROS messages: poses with covariance, or messages with strings and sequences."""

    def build(path: Path) -> None:
        text, kind, templates, places = ros_messages(ros, uneven)
        encoding, schema = ("ros1", "ros1msg") if ros == 1 else ("cdr", "ros2msg")
        channel = ("/topic", encoding, kind, schema, text.encode())
        write_mcap(path, [channel], patched(templates, places))

    return build


def build_ros2_sequences(path: Path) -> None:
    """ROS 2 messages with strings and sequences."""
    build_ros(2, True)(path)


def patched(templates: list[bytes], places: list[tuple[int, int]]) -> Encoded:
    """Templates in turn, with stamp and values of the flight written into them."""
    for k, time_ns, values in samples(sum(map(len, templates)) // len(templates)):
        payload = bytearray(templates[k % len(templates)])
        stamp, first = places[k % len(templates)]
        struct.pack_into("<II", payload, stamp, *divmod(time_ns, 10**9))
        struct.pack_into("<5d", payload, first, *values)
        yield 0, time_ns, bytes(payload)


def ros_messages(ros: int, uneven: bool) -> tuple[str, str, list[bytes], list[tuple[int, int]]]:
    """Definition, type, templates and (place of the stamp, place of five doubles) in each."""
    from tests.samplelogs import ros as text

    header = "uint32 seq\ntime stamp\nstring frame_id\n" if ros == 1 else text.HEADER_2
    body = "Header header\n" if ros == 1 else "std_msgs/Header header\n"
    body += "float64[5] values\nfloat64[36] covariance\nfloat32 battery\nuint8 mode\n"
    body += "uint32 count\nfloat64 height\n"
    if uneven:
        body += "string status\nfloat64[] motors\nstring[] names\np/Tag[] tags\n"
    needed = {"std_msgs__Header": header, "p__Tag": "uint32 kind\nfloat32 x\nfloat32 y\n"}
    if ros == 2:
        needed["builtin_interfaces__Time"] = "int32 sec\nuint32 nanosec\n"
    kind = "p/Sample" if ros == 1 else "p/msg/Sample"
    full = text.definition(body, **needed)
    templates = [ros_payload(ros, full, kind, k if uneven else 0) for k in range(4)]
    mark = struct.pack("<5d", *MARKS)
    return full, kind, templates, [(4, t.index(mark)) for t in templates]


MARKS = (0.1, 0.2, 0.3, 0.4, 0.5)


def ros_payload(ros: int, definition: str, kind: str, k: int) -> bytes:
    """One message; `k` varies the lengths."""
    from tests.samplelogs import ros as text

    seconds, fraction = ("secs", "nsecs") if ros == 1 else ("sec", "nanosec")
    message = {
        "header": {"seq": k, "stamp": {seconds: 1, fraction: 2}, "frame_id": "base_link"},
        "values": list(MARKS),
        "covariance": [0.01 * j for j in range(36)],
        "battery": 80.0,
        "mode": 3,
        "count": k,
        "height": 1.5,
        "status": "flying" + "!" * k,
        "motors": [1.0, 2.0, 3.0, 4.0][:k],
        "names": ["front", "rear", "left"][:k],
        "tags": [{"kind": j, "x": 0.5, "y": -0.5} for j in range(k)],
    }
    if ros == 2:
        return text.encode_ros2(kind, definition, message)
    return text.encode_ros1(text.ros1_types(kind, definition), kind, message)


def build_db3(path: Path) -> None:
    """60 MB of the same ROS 2 messages with strings and sequences, as a bag in SQLite."""
    from flysid.ingest.formats.rosbag2.scrub import TABLES

    text, kind, templates, places = ros_messages(2, True)
    few = itertools.islice(patched(templates, places), DB3_BYTES // len(templates[0]))
    path.unlink(missing_ok=True)
    with contextlib.closing(sqlite3.connect(path)) as link:
        link.executescript(TABLES)
        link.execute("INSERT INTO topics VALUES (1, '/topic', ?, 'cdr', '', '')", (kind,))
        link.execute("INSERT INTO message_definitions VALUES (1, ?, 'ros2msg', ?, '')", (kind, text))
        rows = ((time_ns, payload) for _, time_ns, payload in few)
        link.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)", rows)
        link.commit()


def build_json(path: Path) -> None:
    """JSON messages of a pose with 5 numbers, a stamp and a label."""
    number = {"type": "number", "unit": "deg"}
    names = ("rotX", "rotY", "rotZ", "vx", "vy")
    stamp = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
    properties = {"stamp": stamp, "frame": {"type": "string"}, **dict.fromkeys(names, number)}
    schema = json.dumps({"type": "object", "properties": properties}).encode()

    def messages() -> Encoded:
        for _, time_ns, values in samples(200):
            sec, nsec = divmod(time_ns, 10**9)
            row = {
                "stamp": {"sec": sec, "nsec": nsec},
                "frame": "base_link",
                **dict(zip(names, values, strict=True)),
            }
            yield 0, time_ns, json.dumps(row).encode()

    write_mcap(path, [("/topic", "json", "pose", "jsonschema", schema)], messages())


def build_protobuf(path: Path) -> None:
    """Protobuf messages with nested messages, a string and a packed sequence."""
    from mcap_protobuf.schema import build_file_descriptor_set

    from tests.samplelogs.proto import flight_class

    cls = flight_class()
    schema = build_file_descriptor_set(cls).SerializeToString()

    def messages() -> Encoded:
        for _, time_ns, values in samples(130):
            message = cls()
            message.stamp.seconds, message.stamp.nanos = divmod(time_ns, 10**9)
            message.frame = "base_link"
            message.rotation.x, message.rotation.y, message.rotation.z = values[:3]
            message.velocity.x, message.velocity.y = values[3:]
            message.motors.extend(values[:4])
            yield 0, time_ns, message.SerializeToString()

    write_mcap(path, [("/topic", "protobuf", "test.Flight", "protobuf", schema)], messages())


def build_ulog(path: Path) -> None:
    """A real log's definitions once, then its data over and over with rising times."""
    from flysid.ingest.formats.ulog.records import FILE_HEAD_BYTES

    raw = (LOGS / ULOG).read_bytes()
    first: list[bytes] = []
    parts: list[bytes] = []
    at = FILE_HEAD_BYTES
    while at + 3 <= len(raw):
        size, kind = struct.unpack_from("<HB", raw, at)
        (parts if kind in b"DSO" else first).append(raw[at : at + 3 + size])
        at += 3 + size
    body = np.frombuffer(b"".join(parts), dtype=np.uint8).copy()
    starts = np.cumsum([0] + [len(p) for p in parts[:-1]])
    timed = starts[[p[2:3] == b"D" for p in parts]] + 5
    times = np.ndarray((len(body) - 7,), dtype="<u8", buffer=body, strides=(1,))
    with path.open("wb") as out:
        out.write(raw[:FILE_HEAD_BYTES] + b"".join(first))
        while out.tell() < TARGET_BYTES:
            out.write(body.tobytes())
            times[timed] += 93_000_000


def copy_ulog(path: Path) -> None:
    """The 4 MB log as it is."""
    path.write_bytes((LOGS / ULOG).read_bytes())


def build_small_mcap(path: Path) -> None:
    """3 MB of ROS 2 poses with covariance."""
    text, kind, templates, places = ros_messages(2, False)
    few = itertools.islice(patched(templates, places), 3_000_000 // len(templates[0]))
    write_mcap(path, [("/topic", "cdr", kind, "ros2msg", text.encode())], few)


def _decoded(path: Path, factory: Any) -> Any:
    """The last message of each topic, after decoding them all."""
    from mcap.reader import make_reader

    last = {}
    with path.open("rb") as file:
        for _, channel, _, message in make_reader(file, decoder_factories=[factory]).iter_decoded_messages():
            last[channel.topic] = message
    return last


def peer_ros1(path: Path) -> Any:
    """mcap-ros1-support."""
    from mcap_ros1.decoder import DecoderFactory

    return _decoded(path, DecoderFactory())


def peer_ros2(path: Path) -> Any:
    """mcap-ros2-support."""
    from mcap_ros2.decoder import DecoderFactory

    return _decoded(path, DecoderFactory())


def peer_rosbags(path: Path) -> Any:
    """rosbags' decoder over SQLite's rows, as its reader does, which asks for a metadata.yaml besides."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    last = None
    with contextlib.closing(sqlite3.connect(path)) as link:
        query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
        kind, text = link.execute(query).fetchone()
        store.register({k: v for k, v in get_types_from_msg(text, kind).items() if k not in store.fielddefs})
        for _, raw in link.execute("SELECT timestamp, data FROM messages ORDER BY timestamp"):
            last = store.deserialize_cdr(raw, kind)
    return last


def peer_protobuf(path: Path) -> Any:
    """mcap-protobuf-support."""
    from mcap_protobuf.decoder import DecoderFactory

    return _decoded(path, DecoderFactory())


def peer_json(path: Path) -> Any:
    """mcap with the json module."""
    from mcap.reader import make_reader

    last = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            last[channel.topic] = json.loads(message.data)
    return last


def peer_pyulog(path: Path) -> Any:
    """pyulog."""
    from pyulog import ULog

    with contextlib.redirect_stdout(io.StringIO()):
        return ULog(str(path))


def _mcap(name: str, file: str, build: Callable[[Path], None], peer: tuple[str, str, float]) -> Case:
    label, function, promised = peer
    return Case(name, file, build, OURS, {label: (f"{HERE}:{function}", promised)}, needs=PARQUET)


CASES = (
    Case(
        "ULog, 150 MB, to Arrow tables",
        "large.ulg",
        build_ulog,
        OURS,
        {"pyulog": (f"{HERE}:peer_pyulog", 2.0)},
        needs=ULOG,
    ),
    Case(
        "ULog, 4 MB, cold start",
        "small.ulg",
        copy_ulog,
        OURS,
        {"pyulog": (f"{HERE}:peer_pyulog", 0.0)},  # reported: two thirds of ours is importing NumPy and Arrow
        needs=ULOG,
        cold=True,
    ),
    Case(
        "MCAP ROS 2, 3 MB, cold start",
        "small.mcap",
        build_small_mcap,
        OURS,
        {"mcap-ros2": (f"{HERE}:peer_ros2", 1.0)},
        needs=PARQUET,
        cold=True,
    ),
    _mcap("MCAP ROS 1, fixed layout", "ros1.mcap", build_ros(1, False), ("mcap-ros1", "peer_ros1", 12.0)),
    _mcap("MCAP ROS 2, fixed layout", "ros2.mcap", build_ros(2, False), ("mcap-ros2", "peer_ros2", 12.0)),
    _mcap("MCAP ROS 1, sequences", "ros1seq.mcap", build_ros(1, True), ("mcap-ros1", "peer_ros1", 5.0)),
    _mcap("MCAP ROS 2, sequences", "ros2seq.mcap", build_ros(2, True), ("mcap-ros2", "peer_ros2", 5.0)),
    Case(
        "ROS 2 bag in SQLite, sequences",
        "bag.db3",
        build_db3,
        OURS,
        {"SQLite and rosbags": (f"{HERE}:peer_rosbags", 0.0)},
        needs=PARQUET,
    ),
    _mcap("MCAP protobuf", "proto.mcap", build_protobuf, ("mcap-protobuf", "peer_protobuf", 1.5)),
    _mcap("MCAP JSON", "json.mcap", build_json, ("mcap and json", "peer_json", 2.0)),
)
