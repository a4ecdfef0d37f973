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
from collections.abc import Container, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from flysid.errors import FormatError, UsageError
from flysid.ingest.formats.blame import blamed, blaming
from flysid.ingest.formats.common.packed_names import PACKED_SUFFIXES, own_name
from flysid.ingest.formats.common.zip_members import read_archive
from flysid.ingest.formats.opening import begins_archive, folder_of, head_of, names_log, recording_at
from flysid.ingest.formats.recognised import TEXT, kind_of, packing_of, stranger
from flysid.ingest.formats.recordings.finding import present
from flysid.ingest.formats.recordings.names import METADATA, ending_of, listed, possible_parts
from flysid.ingest.formats.registry import confidence_of, known_suffixes, refusal_of
from flysid.ingest.formats.rosbag2.side_files import ALL as SIDE_SUFFIXES
from flysid.ingest.lake.workers import Bounds, Lost, read_bounded
from flysid.manifest import DATA_FILE, about_run

GLOB_MARKS = frozenset("*?[")
ANYBODYS_SUFFIXES = (".log", ".txt")  # any program's notes end so, too
LOG = "log"
NO_LOGS = "archive without logs"
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

    `bounds`: of memory and time for looking into one file; a worker process does it. None does it here.
    Raises UsageError: a path does not exist, a pattern matches nothing, there is no log at all.
    """
    with closing(_LogSearch(bounds)) as search:
        found = Found()
        for path in (path for item in given for path in _expand(str(item))):
            found.add(search.found_in(path))
    if not found.paths and all(unread.reason == NOTHING for unread in found.unread.values()):
        raise UsageError(
            NOTHING,
            path=", ".join(str(path) for path in found.unread),
            hint=next(filter(None, map(_other_folder, found.unread)), "")
            or f"name the log itself; in a folder, names of logs end in {' '.join(sorted(known_suffixes()))}",
        )
    unique = {os.path.realpath(path): path for path in reversed(found.paths)}
    paths = tuple(path for path in found.paths if unique.get(os.path.realpath(path)) is path)
    return FoundLogs(paths, tuple(found.unread.values()), tuple(found.passed_over.values()))


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


def judge_name(name: str) -> str:
    """What a file in a folder is by its name: LOG, or a kind that is no log; "" where its bytes must tell."""
    lower = own_name(name).lower()
    if name.startswith("."):
        return "hidden file"
    if lower.endswith(TRUTH_SUFFIX):
        return "truth of a simulated flight"
    return LOG if lower.endswith(known_suffixes()) and not lower.endswith(ANYBODYS_SUFFIXES) else ""


def part_of(name: str, names: Container[str]) -> str:
    """Which file of a folder a side file is read with, as a kind of file; "" where it is none."""
    plain = own_name(name)
    for suffix in SIDE_SUFFIXES:
        base = plain.removesuffix(suffix)
        if base != plain:
            whole = next(
                (base + packing for packing in ("", *PACKED_SUFFIXES) if base + packing in names), ""
            )
            return f"part of {whole}" if whole else ""
    return ""


@dataclass
class Found:
    """What has been found so far, each path once."""

    paths: dict[Path, None] = field(default_factory=dict)
    unread: dict[Path, Unread] = field(default_factory=dict)
    passed_over: dict[Path, PassedOver] = field(default_factory=dict)

    def add(self, other: Found) -> None:
        self.paths |= other.paths
        self.unread |= other.unread
        self.passed_over |= other.passed_over

    def take(self, path: Path, look: Found | Lost) -> None:
        """What a look into a file found, or why it could not."""
        if isinstance(look, Lost):
            self.fail(path, look.reason)
        else:
            self.add(look)

    def fail(self, path: Path, reason: str) -> None:
        self.unread[path] = Unread(path, reason)

    def pass_over(self, path: Path, kind: str) -> None:
        self.passed_over[path] = PassedOver(path, kind)

    def sort_in(self, path: Path, kind: str) -> None:
        """A log, or a file of a kind that is none."""
        if kind == LOG:
            self.paths[path] = None
        else:
            self.pass_over(path, kind)


class _LogSearch:
    """Goes through files and folders; what must be opened is opened by a bounded task."""

    def __init__(self, bounds: Bounds | None) -> None:
        self._tasks: deque[Path] = deque()
        self._parts: dict[Path, frozenset[str]] = {}
        self._outcomes = read_bounded(judge_file, self._tasks, 1, bounds)

    def close(self) -> None:
        """End the worker."""
        self._outcomes.close()

    def found_in(self, path: Path) -> Found:
        """What is named itself: a folder, an archive or a log."""
        found = Found()
        if path.is_dir():
            self._walk(path, found)
        elif _is_archive(path):
            self._open(path, found)
        elif ending_of(path.name) and path.name in self._parts_beside(path):
            found = self._open_part(path)
        else:
            found.paths[path] = None
        if not found.paths and not found.unread:
            found.fail(path, NOTHING)
        return found

    def _open(self, path: Path, found: Found) -> None:
        """What a file is by its bytes."""
        self._tasks.append(path)
        _, inside = next(self._outcomes)
        found.take(path, inside)

    def _parts_beside(self, path: Path) -> frozenset[str]:
        """What may be parts of recordings where a file lies; nothing where that cannot be listed."""
        if path.parent not in self._parts:
            try:
                self._parts[path.parent] = possible_parts(folder_of(path).files)
            except (FormatError, OSError):
                self._parts[path.parent] = frozenset()
        return self._parts[path.parent]

    def _open_part(self, path: Path) -> Found:
        """A log that may be part of a recording; where nothing tells, it is tried, which says why."""
        inside = Found()
        self._open(path, inside)
        return inside if inside.paths else Found({path: None})

    def _walk(self, folder: Path, found: Found) -> None:
        def note(error: OSError) -> None:
            found.fail(Path(error.filename), blamed(error).advice)

        for parent, folders, files in os.walk(folder, onerror=note):
            if DATA_FILE in files:
                found.pass_over(Path(parent), "ingested folder")
                folders.clear()
                continue
            for name in folders:
                if name.startswith("."):
                    found.pass_over(Path(parent, name), "hidden folder")
                elif Path(parent, name).is_symlink():
                    found.fail(Path(parent, name), "a link to a folder; name it to have it read")
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            parts = possible_parts(files)
            for name in sorted(files):
                path = Path(parent, name)
                kind = part_of(name, files) or judge_name(name)
                if kind == LOG and name in parts:
                    found.add(self._open_part(path))
                elif kind:
                    found.sort_in(path, kind)
                elif os.path.isfile(path):
                    self._open(path, found)
                else:
                    found.pass_over(path, "pipe, socket, device or broken link")


def _is_archive(path: Path) -> bool:
    """Whether a file begins as an archive; one that cannot be read is tried as a log, which says why."""
    try:
        return os.path.isfile(path) and begins_archive(path)
    except OSError:
        return False


def judge_file(path: Path) -> Found:
    """What a file is by its bytes: a log, an archive with logs, or neither; a task for a worker process.

    Raises FormatError and OSError where it cannot be read.
    """
    found = Found()
    if path.is_file() and begins_archive(path):
        _judge_members(found, path)
        return found
    if _judge_recording(found, path):
        return found
    name, head = head_of(path)
    if not head and path.stat().st_size > 0:
        found.fail(path, "nothing but zeros")
    else:
        judge_head(found, path, name, head)
    return found


def _judge_recording(found: Found, path: Path) -> bool:
    """Sort in a file that is part of a recording, with its first file, and whether it is such a one."""
    if path.name == METADATA:
        folder = folder_of(path)
        first_listed = next(
            filter(None, (present(entry, folder.files) for entry in listed(folder.metadata))), ""
        )
        if first_listed:
            found.pass_over(path, f"part of {first_listed}")
        return first_listed != ""
    kind = judge_name(path.name)
    if kind not in (LOG, "") or not ending_of(path.name):
        return False
    files, _ = recording_at(path)
    if not kind and len(files) == 1:
        return False
    first = files[0]
    found.paths[first] = None
    if path != first:
        found.pass_over(path, f"part of {first.name}")
    return True


def _judge_members(found: Found, path: Path) -> None:
    """Members of an archive one by one; an archive without a log is passed over as one thing."""
    archive = read_archive(path)
    for name, member in archive.members.items():
        inside = path / name
        try:
            with blaming():
                if member.fault:
                    found.fail(inside, member.fault)
                elif kind := part_of(name, archive.members):
                    found.pass_over(inside, kind)
                elif _judge_recording(found, inside):
                    continue
                elif kind := judge_name(inside.name):
                    found.sort_in(inside, kind)
                else:
                    judge_head(found, inside, *head_of(inside))
        except FormatError as error:
            found.fail(inside, error.advice)
    if archive.fault:
        found.fail(path, archive.fault)
    if not found.paths and not found.unread:
        found.passed_over = {path: PassedOver(path, NO_LOGS)}


def judge_head(found: Found, path: Path, name: str, head: bytes) -> None:
    """Sort in a file, a member of an archive or an object by its own name and first bytes."""
    kind = kind_of(head)
    if kind and kind != TEXT:
        found.pass_over(path, kind)
    elif packing := packing_of(head):
        found.fail(path, f"packed as {packing}, which is not read; unpack it first")
    elif confidence_of(head, name) >= SURE:
        found.paths[path] = None
    elif kind:
        found.pass_over(path, kind)
    else:
        known = stranger(head)
        if known is None:
            found.fail(path, _advice(refusal_of(head, name)))
        else:
            found.fail(path, f"this is {known.title}, not a log; try: {known.hint}")


def _advice(error: FormatError) -> str:
    """What a list says of an error whose file it names itself."""
    return f"{error.message}; try: {error.hint}"
