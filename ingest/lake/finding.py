"""The logs that files, folders, patterns and archives name, and what else lies there.

What is named itself is tried. In a folder, and in a .zip archive, a file is

    tried        where its name ends as logs of a known format do, or its first bytes are those of a log,
                 whatever it is called. Tables in text go by their names alone: too many texts look like one.
    ignored      where it is something else: a text, a picture, a document, an empty file, hidden. It is
                 named; nothing is lost.
    unread       where it may be a log and cannot be read: binary data that nothing knows, a packing that
                 is not unpacked here, a file that may not be opened, a link to a folder. It is named, and
                 counts as a log that was skipped.
"""

from __future__ import annotations

import glob
import os
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from flysid.errors import FlysidError, FormatError, UsageError
from flysid.ingest.formats.common.zip_members import read_archive
from flysid.ingest.formats.opening import begins_archive, head_of, is_archive, names_log, own_name
from flysid.ingest.formats.recognised import TEXT, kind_of, packing_of, stranger
from flysid.ingest.formats.registry import confidence_of, known_suffixes
from flysid.ingest.lake.workers import Bounds, LostWorker, run_bounded
from flysid.manifest import DATA_FILE, about_run

GLOB_MARKS = frozenset("*?[")
ANYBODYS_SUFFIXES = (".log", ".txt")  # any program's notes end so, too
UNKNOWN = "binary data that no reader knows"
NOTHING = "no flight log in there"
TRUTH_SUFFIX = ".truth.parquet"  # what `flysid synth` lays beside a log: a table, and no log
SURE = 0.6  # more than a table in text can claim


@dataclass(frozen=True)
class Unread:
    """A file or folder that may hold a log and cannot be looked into."""

    path: Path
    reason: str


@dataclass(frozen=True)
class PassedOver:
    """A file that is no log, and what it is."""

    path: Path
    kind: str


@dataclass(frozen=True)
class FoundLogs:
    """Logs to read, what may be a log and cannot be read, and what is no log."""

    paths: tuple[Path, ...]
    unread: tuple[Unread, ...] = ()
    passed_over: tuple[PassedOver, ...] = ()


def find_logs(given: Sequence[str | Path], bounds: Bounds | None = None) -> FoundLogs:
    """The logs that files, folders, archives and patterns name, in order, each once.

    A member of an archive is a path as if the archive were a folder: `flights.zip/one.tlog`.

    Parameters
    ----------
    bounds : of memory and time for looking into one archive; a worker process does it. None does it here.

    Raises
    ------
    UsageError : a path does not exist, a pattern matches nothing, there is no log at all.
    """
    with closing(_Archives(bounds)) as archives:
        search = _LogSearch(archives.look_into)
        for item in given:
            for path in _expand(str(item)):
                search.take(path)
    if not search.paths and all(unread.reason == NOTHING for unread in search.unread.values()):
        raise UsageError(
            NOTHING,
            path=", ".join(str(path) for path in search.unread),
            hint=next(filter(None, map(_other_folder, search.unread)), "")
            or f"name the log itself; in a folder, names of logs end in {' '.join(sorted(known_suffixes()))}",
        )
    unique = {os.path.realpath(path): path for path in reversed(search.paths)}
    paths = tuple(path for path in search.paths if unique.get(os.path.realpath(path)) is path)
    return FoundLogs(paths, tuple(search.unread.values()), tuple(search.passed_over.values()))


def _other_folder(path: Path) -> str:
    """What a folder without logs is, where flysid made it; "" otherwise."""
    if (path / DATA_FILE).is_file():
        return f"this is an ingested folder: 'flysid ls {path}' lists its flights"
    return about_run(path)


def _expand(item: str) -> list[Path]:
    if os.path.lexists(item) or names_log(Path(item)):
        return [Path(item)]
    if GLOB_MARKS & set(item):
        found = sorted(glob.glob(item, recursive=True))
        if found:
            return [Path(name) for name in found]
        raise UsageError("the pattern matches nothing", path=item, hint="ls shows what is there")
    raise UsageError(
        "no such file or folder", path=item, hint="'flysid ingest LOG... -o DATA' makes a folder of flights"
    )


class _Archives:
    """Looks into archives, in a worker process where there are bounds."""

    def __init__(self, bounds: Bounds | None) -> None:
        self._tasks: deque[Path] = deque()
        self._outcomes = None if bounds is None else run_bounded(_inside_of, self._tasks, 1, bounds)

    def look_into(self, path: Path) -> _LogSearch:
        """What an archive holds."""
        if self._outcomes is None:
            return _inside_of(path)
        self._tasks.append(path)
        _, outcome = next(self._outcomes)
        if not isinstance(outcome, LostWorker):
            return outcome
        found = _LogSearch(_inside_of)
        found._fail(path, outcome.reason)
        return found

    def close(self) -> None:
        """End the worker."""
        if self._outcomes is not None:
            self._outcomes.close()


