"""Peak memory of ingesting logs of any size to parquet: a file of each format, at several sizes.

Files are made when needed, measured in a process of their own, and removed. What is measured is the largest
resident memory above that of the interpreter with flysid imported; pages of the log that happen to be mapped
count too. It must not pass 512 MB, whatever the size.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from bench import cases_arducopter, cases_bags
from bench.harness import WORK, measure
from tests.samplelogs import rosbag, rosbag2

PROMISED_MB = 512
READER = "bench.readers:flysid_parquet"
Build = Callable[[Path, int], None]


def main(words: str, sizes: list[int]) -> int:
    """Print a line per format and size; 1 where memory passes the bound."""
    WORK.mkdir(exist_ok=True)
    worst = 0.0
    for name, (suffix, build) in FILES.items():
        if words.lower() not in name.lower():
            continue
        for size in sizes:
            path = WORK / f"memory{suffix}"
            build(path, size * 1_000_000)
            megabytes = path.stat().st_size / 1e6
            found = measure(READER, path, cold=False, times=1)
            path.unlink()
            worst = max(worst, found.peak_mb)
            print(f"{name:24} {megabytes:7,.0f} MB   peak {found.peak_mb:4.0f} MB   {found.cpu_s:6.1f} CPU s")
    return int(worst > PROMISED_MB)


def build_by(module: object, function: str) -> Build:
    """A builder of the speed benchmarks, at another size."""

    def build(path: Path, size: int) -> None:
        usual = module.TARGET_BYTES  # type: ignore[attr-defined]
        try:
            module.TARGET_BYTES = size  # type: ignore[attr-defined]
            getattr(module, function)(path)
        finally:
            module.TARGET_BYTES = usual  # type: ignore[attr-defined]

    return build


def ros_payloads(ros: int, size: int) -> Iterator[tuple[int, bytes]]:
    """(time in ns, message) of a sequence of messages with strings and sequences, `size` bytes in all."""
    _, _, templates, places = cases_bags.ros_messages(ros, True)
    usual = cases_bags.TARGET_BYTES
    cases_bags.TARGET_BYTES = size
    try:
        for _, time_ns, payload in cases_bags.patched(templates, places):
            yield time_ns, payload
    finally:
        cases_bags.TARGET_BYTES = usual


def build_bag(path: Path, size: int) -> None:
    """A ROS 1 bag in plain chunks of 768 kB, as the recorder writes them."""
    text, kind, _, _ = cases_bags.ros_messages(1, True)
    about = {"topic": b"/topic", "type": kind.encode(), "md5sum": b"0" * 32}
    body = rosbag.packed({**about, "message_definition": text.encode()})[4:]
    link = rosbag.record(body, op=b"\x07", conn=bytes(4), topic=b"/topic")
    with path.open("wb") as out:
        counts = {"conn_count": bytes(4), "chunk_count": bytes(4)}
        out.write(rosbag.MAGIC + rosbag.record(b" " * 300, op=b"\x03", index_pos=b"\1" + bytes(7), **counts))
        parts = [link]
        waiting = 0
        for time_ns, payload in ros_payloads(1, size):
            when = struct.pack("<II", *divmod(time_ns, 10**9))
            parts.append(rosbag.record(payload, op=b"\x02", conn=bytes(4), time=when))
            waiting += len(payload)
            if waiting > 768_000:
                out.write(rosbag.chunk(b"".join(parts)))
                parts = []
                waiting = 0
        out.write(rosbag.chunk(b"".join(parts)))


def build_bag2(path: Path, size: int) -> None:
    """A ROS 2 bag, pages of 4,096 bytes."""
    text, kind, _, _ = cases_bags.ros_messages(2, True)
    path.unlink(missing_ok=True)
    link = sqlite3.connect(path)
    link.executescript(rosbag2.TABLES)
    link.execute("INSERT INTO topics VALUES (1, '/topic', ?, 'cdr', '', '')", (kind,))
    link.execute("INSERT INTO message_definitions VALUES (1, ?, 'ros2msg', ?, '')", (kind, text))
    rows = ((1, time_ns, payload) for time_ns, payload in ros_payloads(2, size))
    link.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    link.commit()
    link.close()


def build_text(path: Path, size: int) -> None:
    """A DataFlash log as text, three messages in 20 ms."""
    with path.open("w", encoding="ascii") as out:
        out.write("FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n")
        out.write("FMT, 10, 20, ATT, Qffff, TimeUS,Roll,Pitch,Yaw,Err\n")
        out.write("FMT, 11, 20, IMU, QBfff, TimeUS,I,X,Y,Z\n")
        out.write("FMT, 12, 20, MSG, QZ, TimeUS,Message\n")
        step = 0
        while out.tell() < size:
            lines = []
            for number in range(step + 1, step + 1001):
                us = 10_000_000 + 20_000 * number
                x = number % 977 / 7
                lines.append(f"ATT, {us}, {x:.4f}, {-x:.4f}, {number % 360}, {x / 3:.3f}\n")
                lines.append(f"IMU, {us + 100}, 0, {x:.5f}, -0.51234, {-9.8 - x:.4f}\n")
                lines.append(f"IMU, {us + 101}, 1, {x:.5f}, -0.51234, {-9.8 + x:.4f}\n")
            step += 1000
            lines.append(f"MSG, {us + 200}, step {step}\n")
            out.writelines(lines)


def build_navdata(path: Path, size: int) -> None:
    """Packets of a time, a demo and a references option at 200 Hz."""
    kind = np.dtype(
        [
            *(("head", "<u4"), ("state", "<u4"), ("sequence", "<u4"), ("vision", "<u4")),
            *(("time_tag", "<u2"), ("time_size", "<u2"), ("time", "<u4")),
            *(("demo_tag", "<u2"), ("demo_size", "<u2"), ("demo", "u1", 144)),
            *(("ref_tag", "<u2"), ("ref_size", "<u2"), ("ref", "u1", 84)),
            *(("end_tag", "<u2"), ("end_size", "<u2"), ("sum", "<u4")),
        ]
    )
    count = 100_000
    with path.open("wb") as out:
        for first in range(0, size // kind.itemsize, count):
            table = np.zeros(count, dtype=kind)
            number = np.arange(first, first + count)
            table["head"] = 0x55667788
            table["sequence"] = number
            table["time_tag"] = 1
            table["time_size"] = 8
            table["time"] = (number // 200 % 2048) << 21 | number % 200 * 5000
            table["demo_size"] = 148
            table["ref_tag"] = 6
            table["ref_size"] = 88
            table["demo"][:, 4] = number % 256
            table["end_tag"] = 0xFFFF
            table["end_size"] = 8
            raw = table.view(np.uint8).reshape(count, kind.itemsize)
            table["sum"] = raw[:, :-8].sum(axis=1, dtype=np.uint32)
            out.write(table.tobytes())


FILES: dict[str, tuple[str, Build]] = {
    "tlog": (".tlog", build_by(cases_arducopter, "build_tlog")),
    "DataFlash": (".bin", build_by(cases_arducopter, "build_dataflash")),
    "DataFlash as text": (".log", build_text),
    "ULog": (".ulg", build_by(cases_bags, "build_ulog")),
    "MCAP, ROS 2": (".mcap", build_by(cases_bags, "build_ros2_sequences")),
    "MCAP, JSON": (".mcap", build_by(cases_bags, "build_json")),
    "MCAP, protobuf": (".mcap", build_by(cases_bags, "build_protobuf")),
    "ROS 1 bag": (".bag", build_bag),
    "ROS 2 bag": (".db3", build_bag2),
    "navdata": (".navdata", build_navdata),
}
