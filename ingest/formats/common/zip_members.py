"""The members of a .zip archive: from its list, or, where that is lost, from the headers before each member.

Members are named by cleaned paths: no member's name leads out of its archive.
"""

from __future__ import annotations

import re
import struct
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntFlag
from functools import lru_cache
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZIP_STORED

from flysid.ingest.formats.base import map_file
from flysid.ingest.formats.common.compression import CompressionError, inflated_pieces, unpacked_pieces

ZIP_MAGICS = (b"PK\x03\x04", b"PK\x05\x06", b"PK\x07\x08PK\x03\x04")
PACKED_AS_FILES = (zipfile.ZIP_BZIP2, 93, 95)  # bzip2, zstd, xz
_LOCAL = struct.Struct("<4s5H3I2H")
_IN_ZIP64 = 0xFFFFFFFF
_ZIP64 = struct.Struct("<QQ")
_DRIVE = re.compile(r"^[A-Za-z]:")


class _Flag(IntFlag):
    """Bits of a member's flags."""

    ENCRYPTED = 1
    SIZES_FOLLOW = 8
    UTF8 = 1 << 11


@dataclass(frozen=True)
class Member:
    """One file of an archive; `fault` says why it cannot be opened, `size` and `crc` None where unknown."""

    name: str
    header: int
    packed: int
    method: int
    size: int | None = None
    crc: int | None = None
    fault: str = ""


@dataclass(frozen=True)
class Archive:
    """The members of an archive by their names, and what is wrong with it ("" for nothing)."""

    members: dict[str, Member]
    fault: str = ""


def read_archive(path: Path) -> Archive:
    """The members of an archive; nothing of them is expanded. Raises FormatError where it cannot be read."""
    state = path.stat()
    return _read_archive(path, state.st_size, state.st_mtime_ns)


@lru_cache(maxsize=4)  # each member is opened for itself, and asks again
def _read_archive(path: Path, size: int, modified_ns: int) -> Archive:  # noqa: ARG001
    try:
        with zipfile.ZipFile(path) as archive:
            found = [_list_member(info) for info in archive.infolist() if not info.filename.endswith("/")]
        fault = ""
    except (zipfile.BadZipFile, ValueError, NotImplementedError, struct.error, EOFError):
        found = []
        fault = "the archive's list of members is cut off or damaged; some may be missing"
    with map_file(path) as view:
        if found and not any(_is_in_place(view, member) for member in found):
            fault = "the archive's list of members does not fit it: bytes are missing, or were added"
        if fault:
            found = list(_met(view)) or found
    return Archive(_name(_bound(found)), fault)


def _is_in_place(view: memoryview, member: Member) -> bool:
    """Whether a member's header stands where the list says."""
    return member.header >= 0 and view[member.header : member.header + 4] == ZIP_MAGICS[0]


def member_pieces(view: memoryview, member: Member, max_ratio: float) -> Iterator[bytes]:
    """What a member expands to; raises CompressionError where it is cut, damaged or not what the archive has.

    `max_ratio` : see `Limits`.
    """
    if member.fault:
        raise CompressionError(member.fault)
    start = _data_start(view, member)
    packed = view[start : start + member.packed]
    total = 0
    crc = 0
    for piece in _unpack(packed, member.method, max_ratio):
        total += len(piece)
        crc = zlib.crc32(piece, crc)
        yield piece
        if member.size is not None and total > member.size:
            raise CompressionError(f"it is larger than the {member.size} bytes that the archive states")
    if len(packed) < member.packed:
        raise CompressionError("the archive ends inside it")
    if member.size is not None and total < member.size:
        raise CompressionError(f"{member.size - total} of its {member.size} bytes are missing")
    if member.crc is not None and crc != member.crc:
        raise CompressionError("its checksum is wrong: some of its bytes are damaged")


def _unpack(packed: memoryview, method: int, max_ratio: float, *, piece: int = 1 << 20) -> Iterator[bytes]:
    if method == ZIP_DEFLATED:
        return inflated_pieces(packed, max_ratio)
    if method in PACKED_AS_FILES:
        return unpacked_pieces(packed, max_ratio)
    return (bytes(packed[at : at + piece]) for at in range(0, len(packed), piece))


def _data_start(view: memoryview, member: Member) -> int:
    head = bytes(view[member.header : member.header + _LOCAL.size])
    if len(head) < _LOCAL.size or head[:4] != ZIP_MAGICS[0]:
        raise CompressionError(f"its header at byte {member.header} of the archive is damaged")
    *_, name, extra = _LOCAL.unpack(head)
    return int(member.header + _LOCAL.size + name + extra)


