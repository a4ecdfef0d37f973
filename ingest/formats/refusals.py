"""Why a file that no format recognises is none: what is wrong with it, where, and what to do.

What is certainly something else is known before any reader looks (`recognised`). Here are the files that
were meant to be logs: harmed on the way, cut, written down as text, or simply something else.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from flysid.errors import FormatError
from flysid.ingest.formats.base import Format, Limits
from flysid.ingest.formats.blame import blaming
from flysid.ingest.formats.common.capture import LinkType, is_capture
from flysid.ingest.formats.common.pcap import is_pcap
from flysid.ingest.formats.common.transfer import ENOUGH, REPLACED, is_text, text_mode_at
from flysid.ingest.formats.rosbag2.sqlite_pages import MAGIC as SQLITE_MAGIC
from flysid.ingest.formats.texts import Cause, cause_of_text
from flysid.parts import exhaust
from flysid.showing import first_of

FORMATS_OF_BYTES = frozenset({"blackbox", "dataflash", "mcap", "rosbag", "ulog"})
"""Formats whose readers find records without the beginning of the file."""
_PIECE = re.compile(r"(?P<whole>.+\.\w+)\.(?:\d{3}|part\d+|[a-z]{2})", re.IGNORECASE)
_HEX = re.compile(rb"(?:[0-9A-Fa-f]{2}[\s:,]*){16,}")
_BASE64 = re.compile(rb"[A-Za-z0-9+/\s]{64,}={0,2}\s*")
_HEADER = re.compile(rb"^H [A-Za-z][\w .]*:[^\n\0]*\r?\n(?=H )", re.MULTILINE)
_DATAFLASH_MARK = b"\xa3\x95"
_FMT = 0x80
_TABLE = re.compile(rb"create table\W{1,3}(\w+)", re.IGNORECASE)
_NAMED = 5
_FIRST = 8


Sniff = Callable[[bytes], tuple[float, Format]]
"""How sure a format is of bytes, and which one."""


def refuse(head: bytes, name: str, formats: Iterable[Format], sniff: Sniff) -> FormatError:
    """The error of a file that begins so and that no format recognises.

    Parameters
    ----------
    head : its first bytes.
    formats : every format.
    sniff : what format other bytes would be of: those that this file was before it was harmed.
    """
    meant = [fmt for fmt in formats if name.lower().endswith(fmt.suffixes)]
    checks: tuple[Callable[[], Cause | None], ...] = (
        lambda: _of_capture(head),
        lambda: _of_one_byte(head),
        lambda: _of_database(head),
        lambda: _of_transfer(head, sniff),
        lambda: _of_writing(head, sniff),
        lambda: _of_cutting(name),
        lambda: _of_definitions(head),
        lambda: _of_beginning(head, name, meant),
        lambda: cause_of_text(head, meant),
        lambda: _of_chance(head),
    )
    causes = (check() for check in checks)
    found = next(filter(None, causes), None) or _of_bytes(head, meant, formats)
    return FormatError(found.said, path=name, byte=found.byte, hint=found.hint)


def _of_capture(head: bytes) -> Cause | None:
    if not is_capture(head):
        return None
    link = int.from_bytes(head[20:24], "little" if head[0] in b"\xd4\x4d" else "big")
    if is_pcap(head) and link not in set(LinkType):
        return Cause(
            f"a network capture of link type {link}, whose packets are not read",
            "read are Ethernet, raw IP, loopback and Linux cooked capture: capture there, not on the radio",
            20,
        )
    return Cause(
        f"a network capture without MAVLink or navdata in its first {len(head):,} bytes",
        "where it begins later, --format tlog or navdata; read are unencrypted UDP and TCP, over "
        "Ethernet, raw IP, loopback or Linux cooked capture",
    )


def _of_database(head: bytes) -> Cause | None:
    if not head.startswith(SQLITE_MAGIC):
        return None
    names = [name.decode("utf-8", "replace") for name in _TABLE.findall(head)]
    defined = f"it defines {first_of(names, _NAMED)}" if names else "it has no table of messages"
    return Cause(f"an SQLite database that is no ROS 2 bag: {defined}", "give the bag: a .db3 file")


def _of_one_byte(head: bytes) -> Cause | None:
    if head.strip(head[:1]):
        return None
    return Cause(
        f"nothing but bytes {head[0]:02X} at its beginning: memory that was never written",
        "copy it from the vehicle again; if it is so there, too, the log was never written",
    )


# --------------------------------------------------------------------------------- harmed on the way


def _of_transfer(head: bytes, sniff: Sniff) -> Cause | None:
    at = text_mode_at(head)
    plain = head.replace(b"\r\n", b"\n")
    if at >= 0 or (plain != head and _is_log(plain, sniff)):
        at = head.index(b"\r\n")
        what = _title(plain, sniff)
        return Cause(
            f"{what} that was copied as text, which put a byte 0D ahead of every 0A, first at byte {at}",
            "copy it in binary mode; or take them out: perl -pe 's/\\r\\n/\\n/' LOG > NEW",
            at,
        )
    if head.count(REPLACED) >= ENOUGH:
        return Cause(
            "binary data that were saved as text: bytes that are no text were replaced, and are gone",
            "copy the log from the vehicle again, and do not open it in an editor",
            head.index(REPLACED),
        )
    plain = _without_utf_8(head)
    if plain and _is_log(plain, sniff):
        return Cause(
            f"{_title(plain, sniff)} that was saved as text in UTF-8: every byte from 80 on became two",
            "copy it in binary mode; or turn it back: iconv -f UTF-8 -t ISO-8859-1 LOG > NEW",
            next(k for k, byte in enumerate(head) if byte > 127),
        )
    if max(head) < 128 and not is_text(head):
        return Cause(
            "no byte above 7F: binary data that lost the first bit of every byte on the way",
            "copy it again, over a link of 8 bits, in binary mode",
        )
    return None


def _without_utf_8(head: bytes) -> bytes:
    """The bytes that UTF-8 was made of, one for each character; b"" where it is no such text."""
    try:
        return head.decode("utf-8", "ignore").encode("latin-1") if max(head) > 127 else b""
    except UnicodeEncodeError:
        return b""


def _of_writing(head: bytes, sniff: Sniff) -> Cause | None:
    """A log that is written down as text."""
    for kind, plain, way in (
        ("hexadecimal numbers", _from_hex(head), "xxd -r -p LOG NEW"),
        ("base64", _from_base64(head), "base64 -d LOG > NEW"),
    ):
        if plain and _is_log(plain, sniff):
            return Cause(f"{_title(plain, sniff)} written down in {kind}", f"turn it back: {way}")
    return None


def _from_hex(head: bytes) -> bytes:
    found = _HEX.match(head)
    digits = re.sub(rb"[^0-9A-Fa-f]", b"", found[0]) if found else b""
    return binascii.unhexlify(digits[: len(digits) // 2 * 2])


def _from_base64(head: bytes) -> bytes:
    found = _BASE64.match(head)
    digits = b"".join(found[0].split()) if found else b""
    return base64.b64decode(digits[: len(digits) // 4 * 4] or b"", validate=False)


def _is_log(head: bytes, sniff: Sniff) -> bool:
    return sniff(head)[0] > LEAST


LEAST = 0.6  # tables in text claim no more


def _title(head: bytes, sniff: Sniff) -> str:
    return sniff(head)[1].title if _is_log(head, sniff) else "binary data"


# ------------------------------------------------------------------------------------ what is missing


def _of_definitions(head: bytes) -> Cause | None:
    """Frames of Betaflight or messages of ArduPilot without what defines them."""
    header = _HEADER.search(head)
    if header is not None:
        return Cause(
            f"a blackbox log without its first line: header lines follow from byte {header.start()} on",
            "copy it again, whole: the first line begins with 'H Product:Blackbox'",
            header.start(),
        )
    kinds = [head[at + 2] for at in _places(head, _DATAFLASH_MARK) if at + 2 < len(head)]
    if len(kinds) < 8 or _FMT in kinds or len(set(kinds)) > len(kinds) // 2:
        return None
    at = head.index(_DATAFLASH_MARK)
    return Cause(
        f"DataFlash messages without their definitions (FMT): {len(kinds)} of {len(set(kinds))} kinds from "
        f"byte {at} on, and nothing says what they hold",
        "the beginning of the log is missing: copy it from the vehicle again, whole",
        at,
    )


def _places(head: bytes, mark: bytes) -> Iterator[int]:
    at = head.find(mark)
    while at >= 0:
        yield at
        at = head.find(mark, at + 1)


def _of_beginning(head: bytes, name: str, meant: list[Format]) -> Cause | None:
    """A log whose first bytes are missing: its reader finds records behind them."""
    for fmt in meant:
        found = _records_in(head, name, fmt) if fmt.name in FORMATS_OF_BYTES else None
        if found is not None:
            return Cause(
                f"{fmt.title} without its beginning: records follow from byte {found} on",
                f"copy it again, whole; or --format {fmt.name} reads what is left",
                found,
            )
    return None


def _records_in(head: bytes, name: str, fmt: Format) -> int | None:
    """Where the first records lie that a format's reader finds; None where it finds none."""
    rows: list[int] = []
    try:
        with blaming():
            reader = fmt.read(memoryview(head), name, Limits())
            damage = exhaust(reader, lambda part: rows.append(part.table.num_rows)).damage
    except FormatError:
        return None
    first = 0
    for region in damage.regions:
        first = region.end if region.start == first else first
    return first if any(rows) else None


