"""Bags whose recorder was killed: SQLite itself writes them, in a child process, until a drawn moment.

A state is the bag with what lies beside it then. `rows_by_sqlite` is what SQLite reads of a copy.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sqlite3
import time
from collections.abc import Callable
from pathlib import Path

from flysid.ingest.formats.opening import open_log
from flysid.ingest.formats.rosbag2.side_files import READ
from flysid.ingest.formats.rosbag2.sqlite_tables import Tables
from tests.samplelogs.rosbag2 import TABLES, TOPICS, payload

Row = tuple[int, int, int, bytes]
MODES = ("wal", "wal", "delete", "truncate", "persist")
LONGEST_S = 0.05


def killed_bag(path: Path, draw: random.Random) -> Path:
    """A bag whose recorder ends in the middle of anything."""
    child = os.fork()
    if not child:
        try:
            record(path, draw)
        finally:
            os._exit(0)
    if draw.random() < 0.5:
        time.sleep(draw.random() * LONGEST_S)
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return path


def record(path: Path, draw: random.Random) -> None:
    """Write a bag in transactions of drawn lengths; end without a word within one or between two."""
    link = sqlite3.connect(path, isolation_level=None)
    link.execute(f"PRAGMA page_size = {1 << draw.randrange(9, 14)}")
    link.executescript(TABLES)
    link.execute(f"PRAGMA journal_mode = {draw.choice(MODES)}")
    link.execute(f"PRAGMA synchronous = {draw.choice(('off', 'normal', 'full'))}")
    link.execute(f"PRAGMA wal_autocheckpoint = {draw.choice((0, 5, 50, 1000))}")
    link.execute(f"PRAGMA cache_size = {draw.choice((2, 10, 2000))}")
    for k, (name, kind, encoding, text) in enumerate(TOPICS, 1):
        link.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '', '')", (k, name, kind))
        link.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, '')", (k, kind, encoding, text))
    ends = draw.randrange(1, 400)
    written = 0
    while True:
        link.execute("BEGIN")
        for _ in range(draw.choice((1, 5, 60, 300))):
            if written == ends:
                os._exit(0)
            link.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", payload(written))
            written += 1
        if draw.random() < 0.2:
            link.execute("DELETE FROM messages WHERE id % 7 = ?", (draw.randrange(7),))
        link.execute("COMMIT" if draw.random() < 0.9 else "ROLLBACK")
        if draw.random() < 0.1:
            link.execute(f"PRAGMA wal_checkpoint({draw.choice(('passive', 'full', 'restart'))})")


def beside(path: Path) -> list[Path]:
    """The bag and what lies beside it, but its index of shared memory."""
    every = (path.with_name(path.name + suffix) for suffix in ("", *READ))
    return [file for file in every if file.exists()]


def rows_by_sqlite(path: Path, place: Path) -> list[Row] | None:
    """What SQLite reads of a copy; None where it reads nothing or refuses."""
    place.mkdir()
    for file in beside(path):
        shutil.copy(file, place / file.name)
    link = sqlite3.connect(place / path.name)
    try:
        link.execute("PRAGMA cell_size_check = 1")
        return sorted(link.execute("SELECT id, topic_id, timestamp, data FROM messages"))
    except sqlite3.DatabaseError:
        return None
    finally:
        link.close()
        shutil.rmtree(place)


def rows_by_flysid(path: Path) -> tuple[list[Row], str]:
    """What the reader of bags gives of the bag, and what it has left out of its side files."""
    with open_log(path) as log:
        tables = Tables(log.view)
        rows = [tuple(row) for row in tables.rows("messages", lambda row: isinstance(row[3], bytes))]
        return sorted(rows), log.beside  # type: ignore[arg-type]


# -------------------------------------------------------------------------------------------- what befalls it


def _cut(path: Path, draw: random.Random) -> None:
    os.truncate(path, draw.randrange(path.stat().st_size + 1))


def _flip(path: Path, draw: random.Random) -> None:
    blob = bytearray(path.read_bytes())
    if blob:
        at = draw.randrange(len(blob))
        blob[at] ^= draw.randrange(1, 256)
        path.write_bytes(blob)


def _append(path: Path, draw: random.Random) -> None:
    path.write_bytes(path.read_bytes() + draw.randbytes(draw.randrange(1, 9000)))


BEFALLS: tuple[Callable[[Path, random.Random], None], ...] = (_cut, _flip, _append)


def befall(path: Path, draw: random.Random) -> str:
    """Damage a side file, as an unfinished copy or a bad disk does; which, "" for none."""
    sides = [file for file in beside(path)[1:] if file.stat().st_size]
    if not sides or draw.random() < 0.6:
        return ""
    side = draw.choice(sides)
    how = draw.choice(BEFALLS)
    how(side, draw)
    return f"{how.__name__} {side.name}"


def compare(folder: Path, seed: int) -> str:
    """One bag, killed and perhaps damaged, read twice: how the readings differ, "" where they do not."""
    draw = random.Random(seed)
    path = killed_bag(folder / f"bag{seed}.db3", draw)
    if not path.exists() or not path.stat().st_size:
        return ""
    damage = befall(path, draw)
    true = rows_by_sqlite(path, folder / "copy")
    if true is None:
        return ""
    found, notes = rows_by_flysid(path)
    kinds = [file.name[len(path.name) :] for file in beside(path)[1:] if file.stat().st_size]
    if found == true:
        return ""
    return f"seed {seed}, {kinds}, {damage or 'whole'}: {len(found)} rows, SQLite {len(true)}; {notes!r}"


def unfinished(path: Path, mode: str, committed: int, begun: int = 0) -> Path:
    """A bag of `committed` messages whose recorder died; half of them in the log in mode "wal".

    `begun`: messages of a transaction that it died in. In mode "delete" some of their pages are in the bag.
    """
    child = os.fork()
    if not child:
        try:
            _die(path, mode, committed, begun)
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    return path


def _die(path: Path, mode: str, committed: int, begun: int) -> None:
    link = sqlite3.connect(path, isolation_level=None)
    link.executescript(TABLES)
    link.execute(f"PRAGMA journal_mode = {mode}")
    link.execute("PRAGMA cache_size = 2")
    link.execute("BEGIN")
    for k, (name, kind, encoding, text) in enumerate(TOPICS, 1):
        link.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '', '')", (k, name, kind))
        link.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, '')", (k, kind, encoding, text))
    insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)"
    link.executemany(insert, [payload(k) for k in range(committed // 2)])
    link.execute("COMMIT")
    link.execute("PRAGMA wal_checkpoint(restart)")
    link.execute("BEGIN")
    link.executemany(insert, [payload(k) for k in range(committed // 2, committed)])
    link.execute("COMMIT")
    if begun:
        link.execute("BEGIN")
        link.execute("DELETE FROM messages WHERE id % 3 = 0")
        link.executemany(insert, [payload(k) for k in range(committed, committed + begun)])
    os._exit(0)
