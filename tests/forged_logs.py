"""Logs of few bytes that stand for many, of every carrier: what a stranger forges to fill a memory.

What each describes would take far more than the file; a reader takes what is within bounds, or refuses it.
"""

from __future__ import annotations

import bz2
import gzip
import io
import json
import struct
import zlib
from collections.abc import Callable, Mapping

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard

from flysid.ingest.formats.blackbox.header import START
from tests.samplelogs import blackbox, mcap, navdata, rosbag, rosbag2, tlog, ulog
from tests.samplelogs.dataflash import fmt, pack

MEGABYTE = 1 << 20


def table_of(count: int, column: pa.Array) -> bytes:
    """A Parquet file of times and one column, in one group of rows."""
    sink = io.BytesIO()
    times = pa.array(np.arange(count) * 0.01)
    pq.write_table(
        pa.Table.from_arrays([times, column], ["time_s", "x"]),
        sink,
        compression="zstd",
        row_group_size=count,
    )
    return sink.getvalue()


def _shared_text() -> pa.Array:
    indices = pa.array(np.zeros(30_000, dtype=np.int32))
    return pa.DictionaryArray.from_arrays(indices, pa.array(["ab" * 35_000]))


def _lists() -> pa.Array:
    """Long ones, all in the first rows."""
    offsets = np.minimum(np.arange(20_001) * 9000, 9_000_000).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(np.ones(9_000_000)))


PARQUET: Mapping[str, Callable[[], bytes]] = {
    "text": lambda: table_of(30_000, _shared_text()),
    "text in a struct": lambda: table_of(
        3000, pa.StructArray.from_arrays([pa.array(["q" * 100_000] * 3000)], ["k"])
    ),
    "a number": lambda: table_of(20_000_000, pa.array(np.zeros(20_000_000, dtype=np.int64))),
    "lists": lambda: table_of(20_000, _lists()),
    "lists of one size": lambda: table_of(
        5000, pa.FixedSizeListArray.from_arrays(pa.array(np.ones(5000 * 4000)), 4000)
    ),
}

LEVELS = 8
"""Of definitions, each of which holds the one below it many times."""


def _nested_ulog() -> bytes:
    formats = ["leaf:uint64_t timestamp;float[60] x;"]
    for level in range(LEVELS):
        formats.append(f"t{level}:uint64_t timestamp;{formats[-1].partition(':')[0]}[60] a;")
    defined = b"".join(ulog.record("F", text.encode()) for text in formats)
    rows = b"".join(ulog.data(0, struct.pack("<Q", 10_000 * k) + bytes(60_000)) for k in range(20))
    return ulog.HEAD + defined + ulog.subscribe(0, 0, f"t{LEVELS - 1}") + rows


def _many_topics_ulog() -> bytes:
    """65,536 subscriptions with a row each."""
    parts = [ulog.HEAD, ulog.record("F", b"leaf:uint64_t timestamp;float x;")]
    for number in range(1 << 16):
        parts.append(ulog.subscribe(number, number % 256, f"leaf{number // 256}"))
        parts.append(ulog.record("F", f"leaf{number // 256}:uint64_t timestamp;float x;".encode()))
        parts.append(ulog.data(number, struct.pack("<Qf", number, 1.0)))
    return b"".join(parts)


def _changing_dataflash() -> bytes:
    """Formats that change with every message."""
    parts = [fmt(128)]
    for k in range(30_000):
        labels = ",".join(f"c{k}x{i}" for i in range(3))
        types = {
            128: ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
            30 + k % 90: (f"M{k % 1000:03}", "aaa", labels),
        }
        parts.append(pack(128, 30 + k % 90, 3 + 3 * 64, f"M{k % 1000:03}", "aaa", labels, types=types))
        parts.append(b"\xa3\x95" + bytes([30 + k % 90]) + bytes(3 * 64))
    return b"".join(parts)


