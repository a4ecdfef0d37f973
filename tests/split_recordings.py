"""Recordings that are split over several files, for tests and campaigns."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Sequence
from pathlib import Path

import flysid
from tests.samplelogs import mcap, rosbag, rosbag2

FIRST_NS = 1_700_000_000 * 10**9
STEP_NS = 10**7
Messages = Sequence[int]
"""Numbers of messages: number k is recorded STEP_NS * k after the first."""


def bag_of(numbers: Messages) -> bytes:
    """A ROS 1 bag."""
    chunk = rosbag.chunk(
        b"".join([rosbag.connection(0), rosbag.connection(1), *(rosbag.message(k % 2, k) for k in numbers)])
    )
    head = rosbag.record(
        b" " * 300, op=b"\x03", index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4)
    )
    at = (len(rosbag.MAGIC) + len(head) + len(chunk)).to_bytes(8, "little")
    head = rosbag.record(b" " * 300, op=b"\x03", index_pos=at, conn_count=bytes(4), chunk_count=bytes(4))
    return rosbag.MAGIC + head + chunk


def database_of(numbers: Messages) -> bytes:
    """A file of a ROS 2 bag."""
    messages = [
        (topic, FIRST_NS + STEP_NS * k, raw) for k in numbers for topic, _, raw in [rosbag2.payload(k % 200)]
    ]
    return rosbag2.database(rosbag2.TOPICS, messages)


def mcap_of(numbers: Messages) -> bytes:
    """An MCAP file."""
    schema = {"properties": {"k": {"type": "integer"}}}
    rows = [json.dumps({"k": k}).encode() for k in numbers]
    times = [FIRST_NS + STEP_NS * k for k in numbers]
    topic = mcap.Topic(
        "/a", "json", "s", "jsonschema", json.dumps(schema).encode(), list(zip(times, rows, strict=True))
    )
    return mcap.mcap_file([topic], chunk_size=300)


MAKERS: dict[str, Callable[[Messages], bytes]] = {".bag": bag_of, ".db3": database_of, ".mcap": mcap_of}


def lay(folder: Path, stem: str, ending: str, parts: Sequence[Messages]) -> list[Path]:
    """The files of a recording, numbered from 0."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{stem}_{k}{ending}" for k in range(len(parts))]
    for path, numbers in zip(paths, parts, strict=True):
        path.write_bytes(MAKERS[ending](numbers))
    return paths


def metadata(paths: Sequence[Path], counts: Sequence[int] = ()) -> str:
    """What a ROS 2 recorder writes when it is closed; of each file its messages where `counts` are given."""
    lines = ["rosbag2_bagfile_information:", "  version: 5", "  message_count: 120", "  relative_file_paths:"]
    lines += [f"    - {path.name}" for path in paths]
    lines += ["  files:"] if counts else []
    for path, count in zip(paths, counts, strict=False):
        lines += [f"  - path: {path.name}", "    starting_time:", "      nanoseconds_since_epoch: 1"]
        lines += [f"    message_count: {count}"]
    return "\n".join(lines) + "\n"


def compare(folder: Path, ending: str, rng: random.Random) -> str:
    """What is wrong with the reading of a recording that is split at random; "" for nothing."""
    count = rng.randint(40, 160)
    cuts = sorted(rng.sample(range(2, count - 1, 2), rng.randint(1, 5)))
    bounds = list(zip([0, *cuts], [*cuts, count], strict=True))
    start = rng.randrange(0, 10_000, 2)
    parts = [range(start + first, start + last) for first, last in bounds]
    paths = lay(folder, "x", ending, parts)
    other = lay(folder, "y", ending, [range(start + count + 500, start + count + 540)])[0]
    counts = {path: len(part) for path, part in zip(paths, parts, strict=True)}
    has_list = ending != ".bag" and rng.random() < 0.5
    if has_list:
        (folder / "metadata.yaml").write_text(metadata(paths, list(counts.values())))
    absent = rng.choice(paths) if has_list and rng.random() < 0.5 else None
    if absent is not None:
        absent.unlink()
    here = [path for path in paths if path != absent]
    flight = flysid.read(rng.choice(here))
    wanted = sum(counts[path] for path in here)
    if flight.rows != wanted:
        return f"{flight.rows} rows of {wanted} in {len(here)} files"
    lacking = {} if absent is None else {absent.name: counts[absent]}
    if dict(flight.damage.undecoded) != lacking:
        return f"{dict(flight.damage.undecoded)} is told to be lost, not {lacking}"
    if flysid.read(other).rows != 40:
        return "a flight beside it was joined"
    return ""