def _of_cutting(name: str) -> Cause | None:
    found = _PIECE.fullmatch(name)
    if found is None:
        return None
    whole = found["whole"]
    return Cause(
        f"a piece of {whole}, which was cut into several", f"put them together: cat {whole}.* > {whole}"
    )


# ---------------------------------------------------------------------------------- something else


def _of_chance(head: bytes) -> Cause | None:
    """Bytes that are as even as chance makes them: chi squared within six deviations of its mean."""
    counts = np.bincount(np.frombuffer(head, np.uint8), minlength=256)
    expected = len(head) / 256
    if expected < 8:
        return None
    chi = float(((counts - expected) ** 2).sum()) / expected
    if abs(chi - 255) > 6 * (2 * 255) ** 0.5:
        return None
    return Cause(
        f"its bytes are as even as random ones ({_hex(head)} ...): encrypted, or packed in an unknown way",
        "decrypt or unpack it with the program that wrote it",
    )


def _of_bytes(head: bytes, meant: list[Format], formats: Iterable[Format]) -> Cause:
    """What is left: binary data."""
    if meant:
        return Cause(
            f"its first bytes are {_hex(head)}: no {meant[0].title} begins so",
            "its beginning is missing or overwritten, or it is no log: copy it from the vehicle again",
        )
    return Cause(
        f"binary data that no reader knows: it begins with {_hex(head)}",
        "formats read: " + ", ".join(fmt.title for fmt in formats),
    )


def _hex(head: bytes) -> str:
    return head[:_FIRST].hex(" ").upper()