def _many_blackboxes() -> bytes:
    """Headers, one behind another, each a boot of its own."""
    header = b"".join(piece.raw for piece in blackbox.pieces()[:3])
    return header * (4 * MEGABYTE // len(header))


def _wide_blackbox() -> bytes:
    """A definition of 60,000 fields."""
    count = 60_000
    names = ",".join(["loopIteration", "time", *(f"f{k}" for k in range(count - 2))])
    zeros = ",".join("0" * count)
    lines = [f"H Field I {what}:{zeros}\n" for what in ("signed", "predictor", "encoding")]
    lines += [f"H Field P {what}:{zeros}\n" for what in ("predictor", "encoding")]
    return START + f"H Field I name:{names}\n".encode() + "".join(lines).encode() + b"I\0" * 100_000


def _many_senders() -> bytes:
    """A telemetry log of 16,000 senders."""
    parts = []
    for number in range(16_000):
        vehicle = tlog.sender(1 + number % 250, 1 + number // 250)
        packed = tlog.frame(vehicle, vehicle.attitude_encode(number, 0.1, 0.5, -1, 0, 0, 0))
        parts.append(tlog.stamped(tlog.EPOCH_US + number * 1000, packed))
    return b"".join(parts)


def _wide_json() -> bytes:
    names = [f"k{k}" for k in range(20_000)]
    schema = {"type": "object", "properties": {name: {"type": "number"} for name in names}}
    return mcap.mcap_file([mcap.json_topic("/wide", schema, [dict.fromkeys(names, 1.0)] * 20)])


def _changing_json() -> bytes:
    """Every message has fields of its own."""
    rows = [{f"k{k}_{i}": 1.0 for i in range(20)} for k in range(3000)]
    return mcap.mcap_file([mcap.json_topic("/changing", {"type": "object"}, rows)])


def _nested_definition() -> str:
    """A ROS message whose fixed arrays multiply."""
    parts = ["p/T0[60] a"]
    for level in range(LEVELS):
        below = f"p/T{level + 1}[60] a" if level + 1 < LEVELS else "float64[60] a"
        parts.append(f"{'=' * 80}\nMSG: p/T{level}\n{below}")
    return "\n".join(parts)


def _nested_ros2() -> bytes:
    payload = b"\0\1\0\0" + bytes(60_000)
    return mcap.mcap_file([mcap.ros2_topic("/nested", "p/msg/Top", _nested_definition(), [payload] * 20)])


def _zeros_in_mcap() -> bytes:
    payload = b"\0\1\0\0" + struct.pack("<I", 8 * MEGABYTE) + bytes(8 * MEGABYTE)
    return mcap.mcap_file(
        [mcap.ros2_topic("/zeros", "p/msg/Z", "uint8[] data", [payload] * 60)], chunk_size=16 * MEGABYTE
    )


def _nested_bag() -> bytes:
    about = {"topic": b"/n", "type": b"p/Top", "md5sum": b"0" * 32}
    about["message_definition"] = _nested_definition().encode()
    number = struct.pack("<I", 0)
    body = rosbag.packed(about)[4:]
    parts = [rosbag.MAGIC, rosbag.record(body, op=b"\x07", conn=number, topic=b"/n")]
    for k in range(20):
        when = struct.pack("<II", 1_600_000_000 + k, 0)
        parts.append(rosbag.record(bytes(60_000), op=b"\x02", conn=number, time=when))
    return b"".join(parts)


def _zeros_in_bag() -> bytes:
    """Chunks that expand to 64 MB of messages each."""
    row = rosbag.message(1, 0)
    packed = bz2.compress(row * (64 * MEGABYTE // len(row)))
    size = struct.pack("<I", 64 * MEGABYTE // len(row) * len(row))
    one = rosbag.record(packed, op=b"\x05", compression=b"bz2", size=size)
    return rosbag.MAGIC + rosbag.connection(1) + one * 4


def _nested_bag2() -> bytes:
    topics = [("/n", "p/msg/Top", "ros2msg", _nested_definition())]
    return rosbag2.database(topics, [(1, 5 * k, b"\0\1\0\0" + bytes(60_000)) for k in range(20)])


def _wide_crazyflie() -> bytes:
    """A kind of event with 60,000 variables, and 20 of them."""
    words = b"".join(f"v{k}(d)".encode() + b"\0" for k in range(60_000))
    head = struct.pack("<BHH", 0xBC, 2, 1) + struct.pack("<H", 0) + b"wide\0" + struct.pack("<H", 60_000)
    rows = b"".join(struct.pack("<HQ", 0, 10_000 * k) + bytes(8 * 60_000) for k in range(20))
    body = head + words + rows
    return body + struct.pack("<I", zlib.crc32(body))


def _many_flows() -> bytes:
    """A capture of 40,000 connections of TCP, each with a segment that waits for what comes before it."""
    packets = []
    for number in range(40_000):
        content = b"\xfe" * 40
        ports = (1024 + number % 60_000, 14_550)
        tcp = struct.pack(">HHIIBBHHH", *ports, 1000, 0, 0x50, 0x18, 1000, 0, 0) + content
        size = 20 + len(tcp)
        head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, size, 0, 0, 64, 6, 0, b"\xc0\xa8\1\1", b"\xc0\xa8\1\2")
        packets.append((number * 1000, [head + tcp]))
    return navdata.pcap(packets)


def _wide_table() -> bytes:
    names = ",".join(["time_s", *(f"x{k}" for k in range(50_000))])
    return f"{names}\n".encode() + b"".join(f"{k}{',1' * 50_000}\n".encode() for k in range(20))


def _long_cells() -> bytes:
    return b"time_s,x\n" + b"".join(b'%d,"%s"\n' % (k, b"w" * 200_000) for k in range(200))


def _rows_for_nothing() -> bytes:
    return b"time_s,x\n" + b"0.5,1\n" * (40 * MEGABYTE)


def _wide_mavlogdump() -> bytes:
    lines = []
    for k in range(2000):
        data = {f"k{k}_{i}": 1.0 for i in range(40)}
        lines.append(json.dumps({"meta": {"type": "IMU", "timestamp": 1.6e9 + k}, "data": data}))
    return "\n".join(lines).encode()


FORGED: Mapping[str, tuple[str, Callable[[], bytes]]] = {
    **{f"parquet, {kind}": (".parquet", build) for kind, build in PARQUET.items()},
    "ulog, nested formats": (".ulg", _nested_ulog),
    "ulog, 65,536 topics": (".ulg", _many_topics_ulog),
    "dataflash, formats that change": (".bin", _changing_dataflash),
    "blackbox, headers alone": (".bbl", _many_blackboxes),
    "blackbox, 60,000 fields": (".bbl", _wide_blackbox),
    "tlog, 16,000 senders": (".tlog", _many_senders),
    "mcap, 20,000 fields": (".mcap", _wide_json),
    "mcap, fields that change": (".mcap", _changing_json),
    "mcap, nested definition": (".mcap", _nested_ros2),
    "mcap, long arrays": (".mcap", _zeros_in_mcap),
    "rosbag, nested definition": (".bag", _nested_bag),
    "rosbag, chunks that expand": (".bag", _zeros_in_bag),
    "rosbag2, nested definition": (".db3", _nested_bag2),
    "crazyflie, 60,000 variables": (".usd", _wide_crazyflie),
    "capture, 40,000 connections": (".pcap", _many_flows),
    "csv, 50,000 columns": (".csv", _wide_table),
    "csv, long cells": (".csv.gz", lambda: gzip.compress(_long_cells(), 1)),
    "csv, rows of a bomb": (".csv.zst", lambda: zstandard.compress(_rows_for_nothing(), 1)),
    "mavlogdump, fields that change": (".json", _wide_mavlogdump),
}
"""By carrier and kind: how a file of it ends, and its bytes."""