@dataclass
class _LogSearch:
    """What has been found so far, each path once; `look_into` says what is in an archive."""

    look_into: Callable[[Path], _LogSearch]
    paths: dict[Path, None] = field(default_factory=dict)
    unread: dict[Path, Unread] = field(default_factory=dict)
    passed_over: dict[Path, PassedOver] = field(default_factory=dict)

    def take(self, path: Path) -> None:
        """What is named itself: a folder, an archive or a log."""
        inside = _LogSearch(self.look_into)
        if path.is_dir():
            inside._look_into(path)
        elif path.is_file() and begins_archive(path):
            inside._add(self.look_into(path))
        else:
            inside.paths[path] = None
        if not inside.paths and not inside.unread:
            inside._fail(path, NOTHING)
        self._add(inside)

    def _add(self, other: _LogSearch) -> None:
        self.paths |= other.paths
        self.unread |= other.unread
        self.passed_over |= other.passed_over

    def _fail(self, path: Path, reason: str) -> None:
        self.unread[path] = Unread(path, reason)

    def _pass(self, path: Path, kind: str) -> None:
        self.passed_over[path] = PassedOver(path, kind)

    def _look_into(self, folder: Path) -> None:
        def note(error: OSError) -> None:
            self._fail(Path(error.filename), f"cannot be read: {error.strerror}")

        for parent, folders, files in os.walk(folder, onerror=note):
            if DATA_FILE in files:
                self._pass(Path(parent), "ingested folder")
                folders.clear()
                continue
            for name in folders:
                if name.startswith("."):
                    self._pass(Path(parent, name), "hidden folder")
                elif Path(parent, name).is_symlink():
                    self._fail(Path(parent, name), "a link to a folder; name it to have it read")
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            for name in sorted(files):
                self._judge(Path(parent, name))

    def _judge(self, path: Path, is_member: bool = False) -> None:
        """A file that is not named itself, but lies in what is."""
        name = own_name(path.name).lower()
        if path.name.startswith("."):
            self._pass(path, "hidden file")
        elif name.endswith(TRUTH_SUFFIX):
            self._pass(path, "truth of a simulated flight")
        elif name.endswith(known_suffixes()) and not name.endswith(ANYBODYS_SUFFIXES):
            self.paths[path] = None
        elif not is_member and not path.is_file():
            self._pass(path, "pipe, socket, device or broken link")
        else:
            try:
                own, head = head_of(path)
            except (FormatError, OSError) as error:
                self._fail(path, reason_of(error))
            else:
                if not head and not is_member and path.stat().st_size > 0:
                    self._fail(path, "nothing but zeros")
                    return
                self._judge_content(path, own, head, is_member or not begins_archive(path))

    def _judge_content(self, path: Path, name: str, head: bytes, is_inner: bool) -> None:
        kind = kind_of(head)
        if is_archive(head) and not is_inner:
            self._add(self.look_into(path))
        elif kind and kind != TEXT:
            self._pass(path, kind)
        elif packing := packing_of(head):
            self._fail(path, f"packed as {packing}, which is not read; unpack it first")
        elif confidence_of(head, name) >= SURE:
            self.paths[path] = None
        elif kind:
            self._pass(path, kind)
        else:
            known = stranger(head)
            told = f"this is {known.title}, not a log; try: {known.hint}" if known else UNKNOWN
            self._fail(path, told)


def _inside_of(path: Path) -> _LogSearch:
    """Members of an archive one by one; an archive without a log is passed over as one thing."""
    inside = _LogSearch(_inside_of)
    try:
        archive = read_archive(path)
    except (FormatError, OSError) as error:
        inside._fail(path, reason_of(error))
        return inside
    for name, member in archive.members.items():
        if member.fault:
            inside._fail(path / name, member.fault)
        else:
            inside._judge(path / name, is_member=True)
    if archive.fault:
        inside._fail(path, archive.fault)
    if not inside.paths and not inside.unread:
        inside.passed_over = {path: PassedOver(path, "archive without logs")}
    return inside


def reason_of(error: FlysidError | OSError) -> str:
    """Why a file could not be read, and what to try."""
    return error.advice if isinstance(error, FlysidError) else f"cannot be read: {error.strerror}"
