"""Logs as bytes: as they are, packed (.gz, .zst), or members of a .zip archive.

A member is addressed as if its archive were a folder: `flights.zip/monday/one.tlog`. A log may be packed
twice: a .gz or .zst file inside a .zip archive. What is packed in any other way is refused with the way out.
A file that is part of a recording of several opens them all (`recordings`).
"""

from __future__ import annotations

import hashlib
import importlib
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import BinaryIO, TypeVar

from flysid.errors import FormatError
from flysid.flight import Flight, Source
from flysid.ingest.formats.base import (
    HEAD_BYTES,
    Format,
    Limits,
    Parts,
    Summary,
    count_zeros,
    hash_log,
    map_file,
    source_of,
)
from flysid.ingest.formats.blame import blaming
from flysid.ingest.formats.common.capture import join_captures
from flysid.ingest.formats.common.compression import (
    Expanded,
    expand,
    first_bytes,
    kind_of_packing,
    unpacked_pieces,
)
from flysid.ingest.formats.common.packed_names import PACKED_SUFFIXES, own_name, readable
from flysid.ingest.formats.common.transfer import harm_of
from flysid.ingest.formats.common.zip_members import ZIP_MAGICS, Member, member_pieces, read_archive
from flysid.ingest.formats.recognised import TAR_MAGIC, TAR_MAGIC_AT, is_office, packing_of
from flysid.ingest.formats.recordings.continued import Heard, heard
from flysid.ingest.formats.recordings.finding import READERS, Folder, Lacking, recording_of
from flysid.ingest.formats.recordings.names import (
    CAPTURE,
    MARK,
    METADATA,
    ending_of,
    part_named,
    second_capture,
)
from flysid.ingest.formats.rosbag2.side_files import READ, recover
from flysid.ingest.formats.rosbag2.sqlite_pages import MAGIC as SQLITE_MAGIC

FIRST_BYTES = 128  # tell a packing, and an archive from a spreadsheet
LEAST_ZEROS = 16  # fewer may belong to a log: a tlog's stamp begins with one

T = TypeVar("T", Flight, Summary)


@dataclass(frozen=True)
class OpenLog:
    """A log that can be read.

    Attributes
    ----------
    name : the log's own name, without what packing added to it.
    view : its bytes, expanded.
    lost : what was lost while it was unpacked; "" for nothing.
    beside : what of its side files was left out; "" for nothing.
    rest : the files behind this one, where a recorder split the log.
    lacking : files of the recording that cannot be had.
    """

    name: str
    view: memoryview
    lost: str = ""
    beside: str = ""
    rest: tuple[OpenLog, ...] = ()
    lacking: tuple[Lacking, ...] = ()

    @property
    def size(self) -> int:
        """Bytes of all its files."""
        return len(self.view) + sum(len(other.view) for other in self.rest)

    def rest_for(self, fmt: Format) -> tuple[memoryview, ...]:
        """The bytes of the files behind the first, for a format that joins them."""
        return tuple(other.view for other in self.rest) if fmt.joins else ()

    def source(self, fmt: Format) -> Source:
        """Name, size and sha256 of the log."""
        return source_of(self.view, self.name, fmt, self.rest_for(fmt))

    @property
    def head(self) -> bytes:
        """What formats are recognised by: the first bytes, behind what zeros a lost write left."""
        zeros = count_zeros(self.view)
        first = zeros if zeros > LEAST_ZEROS else 0
        return bytes(self.view[first : first + HEAD_BYTES])

    def read(self, fmt: Format, limits: Limits) -> Parts:
        """The parts of the log; what its packing and its side files lost counts as damage."""
        try:
            return self.told((yield from fmt.read(self.view, self.name, limits, self.rest_for(fmt))))
        except FormatError as error:
            if limits.format:
                error.hint = f"leave out --format {limits.format}: the log's own bytes tell its format"
            raise

    def told(self, found: T) -> T:
        """What was found in the log, with what its packing, its side files and its other files lost."""
        files = (self, *self.rest)
        lost = {
            where: "; ".join(f"{one.name}: {why}" if self.rest else why for one, why in whys if why)
            for where, whys in (
                ("packing", [(one, one.lost) for one in files]),
                ("side files", [(one, one.beside) for one in files]),
            )
        }
        lost = {where: why for where, why in lost.items() if why}
        harm = harm_of(self.head) if found.damage.lossy else ""
        absent = {one.name: one.messages or 1 for one in self.lacking}
        if self.rest:
            found = replace(found, info={**found.info, "files": ", ".join(one.name for one in files)})
        if not lost and not absent and not harm:
            return found
        damage = replace(
            found.damage,
            truncated=found.damage.truncated or bool(lost),
            undecoded={**found.damage.undecoded, **absent},
            reasons={
                **({"copy": harm} if harm else {}),
                **{one.name: one.why for one in self.lacking},
                **found.damage.reasons,
                **lost,
            },
        )
        return replace(found, damage=damage)


