"""Files of one recording by their names, and by the list that a ROS 2 recorder keeps of them.

    rosbag2   NAME/NAME_0.db3, NAME/NAME_1.db3 ... or .mcap, and NAME/metadata.yaml, which lists them
    rosbag    NAME_0.bag, NAME_1.bag ...; or NAME_2026-05-04-10-11-12_0.bag, each with the time when it began

    tcpdump   NAME.pcap, NAME.pcap1, NAME.pcap2 ...
    dumpcap   NAME_00001_20260504101112.pcapng, NAME_00002_...: numbers and the time when each began

People number files, too: flight_1.bag and flight_2.bag are two flights. So names alone prove nothing, but
in a folder of the recorder's own, which bears the name of its files. Elsewhere contents decide
(`continued`).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from flysid.ingest.formats.common.packed_names import PACKED_SUFFIXES

METADATA = "metadata.yaml"
MARK = "rosbag2_bagfile_information:"
_PACKED = "(?:" + "|".join(map(re.escape, PACKED_SUFFIXES)) + ")?"
_PART = re.compile(
    r"(?P<stem>.+)_(?P<number>\d{1,9})(?P<ending>\.(?:db3|mcap|bag))(?P<behind>(?:\.active)?" + _PACKED + ")",
    re.IGNORECASE,
)
_CAPTURES = (
    re.compile(r"(?P<stem>.+)(?P<ending>\.p?cap)(?P<number>\d{0,9})(?P<behind>" + _PACKED + ")", re.I),
    re.compile(
        r"(?P<stem>.+)_(?P<number>\d{5})_\d{14}(?P<ending>\.pcapng|\.pcap)(?P<behind>" + _PACKED + ")",
        re.I,
    ),
)
CAPTURE = ".pcap"
_LISTABLE = (".db3", ".mcap")
_SPLITTABLE = re.compile(r".+(?P<ending>\.(?:db3|mcap|bag))(?:\.active)?" + _PACKED, re.IGNORECASE)
_DATED = re.compile(r"(?P<prefix>.*?)(?P<date>\d{4}(?:-\d\d){5})")
_LISTED = re.compile(r"\s*-\s+(?P<key>path:\s*)?[\"']?(?P<path>[^\"']+\.(?:db3|mcap)[^\"'\s]*)[\"']?\s*")
_COUNT = re.compile(r"\s+message_count:\s*(\d+)\s*")


@dataclass(frozen=True, order=True)
class Part:
    """A file that may be one of several: parts of one family sort as they were recorded.

    Attributes
    ----------
    family : what the names of the others have in common with this one: beginning and ending.
    date : when a ROS 1 recorder began the file, as its name states; "" where it does not.
    number : the file's, in its recording.
    behind : what packing, or a recorder at work, added to the name.
    stem : the name before the number.
    """

    family: tuple[str, str]
    date: str
    number: int
    behind: str
    name: str
    stem: str


def part_named(name: str) -> Part | None:
    """What a file's name says of its place in a recording; None where it says nothing."""
    found = _PART.fullmatch(name)
    if found is None:
        return _capture_named(name)
    stem = found["stem"]
    ending = found["ending"].lower()
    dated = _DATED.fullmatch(stem) if ending == ".bag" else None
    family = (dated["prefix"] if dated else stem, ending)
    return Part(family, dated["date"] if dated else "", int(found["number"]), found["behind"], name, stem)


def _capture_named(name: str) -> Part | None:
    """What the name of a capture says; one without a number may be the first of several."""
    found = next(filter(None, (names.fullmatch(name) for names in reversed(_CAPTURES))), None)
    if found is None:
        return None
    family = (found["stem"], found["ending"].lower())
    return Part(family, "", int(found["number"] or 0), found["behind"], name, found["stem"])


def second_capture(name: str) -> str:
    """How the second file of a capture is called whose first file has this name; "" for other names."""
    is_first = name.lower().endswith((".pcap", ".cap")) and _CAPTURES[1].fullmatch(name) is None
    return f"{name}1" if is_first else ""


def ending_of(name: str) -> str:
    """The ending of a file of a kind that recorders split, in lower case; "" for other files."""
    found = _SPLITTABLE.fullmatch(name)
    if found is None:
        return CAPTURE if _capture_named(name) is not None else ""
    return found["ending"].lower()


def possible_parts(names: Collection[str]) -> frozenset[str]:
    """Of the files of a folder those that may be parts of one recording, by their names, and its list."""
    parts = [part for name in names if (part := part_named(name)) is not None]
    sizes = Counter(part.family for part in parts)
    found = {part.name for part in parts if sizes[part.family] > 1 or part.date}
    if METADATA in names:
        found |= {METADATA, *(name for name in names if ending_of(name))}
    return frozenset(found)


def companies(names: Collection[str]) -> list[tuple[str, ...]]:
    """Files of a folder that may be one recording, in groups of two or more; contents may part a group.

    Examples
    --------
    >>> companies(["a_0.bag", "a_1.bag", "b_0.bag", "notes.txt"])
    [('a_0.bag', 'a_1.bag')]
    """
    parts = possible_parts(names)
    groups: dict[tuple[str, str], list[str]] = {}
    for name in sorted(parts):
        part = part_named(name)
        is_listed = METADATA in parts and (name == METADATA or ending_of(name) in _LISTABLE)
        if is_listed or part is not None:
            groups.setdefault(("", METADATA) if is_listed or part is None else part.family, []).append(name)
    return [tuple(group) for group in groups.values() if len(group) > 1]


def relatives(part: Part, names: Iterable[str]) -> list[Part]:
    """The parts of a part's family, itself among them, in order; one file for each number.

    Where a file is there packed and unpacked, it is the one that is packed as `part` is.
    """
    every = filter(None, map(part_named, names))
    found: dict[tuple[str, int], Part] = {}
    for other in every:
        key = (other.date, other.number)
        if other.family != part.family or bool(other.date) != bool(part.date):
            continue
        if key not in found or other.behind == part.behind:
            found[key] = other
    found[part.date, part.number] = part
    return sorted(found.values())


def listed(text: str) -> Mapping[str, int | None]:
    """The files that a `metadata.yaml` lists, in order, and the messages of each where it counts them.

    Older recorders list `NAME/NAME_0.db3`: files are looked for in the list's own folder, whatever it says.
    """
    found: dict[str, int | None] = {}
    at = ""
    for line in text.splitlines():
        if (entry := _LISTED.fullmatch(line)) is not None:
            name = re.split(r"[/\\]", entry["path"])[-1]
            at = name if entry["key"] else ""
            found.setdefault(name, None)
        elif at and (count := _COUNT.fullmatch(line)) is not None:
            found[at] = int(count[1])
            at = ""
    return found
