"""A ROS 2 bag made in tests with SQLite itself; and the sample log of the contract tests.

Its records are pages: SQLite addresses them by number. A row belongs to the last page that it lies on.
"""

from __future__ import annotations

import os
import sqlite3
import struct
import tempfile
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

from tests.samplelogs import Record

SUFFIX = ".db3"
KNOWS_ITS_END = True
ADDRESSED = True
PAGE_BYTES = 512
ROWS = 220
STAMPED = "builtin_interfaces/Time stamp\nuint32 k\nfloat64 x\nuint8[] pad\n"
STAMPED += "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
PLAIN = "uint32 k\nuint8[] pad\n"
TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
  type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema VALUES (4, 'jazzy');
"""
TOPICS = [("/stamped", "p/msg/Stamped", "ros2msg", STAMPED), ("/plain", "p/msg/Plain", "ros2msg", PLAIN)]


def database(
    topics: Iterable[tuple[str, str, str, str]],
    messages: Sequence[tuple[int, int, bytes]],
    page_bytes: int = PAGE_BYTES,
    *,
    tables: str = TABLES,
) -> bytes:
    """A bag of (name, type, encoding, definition) and (topic number from 1, time in ns, CDR bytes)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "bag.db3")
        link = sqlite3.connect(path)
        link.execute(f"PRAGMA page_size = {page_bytes}")
        link.executescript(tables)
        for k, (name, kind, encoding, text) in enumerate(topics, 1):
            if "type_description_hash" in tables:
                link.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '', '')", (k, name, kind))
                link.execute(
                    "INSERT INTO message_definitions VALUES (?, ?, ?, ?, '')", (k, kind, encoding, text)
                )
            else:
                link.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (k, name, kind))
        if messages:
            link.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", messages)
        link.commit()
        link.close()
        return path.read_bytes()


def marker(k: int) -> bytes:
    """Four bytes that only row `k` holds, over and over."""
    return struct.pack(">I", 0xA5000000 | k << 4 | 0x9)


def payload(k: int) -> tuple[int, int, bytes]:
    """Row `k`: every 40th does not fit its page."""
    pad = marker(k) * (310 if k % 40 == 39 else 6)
    when = 1_700_000_000 * 10**9 + k * 10**7
    if k % 2:
        return 2, when, struct.pack("<4xII", k, len(pad)).replace(bytes(4), b"\0\1\0\0", 1) + pad
    stamp = (1_700_000_000 + k // 100, k % 100 * 10**7)
    head = b"\0\1\0\0" + struct.pack("<iIIxxxxdI", *stamp, k, k / 7, len(pad))
    return 1, when + 5, head + pad


@cache
def _built() -> bytes:
    return database(TOPICS, [payload(k) for k in range(ROWS)])


def build() -> bytes:
    """Two topics, small pages, a few rows that overflow."""
    return _built()


@cache
def _pages_of_rows() -> tuple[tuple[int, ...], ...]:
    blob = build()
    pages = [blob[at : at + PAGE_BYTES] for at in range(0, len(blob), PAGE_BYTES)]
    return tuple(tuple(n for n, page in enumerate(pages) if marker(k) in page) for k in range(ROWS))


def records(blob: bytes) -> list[Record]:
    """One per page."""
    ends = [max(pages) for pages in _pages_of_rows()]
    return [
        Record(at, at + PAGE_BYTES, ends.count(n)) for n, at in enumerate(range(0, len(blob), PAGE_BYTES))
    ]


@cache
def _definition_pages() -> frozenset[int]:
    """The pages, counted from 0, without which no row has a meaning."""
    handle, name = tempfile.mkstemp()
    os.close(handle)
    path = Path(name)
    try:
        path.write_bytes(build())
        link = sqlite3.connect(path)
        roots = link.execute(
            "SELECT rootpage FROM sqlite_master WHERE name IN ('topics', 'message_definitions')"
        ).fetchall()
        link.close()
    finally:
        path.unlink()
    root_pages = {number - 1 for (number,) in roots}
    pages = [build()[at : at + PAGE_BYTES] for at in range(0, len(build()), PAGE_BYTES)]
    words = (b"CREATE", b"uint", b"/stamped")
    texts = {n for n, page in enumerate(pages) if any(word in page for word in words)}
    return frozenset({0, *root_pages, *texts})


def at_risk(blob: bytes, byte: int) -> int:  # noqa: ARG001
    """Rows that lie on the page; all of them where it defines topics and types."""
    return _page_at_risk(byte // PAGE_BYTES)


def defining(blob: bytes) -> list[tuple[int, int, int]]:
    """What a page says of the topic /plain and of its type: SQLite's cells, with their two bytes of head."""
    heads = {b"\x07\x00\x19#\x13\r\r/plain": b"cdr", b"\x06\x00#\x1b7\rp/msg/Plain": PLAIN.encode()}
    cells = [
        (blob.index(head) - 2, blob.index(tail, blob.index(head)) + len(tail)) for head, tail in heads.items()
    ]
    return [(start, end, ROWS // 2) for start, end in cells]


@cache
def _page_at_risk(page: int) -> int:
    if page in _definition_pages():
        return ROWS
    return sum(page in pages for pages in _pages_of_rows())