@contextmanager
def open_log(path: Path, limits: Limits | None = None, *, alone: bool = False) -> Iterator[OpenLog]:
    """The bytes of a log, unpacked where it is packed, with what its side files add, mapped into memory.

    Parameters
    ----------
    path : a file, or a member of a .zip archive: `flights.zip/one.tlog`. Any file of a recording of several
        stands for them all.
    limits : how far packed logs may expand.
    alone : this file only, whatever it is part of.

    Raises
    ------
    FormatError : not a readable file, an archive of several files, packed too often, or nothing is in it.
    """
    limits = limits or Limits()
    with ExitStack() as stack:
        paths, lacking = ((path,), ()) if alone else recording_at(path, limits)
        if paths == (path,):
            yield replace(_opened_whole(path, limits, stack), lacking=lacking)
            return
        logs: list[OpenLog] = []
        unusable: dict[str, FormatError] = {}
        for part in paths:
            try:
                logs.append(_opened_part(part, limits, stack))
            except FormatError as error:
                unusable[part.name] = error
        if not logs:
            raise next(iter(unusable.values()))
        lacking += tuple(Lacking(name, error.message) for name, error in unusable.items())
        whole = replace(logs[0], rest=tuple(logs[1:]), lacking=lacking)
        yield _as_one(whole, stack) if ending_of(path.name) == CAPTURE else whole


def _as_one(log: OpenLog, stack: ExitStack) -> OpenLog:
    """The files of a capture as one: what begins in one may go on in the next."""
    joined = stack.enter_context(expand(join_captures((log.view, *(o.view for o in log.rest)))))
    return replace(log, view=joined.view, rest=tuple(replace(o, view=memoryview(b"")) for o in log.rest))


def _opened_whole(path: Path, limits: Limits, stack: ExitStack) -> OpenLog:
    """A file with what its side files add. Raises FormatError where nothing is in it."""
    log = _opened(path, limits, stack)
    _check(log, path)
    return _with_side_files(log, path, limits, stack)


def _opened_part(path: Path, limits: Limits, stack: ExitStack) -> OpenLog:
    """A file of a recording. Raises FormatError where it is none of its kind."""
    log = _opened_whole(path, limits, stack)
    ending = ending_of(path.name)
    if not importlib.import_module(READERS[ending]).sniff(log.head, log.name):
        raise FormatError(f"it does not begin as a {ending} file does", path=path, byte=0)
    return log


def _opened(path: Path, limits: Limits, stack: ExitStack) -> OpenLog:
    """The bytes of a file or a member, unpacked."""
    file, inside = locate(path)
    log = OpenLog(readable(file.name), stack.enter_context(map_file(file)))
    if inside or is_archive(log.view):
        member = _member(file, inside)
        name = PurePosixPath(inside or member.name.replace("\\", "/")).name
        packing = expand(member_pieces(log.view, member, limits.max_ratio))
        log = _unpack(name, stack.enter_context(packing))
    if is_compressed(log.view):
        packing = expand(unpacked_pieces(log.view, limits.max_ratio))
        log = _unpack(own_name(log.name), stack.enter_context(packing), log.lost)
    return log


def _with_side_files(log: OpenLog, path: Path, limits: Limits, stack: ExitStack) -> OpenLog:
    """A database as its own program would read it: with the log and the journal that lie beside it."""
    if bytes(log.view[: len(SQLITE_MAGIC)]) != SQLITE_MAGIC:
        return log
    sides: dict[str, memoryview] = {}
    notes: list[str] = []
    for suffix, side in side_files(path).items():
        try:
            opened = _opened(side, limits, stack)
        except FormatError as error:
            notes.append(f"{side.name} cannot be used: {error.message}")
            continue
        sides[suffix] = opened.view
        notes += [f"{side.name}: {opened.lost}"] if opened.lost else []
    found = recover(log.view, sides)
    if found is None:
        return replace(log, beside="; ".join(notes))
    whole = stack.enter_context(expand(found.pieces()))
    return replace(log, view=whole.view, beside="; ".join([*notes, *found.notes]))