# ------------------------------------------------------------------------------------------ what there is


def _list_member(info: zipfile.ZipInfo) -> Member:
    fault = _fault(info.compress_type, info.flag_bits)
    return Member(
        info.filename,
        info.header_offset,
        info.compress_size,
        info.compress_type,
        info.file_size,
        info.CRC,
        fault,
    )


def _fault(method: int, flags: int) -> str:
    if flags & _Flag.ENCRYPTED:
        return "is encrypted; unpack it first"
    if method not in (ZIP_STORED, ZIP_DEFLATED, *PACKED_AS_FILES):
        named = zipfile.compressor_names.get(method, f"method {method}")  # type: ignore[attr-defined]
        return f"uses a compression method that is not supported ({named}); unpack it first"
    return ""


def _met(view: memoryview) -> Iterator[Member]:
    """The members of an archive without a list, by the headers that stand before them."""
    at = 0
    for match in re.finditer(re.escape(ZIP_MAGICS[0]), view):
        if match.start() < at:
            continue
        member = _at_header(view, match.start())
        if member is not None:
            at = _data_start(view, member) + member.packed
            if not member.name.endswith("/"):
                yield member


def _at_header(view: memoryview, at: int) -> Member | None:
    """The member whose header stands at `at`; None where what stands there is no header."""
    head = bytes(view[at : at + _LOCAL.size])
    if len(head) < _LOCAL.size:
        return None
    _, version, flags, method, _, _, crc, packed, size, name_bytes, extra_bytes = _LOCAL.unpack(head)
    name_at = at + _LOCAL.size
    raw = bytes(view[name_at : name_at + name_bytes])
    if not raw or len(raw) < name_bytes or version & 0xFF > 100 or b"\0" in raw:
        return None
    name = raw.decode("utf-8" if flags & _Flag.UTF8 else "cp437", "replace")
    start = name_at + name_bytes + extra_bytes
    extra = bytes(view[name_at + name_bytes : start])
    if _IN_ZIP64 in (packed, size):
        size, packed = _zip64(extra, size, packed)
    if flags & _Flag.SIZES_FOLLOW and not packed:
        return Member(name, at, _end_of_data(view, start) - start, method, fault=_fault(method, flags))
    return Member(name, at, packed, method, size, crc, _fault(method, flags))


def _zip64(extra: bytes, size: int, packed: int) -> tuple[int, int]:
    at = extra.find(b"\x01\x00")
    if at < 0 or len(extra) < at + 4 + _ZIP64.size:
        return size, packed
    large: tuple[int, int] = _ZIP64.unpack_from(extra, at + 4)
    return large


def _end_of_data(view: memoryview, start: int) -> int:
    """Where a member ends whose size stands behind it; the end of the archive where nothing tells."""
    for match in re.finditer(rb"PK\x07\x08|PK\x03\x04|PK\x01\x02", view[start:]):
        at = start + match.start()
        if match[0] == b"PK\x07\x08":
            stated = int.from_bytes(view[at + 8 : at + 12], "little")
            if stated == match.start():
                return at
        elif int.from_bytes(view[at - 8 : at - 4], "little") == match.start() - 12:
            return at - 12
    return len(view)


def _bound(found: list[Member]) -> list[Member]:
    """Mark as faulty what gives the same bytes twice: by that alone an archive can expand without bound."""
    bounded: list[Member] = []
    end = 0
    for member in sorted(found, key=lambda member: member.header):
        overlaps = member.header < end
        end = max(end, member.header + _LOCAL.size + member.packed)
        bounded.append(_faulty(member, "it shares bytes with another member") if overlaps else member)
    return bounded


def _faulty(member: Member, why: str) -> Member:
    return Member(member.name, member.header, member.packed, member.method, member.size, member.crc, why)


def _name(found: list[Member]) -> dict[str, Member]:
    """Members by cleaned names; the second of a name gets a number."""
    named: dict[str, Member] = {}
    for member in found:
        name = label = _clean(member.name)
        count = 1
        while label in named:
            count += 1
            label = f"{name}#{count}"
        named[label] = member
    return named


def _clean(name: str) -> str:
    """A relative path with forward slashes that stays inside its archive."""
    parts = _DRIVE.sub("", name.replace("\\", "/").replace("\0", "")).split("/")
    return "/".join(part for part in parts if part not in ("", ".", "..")) or "(no name)"
