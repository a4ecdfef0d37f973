"""An SQLite file with the write-ahead log and the journal that lie beside it, as SQLite reads them.

A program that is killed leaves them: what it last wrote is in `FILE-wal`, or what it last overwrote in
`FILE-journal`. Sources: "Database File Format", sections 3 and 4, and "Atomic Commit" (sqlite.org). Numbers
are big-endian.

    journal      u64 magic, u32 records (2^32 - 1: as many as fit), u32 nonce, u32 pages before, u32 bytes of
                 a sector, u32 bytes of a page; records from the next sector on: u32 page, its bytes as they
                 were, u32 nonce + every 200th byte from the end. More such segments follow, each at a sector.
                 The end may name a journal of several databases.
    log          u32 magic (its last bit: checksums over big-endian words), u32 version, u32 bytes of a page,
                 u32 checkpoint, 2 u32 salts, 2 u32 checksums of what is before them
    frame        u32 page, u32 pages of the file behind a commit or 0, 2 u32 salts as in the head, 2 u32
                 checksums of the first 8 bytes and the page, continued from the frame before; the page

The journal is rolled back first. Frames count up to the last that commits.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import numpy.typing as npt

from flysid.ingest.formats.recordings.names import companies, ending_of
from flysid.ingest.formats.rosbag2.sqlite_pages import HEADER_BYTES, MAGIC

WAL = "-wal"
JOURNAL = "-journal"
READ = (WAL, JOURNAL)
ALL = (*READ, "-shm")
"""How side files are called behind the name of their database; the last holds nothing of its own."""
WAL_MAGICS = (b"\x37\x7f\x06\x82", b"\x37\x7f\x06\x83")
JOURNAL_MAGIC = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
_WAL_VERSION = 3_007_000
_WAL_HEAD = struct.Struct(">4s7I")
_FRAME_HEAD = struct.Struct(">6I")
_JOURNAL_HEAD = struct.Struct(">8s5I")
_LOCK_BYTE = 1 << 30  # the page that holds it is never written
_WHOLE_FILE = 0xFFFFFFFF
_CHECKED_BYTES = 1 << 22  # of frames at a time

Words = npt.NDArray[np.uint32]


def names_beside(name: str, names: Callable[[], Collection[str]]) -> list[str]:
    """Files that may lie beside a log and that it is read with: side files, and others of its recording.

    `names` lists the folder; it is called where the log's own name is that of a part.
    """
    family: Sequence[str] = ()
    if ending_of(name):
        family = next((group for group in companies(names()) if name in group), ())
    files = [name, *(other for other in family if other != name)]
    return [*files[1:], *(file + suffix for file in files for suffix in READ)]


@dataclass
class Recovered:
    """A database as SQLite sees it.

    Attributes
    ----------
    database : the file as it is.
    size : bytes of a page.
    pages : how many the database has.
    instead : pages by number that stand in for those of the file.
    notes : what of the side files was left out, and why.
    """

    database: memoryview
    size: int
    pages: int
    instead: dict[int, memoryview] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def pieces(self) -> Iterator[bytes]:
        """The bytes of the database, page by page."""
        for number in range(1, self.pages + 1):
            at = (number - 1) * self.size
            page = self.instead.get(number, self.database[at : at + self.size])
            yield bytes(page).ljust(self.size, b"\0")


def recover(database: memoryview, sides: Mapping[str, memoryview]) -> Recovered | None:
    """The database that a file and its side files make; None where they change nothing and lack nothing.

    Parameters
    ----------
    database : an SQLite file.
    sides : side files by their suffix, of `READ`.
    """
    size = _page_bytes(database)
    if not size:
        return None
    found = Recovered(database, size, len(database) // size)
    _roll_back(found, sides.get(JOURNAL, memoryview(b"")))
    _replay(found, sides.get(WAL, memoryview(b"")))
    changed = found.instead or found.pages != len(database) // found.size
    return found if changed or found.notes else None


def _page_bytes(database: memoryview) -> int:
    """Bytes of a page as the file's header states them; 0 where it is none."""
    if len(database) < HEADER_BYTES or bytes(database[: len(MAGIC)]) != MAGIC:
        return 0
    stated = int.from_bytes(database[16:18], "big")
    return _sound_size(65536 if stated == 1 else stated)