def side_files(path: Path) -> dict[str, Path]:
    """Files with content that belong to the database at `path`, packed or not, by suffix: `bag.db3-wal`."""
    file, inside = locate(path)
    members = read_archive(file).members if inside else {}
    found: dict[str, Path] = {}
    for suffix in READ:
        for packing in ("", *PACKED_SUFFIXES):
            side = path.with_name(own_name(path.name) + suffix + packing)
            member = members.get(side.relative_to(file).as_posix()) if inside else None
            if (member is not None and member.size != 0) or (os.path.isfile(side) and side.stat().st_size):
                found.setdefault(suffix, side)
    return found


def recording_at(path: Path, limits: Limits | None = None) -> tuple[tuple[Path, ...], tuple[Lacking, ...]]:
    """The files of the recording that a file belongs to, in order, and those that are not there."""
    limits = limits or Limits()
    if not ending_of(path.name) or not (part_named(path.name) or names_log(path.with_name(METADATA))):
        return (path,), ()
    if (second := second_capture(path.name)) and not names_log(path.with_name(second)):
        return (path,), ()
    folder = folder_of(path)

    def hear(name: str) -> Heard | None:
        other = path.with_name(name)
        state = locate(other)[0].stat()
        return _heard(Path(os.path.abspath(other)), (state.st_mtime_ns, state.st_size), limits)

    found = recording_of(path.name, folder, hear)
    return tuple(path.with_name(name) for name in found.files), found.lacking


def folder_of(path: Path) -> Folder:
    """What lies beside a file, or a member of an archive."""
    file, inside = locate(path)
    if inside:
        members = [PurePosixPath(name) for name in read_archive(file).members]
        names = [name.name for name in members if name.parent == PurePosixPath(inside).parent]
    else:
        names = sorted(entry.name for entry in os.scandir(path.absolute().parent) if entry.is_file())
    text = ""
    if METADATA in names:
        with suppress(FormatError, OSError):
            text = head_of(path.with_name(METADATA))[1].decode("utf-8", "replace")
    return Folder(path.absolute().parent.name, names, text if MARK in text else "")


@lru_cache
def _heard(path: Path, state: tuple[int, int], limits: Limits) -> Heard | None:  # noqa: ARG001 - of the file
    """When the messages of a file were recorded; None where it cannot be read."""
    try:
        with blaming(path), ExitStack() as stack:
            view = _opened_part(path, limits, stack).view
            return heard(importlib.import_module(READERS[ending_of(path.name)]).listen(view, limits))
    except (FormatError, OSError):
        return None


def identify(path: Path, limits: Limits) -> tuple[str, int]:
    """sha256 and size of a log's bytes, unpacked where it is packed; raises as `open_log`.

    A log that is not packed is read, not mapped: it may be cut meanwhile without harm to this process.
    """
    file, inside = locate(path)
    if inside or not file.is_file() or len(recording_at(path, limits)[0]) > 1:
        return _identify_opened(path, limits)
    with file.open("rb") as opened:
        head = opened.read(FIRST_BYTES)
        is_database = head.startswith(SQLITE_MAGIC)
        if not head or is_archive(head) or is_compressed(head) or (is_database and side_files(path)):
            return _identify_opened(path, limits)
        opened.seek(0)
        return hashlib.file_digest(opened, "sha256").hexdigest(), opened.tell()


def _identify_opened(path: Path, limits: Limits) -> tuple[str, int]:
    with open_log(path, limits) as log:
        return hash_log(log.view, *(other.view for other in log.rest)), log.size


def _unpack(name: str, found: Expanded, lost_before: str = "") -> OpenLog:
    return OpenLog(name, found.view, "; ".join(filter(None, (lost_before, found.lost))))


