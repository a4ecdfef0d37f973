"""A blackbox file's logs and their headers.

    H Product:Blackbox flight data recorder by Nicholas Sherlock
    H Field I name:loopIteration,time,axisP[0], ...
    H Field P encoding:9,0,0, ...
    H rollPID:46,45,25

A log begins with the first of these lines and ends where the next one begins. Settings that decide how
frames are read are found by name; all others are kept as they stand. A damaged line is passed over, and
counted.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field
from functools import cached_property

from flysid.flight import Region

START = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n"
END_EVENT = b"E\xffEnd of log"
MAX_HEADER_BYTES = 1 << 20
MAX_GARBAGE_BYTES = 8192
SEARCH_BYTES = 16 << 20
PADDING = b"\x00\xff"
MIN_PADDING = 16
_LINE = re.compile(rb"H (?:([^\x00-\x1f:]+):([^\n\x00]*))?\n")
_NEXT_LINE = re.compile(rb"H ([A-Za-z][\w ()\[\].]{0,60}):[^\n\x00]*\n")
_CUT_LINE = re.compile(rb"H( [^\n\x00]*)?")
_SWALLOWED = re.compile(r"H [A-Za-z][\w ()\[\].]*:")
_NUMBER = r" ?(?:[+-]?\d{1,12}(?:\.\d{1,12})?|0x[0-9a-fA-F]{8}) ?"
_NUMBERS = re.compile(rf"{_NUMBER}(?:[,/]{_NUMBER})*", re.ASCII)
_FIRMWARE = re.compile(
    r"(Betaflight|INAV|Cleanflight|Rotorflight|EmuFlight|Baseflight|Raceflight)\D*(\d+(?:\.\d+)*)", re.I
)


@dataclass(frozen=True)
class HeaderLine:
    """One header line and where it stands."""

    name: str
    text: str
    start: int


@dataclass(frozen=True)
class Definition:
    """Fields of one kind of frame as the header lists them, in equal numbers."""

    names: tuple[str, ...]
    unsigned: tuple[bool, ...]
    predictors: tuple[int, ...]
    encodings: tuple[int, ...]


@dataclass(frozen=True)
class Header:
    """The header of one log.

    Attributes
    ----------
    lines : every line that could be read, in order.
    end : where it ends.
    damaged : bytes that are no header lines.
    cut : the file ends inside a line.
    """

    lines: tuple[HeaderLine, ...]
    end: int
    damaged: tuple[Region, ...] = ()
    cut: bool = False
    _texts: Mapping[str, str] = field(default_factory=dict)

    def text(self, *names: str) -> str:
        """The text of the first of these settings that the header has; '' where it has none."""
        return next((self._texts[name] for name in names if name in self._texts), "")

    def numbers(self, *names: str) -> tuple[float, ...]:
        """The numbers of a setting; empty where it has others than numbers."""
        return numbers_of(self.text(*names))

    def number(self, name: str, default: int) -> int:
        """A whole number that fits 32 bits; the default where there is none."""
        found = self.numbers(name)
        return int(found[0]) if found and abs(found[0]) < 1 << 31 else default

    @cached_property
    def firmware(self) -> tuple[str, tuple[int, ...]]:
        """(name in lower case, version) of the firmware; ("", ()) where it is not told."""
        match = _FIRMWARE.search(self.text("Firmware revision"))
        if match is None:
            return "", ()
        return match[1].lower(), tuple(int(part) for part in match[2].split("."))

    def definition(self, kind: str) -> Definition | None:
        """The fields of frames of this letter; None where the header does not define them soundly."""
        like = "I" if kind == "P" else kind
        names = self.text(f"Field {like} name").split(",")
        signed = _whole(self.text(f"Field {like} signed"))
        predictors, encodings = (_whole(self.text(f"Field {kind} {w}")) for w in ("predictor", "encoding"))
        sizes = {len(names), len(signed), len(predictors), len(encodings)}
        if sizes != {len(names)} or not all(names) or len(set(names)) != len(names):
            return None
        return Definition(tuple(names), tuple(s == 0 for s in signed), predictors, encodings)


def _whole(text: str) -> tuple[int, ...]:
    parts = text.split(",")
    return tuple(int(p) for p in parts) if all(p.isdigit() and len(p) < 4 for p in parts) else ()


def numbers_of(text: str) -> tuple[float, ...]:
    """The numbers in "46,45,25", "1/8", "0x3f800000" (the bits of a float32); empty where it has words."""
    if _NUMBERS.fullmatch(text) is None:
        return ()
    found = tuple(_number(word.strip()) for word in text.replace("/", ",").split(","))
    return found if all(map(math.isfinite, found)) else ()


def _number(word: str) -> float:
    if not word.startswith("0x"):
        return float(word)
    value: float = struct.unpack("<f", struct.pack("<I", int(word, 16)))[0]
    return value


def find_logs(view: memoryview) -> list[int]:
    """Where logs begin."""
    found: list[int] = []
    for at in range(0, len(view), SEARCH_BYTES):
        piece = bytes(view[at : at + SEARCH_BYTES + len(START) - 1])
        found.extend(at + match.start() for match in re.finditer(re.escape(START), piece))
    return found


def read_header(view: memoryview, start: int, stop: int) -> Header:
    """The header of the log that begins at `start` and ends at `stop`."""
    piece = bytes(view[start : min(stop, start + MAX_HEADER_BYTES)])
    lines: list[HeaderLine] = []
    damaged: list[Region] = []
    at = 0
    while True:
        match = _LINE.match(piece, at)
        if match is None:
            resume = _resume(piece, at, {line.name for line in lines})
            if resume is None:
                break
            damaged.append(Region(start + at, start + resume, "no header line"))
            at = resume
            continue
        lines.extend(_lines(match, start + at))
        at = match.end()
    cut = start + len(piece) == stop and _CUT_LINE.fullmatch(piece, at) is not None
    texts: dict[str, str] = {}
    for line in lines:
        texts.setdefault(line.name, line.text)
    return Header(tuple(lines), start + at, tuple(damaged), cut, texts)


def _lines(match: re.Match[bytes], at: int) -> Iterator[HeaderLine]:
    """The line; none where it has no name, as one that some firmwares end with."""
    if match[1] is not None:
        yield HeaderLine(
            match[1].decode("utf-8", "replace"), match[2].decode("utf-8", "replace").rstrip("\r"), at
        )


def is_sound(line: HeaderLine) -> bool:
    """Whether a line is text, and holds no second one because what stood between them is damaged."""
    return line.text.isprintable() and "\ufffd" not in line.text and not _SWALLOWED.search(line.text)


def _resume(piece: bytes, at: int, seen: Set[str]) -> int | None:
    """Where the header goes on behind damage; None where it has ended, and frames or nothing follow.

    A header says everything once, and stands before the frames: a line that has been seen, or the end of a
    log, shows that what follows belongs to another log, whose first line is damaged.
    """
    if at >= len(piece) or piece[at : at + 2] == b"I\x00":
        return None
    match = _NEXT_LINE.search(piece, at + 1, at + MAX_GARBAGE_BYTES)
    if match is None or match[1].decode() in seen or END_EVENT in piece[at : match.start()]:
        return None
    return match.start()