def _sound_size(size: int) -> int:
    return size if 512 <= size <= 65536 and size & (size - 1) == 0 else 0


# --------------------------------------------------------------------------------------------- the journal


def _roll_back(found: Recovered, journal: memoryview) -> None:
    """Put back the pages that an unfinished transaction had overwritten, where the journal is hot."""
    if len(journal) < _JOURNAL_HEAD.size or bytes(journal[:8]) != JOURNAL_MAGIC:
        return  # no longer valid, or not yet
    if _names_another(journal):
        found.notes.append("its journal belongs to a transaction over several databases, and is left out")
        return
    *_, sector, size = _JOURNAL_HEAD.unpack_from(journal)
    size = _sound_size(size or found.size)
    if not size or not 32 <= sector <= 65536 or sector & (sector - 1):
        return
    at = 0
    record = size + 8
    while at + sector <= len(journal) and bytes(journal[at : at + 8]) == JOURNAL_MAGIC:
        _, count, nonce, pages, _, _ = _JOURNAL_HEAD.unpack_from(journal, at)
        if not at:
            found.size = size
            found.pages = pages
        at += sector
        if count == _WHOLE_FILE:
            count = (len(journal) - sector) // record
        for _ in range(count):
            if not _put_back(found, journal[at : at + record], nonce):
                at = len(journal)
                break
            at += record
        at = -(-at // sector) * sector
    found.notes.append("an unfinished transaction was taken back by its journal, as SQLite does")


def _put_back(found: Recovered, record: memoryview, nonce: int) -> bool:
    """Take a page from a record of the journal; whether the record is whole and sound."""
    if len(record) < found.size + 8:
        return False
    number = int.from_bytes(record[:4], "big")
    page = record[4 : 4 + found.size]
    if number in (0, _LOCK_BYTE // found.size + 1):
        return False
    if number > found.pages:
        return True
    total = nonce + sum(page[found.size - 200 : 0 : -200])
    if total & 0xFFFFFFFF != int.from_bytes(record[-4:], "big"):
        return False
    found.instead[number] = page
    return True


def _names_another(journal: memoryview) -> bool:
    """Whether the journal ends with the name of one of several databases."""
    if len(journal) < 16 or bytes(journal[-8:]) != JOURNAL_MAGIC:
        return False
    length = int.from_bytes(journal[-16:-12], "big")
    if not 0 < length <= len(journal) - 16:
        return False
    name = bytes(journal[-16 - length : -16])
    total: int = sum(struct.unpack(f"{length}b", name))
    return total & 0xFFFFFFFF == int.from_bytes(journal[-12:-8], "big")


# ------------------------------------------------------------------------------------- the write-ahead log


def _replay(found: Recovered, log: memoryview) -> None:
    """Put in the pages of every finished transaction of the write-ahead log."""
    if len(log) <= _WAL_HEAD.size or not bytes(log[: _WAL_HEAD.size]).strip(b"\0"):
        return  # nothing was written yet
    magic, version, size, *_, first, second = _WAL_HEAD.unpack_from(log)
    order = ">u4" if magic == WAL_MAGICS[1] else "<u4"
    head = _run_on((0, 0), np.frombuffer(log, order, 6)[None])[0]
    if magic not in WAL_MAGICS or head != (first, second) or (version, size) != (_WAL_VERSION, found.size):
        found.notes.append("the head of its write-ahead log is damaged: what the log holds is left out")
        return
    waiting: dict[int, memoryview] = {}
    frames = finished = 0
    for number, pages, page in _sound_frames(log, size, order, head):
        frames += 1
        waiting[number] = page
        if pages:
            found.instead |= waiting
            found.pages = pages
            finished = frames
            waiting = {}
    behind = list(_left(log, frames, size))
    if any(behind):
        at = _WAL_HEAD.size + frames * (_FRAME_HEAD.size + size)
        why = f"its write-ahead log is damaged at byte {at}: {len(behind)} pages from there on are left out"
        found.notes.append(why)
    elif frames + len(behind) > finished:
        count = frames + len(behind) - finished
        why = (
            f"{count} pages of an unfinished transaction in its write-ahead log are left out, as SQLite does"
        )
        found.notes.append(why)


def _left(log: memoryview, first: int, size: int) -> Iterator[int]:
    """Pages behind a commit, or 0, of the frames of the log's present round from one on.

    Frames of earlier rounds bear other salts. Within a transaction SQLite overwrites pages, and makes the
    checksums good when it commits: frames that do not commit and are not sound are no damage.
    """
    frame = _FRAME_HEAD.size + size
    for at in range(_WAL_HEAD.size + first * frame, len(log) - _FRAME_HEAD.size + 1, frame):
        if log[at + 8 : at + 16] == log[16:24]:
            yield int.from_bytes(log[at + 4 : at + 8], "big")


def _sound_frames(
    log: memoryview, size: int, order: str, state: tuple[int, int]
) -> Iterator[tuple[int, int, memoryview]]:
    """Page, pages behind a commit (or 0) and content of every frame up to the first that is not sound."""
    frame = _FRAME_HEAD.size + size
    step = max(1, _CHECKED_BYTES // frame)
    count = (len(log) - _WAL_HEAD.size) // frame
    salts = _WAL_HEAD.unpack_from(log)[4:6]
    for first in range(0, count, step):
        start = _WAL_HEAD.size + first * frame
        some = min(step, count - first)
        words = np.frombuffer(log, order, some * frame // 4, start).reshape(some, frame // 4)
        states = _run_on(state, np.hstack([words[:, :2], words[:, 6:]]))
        for k, state in enumerate(states):
            at = start + k * frame
            number, pages, *rest = _FRAME_HEAD.unpack_from(log, at)
            if not number or (*rest,) != (*salts, *state):
                return
            yield number, pages, log[at + _FRAME_HEAD.size : at + frame]


def _run_on(state: tuple[int, int], rows: Words) -> list[tuple[int, int]]:
    """SQLite's checksum behind each row of words, continued from row to row.

    It is linear: a pair of words turns (a, b) into (a + x + b, a + 2 b + x + y), modulo 2^32.
    """
    weights, (turn_a, turn_b) = _weights(rows.shape[1] // 2)
    own = rows.astype(np.uint32) @ weights
    states = []
    for add_a, add_b in own.tolist():
        a, b = state
        state = (
            (turn_a[0] * a + turn_a[1] * b + add_a) & 0xFFFFFFFF,
            (turn_b[0] * a + turn_b[1] * b + add_b) & 0xFFFFFFFF,
        )
        states.append(state)
    return states


@cache
def _weights(pairs: int) -> tuple[Words, tuple[tuple[int, int], tuple[int, int]]]:
    """(2 pairs, 2) what each word adds to the checksum, and the matrix that takes the state over them all."""
    out = np.zeros((2 * pairs, 2), dtype=np.uint32)
    (p, q), (r, s) = (1, 0), (0, 1)
    for k in range(pairs - 1, -1, -1):
        out[2 * k] = (p + q) & 0xFFFFFFFF, (r + s) & 0xFFFFFFFF
        out[2 * k + 1] = q, s
        p, q = (p + q) & 0xFFFFFFFF, (p + 2 * q) & 0xFFFFFFFF
        r, s = (r + s) & 0xFFFFFFFF, (r + 2 * s) & 0xFFFFFFFF
    return out, ((p, q), (r, s))