def _check(log: OpenLog, path: Path) -> None:
    if not log.view:
        why, _, way = (log.lost or "the file is empty").partition("; ")
        raise FormatError(why, path=path, byte=0, hint=way or "check that the download or copy finished")
    if is_archive(log.view) or is_compressed(log.view):
        raise FormatError(
            f"packed too many times: {packing_of(bytes(log.view[:FIRST_BYTES]))}",
            path=path,
            hint="unpack it once: gunzip, unzstd or unzip",
        )
    if bytes(log.view[TAR_MAGIC_AT : TAR_MAGIC_AT + len(TAR_MAGIC)]) == TAR_MAGIC:
        raise FormatError("a tar archive", path=path, hint="unpack it first: tar xf")


def _member(file: Path, inside: str) -> Member:
    """The member that is meant; the only one where none is named."""
    members = read_archive(file).members
    if inside in members:
        return members[inside]
    if inside:
        raise FormatError(f"the archive has no member {inside!r}", path=file, hint=_shown(file, members))
    if len(members) != 1:
        raise FormatError(f"an archive of {len(members)} files", path=file, hint=_shown(file, members))
    return next(iter(members.values()))


def _shown(file: Path, members: dict[str, Member]) -> str:
    shown = ", ".join(f"{file.name}/{name}" for name in list(members)[:5])
    return f"name one: {shown}" if shown else "the archive is empty"


def locate(path: Path) -> tuple[Path, str]:
    """The file that holds a log, and which member of it; "" for the file itself."""
    if not os.path.exists(path):  # whatever the system says of a name: a member's may be longer than any path
        for parent in path.parents:
            if os.path.isfile(parent):
                return parent, path.relative_to(parent).as_posix()
    return path, ""


def members_of(path: Path) -> Mapping[str, Member]:
    """The members of a .zip archive, by name; none for any other file. Raises FormatError and OSError."""
    if not path.is_file() or not begins_archive(path):
        return {}
    return read_archive(path).members


def begins_archive(path: Path) -> bool:
    """Whether a file, as it is, begins as an archive does: one that is packed itself does not."""
    with path.open("rb") as file:
        return is_archive(file.read(FIRST_BYTES))


def begins_database(path: Path) -> bool:
    """Whether a file begins as an SQLite database does: such a one is read with what lies beside it."""
    with path.open("rb") as file:
        return file.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC


def names_log(path: Path) -> bool:
    """Whether a path names a file or a member of an archive, not a folder or nothing."""
    return locate(path)[0].is_file()


def is_archive(head: bytes | memoryview) -> bool:
    """Whether these bytes begin a .zip archive of files: one that is a spreadsheet inside is none."""
    first = bytes(head[:FIRST_BYTES])
    return first.startswith(ZIP_MAGICS) and not is_office(first)


def is_compressed(head: bytes | memoryview) -> bool:
    """Whether these bytes begin a file that is packed with gzip, zstd, xz or bzip2."""
    return bool(kind_of_packing(memoryview(head)))


def short_name(path: Path) -> str:
    """The name of a log's file, and of the member where it is one of an archive."""
    file, inside = locate(path)
    return f"{file.name}/{inside}" if inside else file.name


def head_of(path: Path, limits: Limits | None = None) -> tuple[str, bytes]:
    """The own name and first bytes of a log, without unpacking more than that.

    Raises FormatError and OSError as reading does.
    """
    limits = limits or Limits()
    file, inside = locate(path)
    if not inside:
        with file.open("rb") as opened:
            name = file.name
            head = _head(opened)
    else:
        member = _member(file, inside)
        with map_file(file) as view:
            name = PurePosixPath(inside).name
            head = first_bytes(member_pieces(view, member, limits.max_ratio), HEAD_BYTES)
    return unpacked_head(name, head, limits)


def unpacked_head(name: str, head: bytes, limits: Limits | None = None) -> tuple[str, bytes]:
    """The own name and first bytes of a log of which these are the first as it lies there."""
    if not is_compressed(head):
        return name, head
    ratio = (limits or Limits()).max_ratio
    return own_name(name), first_bytes(unpacked_pieces(memoryview(head), ratio), HEAD_BYTES)


def _head(file: BinaryIO) -> bytes:
    """The first bytes of a file, behind what zeros a lost write left."""
    start = 0
    head = file.read(HEAD_BYTES)
    while head and not head.strip(b"\0"):
        start += len(head)
        head = file.read(HEAD_BYTES)
    zeros = len(head) - len(head.lstrip(b"\0"))
    if start + zeros <= LEAST_ZEROS:
        return head
    file.seek(start + zeros)
    return file.read(HEAD_BYTES)
