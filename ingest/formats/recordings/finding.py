"""The recording that a file belongs to: its files in order, and those that are not there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from flysid.ingest.formats.common.packed_names import PACKED_SUFFIXES
from flysid.ingest.formats.recordings.continued import Heard, goes_on
from flysid.ingest.formats.recordings.names import (
    METADATA,
    Part,
    listed,
    part_named,
    relatives,
)

READERS: Mapping[str, str] = {
    ".bag": "flysid.ingest.formats.rosbag1.reader",
    ".db3": "flysid.ingest.formats.rosbag2.reader",
    ".mcap": "flysid.ingest.formats.mcap.reader",
    ".pcap": "flysid.ingest.formats.common.capture",
}
Listen = Callable[[str], Heard | None]
"""The times of the messages of a file of the folder, by its name; None where it has none."""


@dataclass(frozen=True)
class Lacking:
    """A file of a recording that is not there.

    Attributes
    ----------
    messages : how many it has; None where nothing says.
    """

    name: str
    why: str
    messages: int | None = None


@dataclass(frozen=True)
class Recording:
    """Files that are one recording, by name, in order, and those that are not there."""

    files: tuple[str, ...]
    lacking: tuple[Lacking, ...] = ()


@dataclass(frozen=True)
class Folder:
    """What lies beside a file.

    Attributes
    ----------
    name : of the folder.
    files : names of its files.
    metadata : the text of its list of files, "" where there is none.
    """

    name: str
    files: Sequence[str]
    metadata: str = ""


def recording_of(name: str, folder: Folder, listen: Listen) -> Recording:
    """The recording of a file: by the list in its folder, by the folder's name, or by what it goes on from.

    Parameters
    ----------
    name : of a file in `folder`.
    listen : see `Listen`; called only where names do not tell.
    """
    of_list = _by_list(name, folder)
    part = part_named(name)
    if part is None:
        return of_list or Recording((name,))
    family = relatives(part, folder.files)
    if of_list is not None:
        unlisted = [other for other in family if other.name not in of_list.files]
        behind = [other for other in unlisted if other.number > _last_number(of_list.files)]
        found = _grown(of_list, behind, folder, listen)
        return found if name in found.files else _by_times(part, unlisted, listen, True)
    if part.stem == folder.name and part.family[1] in (".db3", ".mcap"):
        files = tuple(other.name for other in family)
        return Recording(files, () if _files_of_list(folder) else tuple(_holes(family)))
    return _by_times(part, family, listen, len(folder.files) > 1)


def _by_list(name: str, folder: Folder) -> Recording | None:
    """The files that the folder's list names, where it lists this one, or what this one follows."""
    entries = listed(folder.metadata)
    there = _files_of_list(folder)
    part = part_named(name)
    families = {other.family for entry in there if (other := part_named(entry)) is not None}
    if not there or (name not in there and (part is None or part.family not in families)):
        return None
    lacking = (
        Lacking(entry, f"{METADATA} lists it, and it is not there", count)
        for entry, count in entries.items()
        if entry not in there.values()
    )
    return Recording(tuple(there), tuple(lacking))


def _files_of_list(folder: Folder) -> Mapping[str, str]:
    """The files of the folder that its list means, and how it calls each."""
    entries = listed(folder.metadata)
    return {found: entry for entry in entries if (found := present(entry, folder.files))}


def present(entry: str, files: Sequence[str]) -> str:
    """The file that an entry of the list means: as listed, or packed or unpacked since; "" for none."""
    plain = entry.removesuffix(".zstd")
    return next((name for name in (entry, plain, *_packed(plain)) if name in files), "")


def _packed(name: str) -> tuple[str, ...]:
    return tuple(name + suffix for suffix in PACKED_SUFFIXES)


def _last_number(names: Sequence[str]) -> int:
    return max((part.number for name in names if (part := part_named(name)) is not None), default=-1)


def _grown(found: Recording, behind: Sequence[Part], folder: Folder, listen: Listen) -> Recording:
    """A recording with files that came after its list was written."""
    files = list(found.files)
    for part in behind:
        if part.stem == folder.name or _goes_on(files[-1], part.name, listen):
            files.append(part.name)
    return Recording(tuple(files), found.lacking)


def _holes(family: Sequence[Part]) -> list[Lacking]:
    """The files whose numbers are passed over, from 0 on: a recorder numbers from there."""
    numbers = {part.number for part in family}
    return [_hole(family[0], number) for number in range(max(numbers)) if number not in numbers]


def _hole(like: Part, number: int) -> Lacking:
    name = f"{like.stem}_{number}{like.family[1]}"
    return Lacking(name, "the files beside it are numbered so that it belongs to them, and it is not there")


def _by_times(part: Part, family: Sequence[Part], listen: Listen, has_company: bool) -> Recording:
    """The files around one that go on from each other.

    A file that was copied alone misses nobody: `has_company` is whether others lie beside it.
    """
    at = family.index(part)
    first = at
    while first and _follows(family[first - 1], family[first], listen):
        first -= 1
    last = at
    while last + 1 < len(family) and _follows(family[last], family[last + 1], listen):
        last += 1
    files = family[first : last + 1]
    lacking: tuple[Lacking, ...] = ()
    if files[0].date and files[0].number and has_company:
        before = f"{files[0].family[0]}*_{files[0].number - 1}.bag"
        lacking = (Lacking(before, f"{files[0].name} goes on from it, by its number, and it is not there"),)
    return Recording(tuple(one.name for one in files), lacking)


def _follows(before: Part, after: Part, listen: Listen) -> bool:
    return after.number == before.number + 1 and _goes_on(before.name, after.name, listen)


def _goes_on(before: str, after: str, listen: Listen) -> bool:
    heard_before = listen(before)
    heard_after = listen(after)
    return heard_before is not None and heard_after is not None and goes_on(heard_before, heard_after)
