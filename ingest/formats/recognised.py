"""Files that people have beside their logs and that flysid does not read: what each is, and the way out."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

SAVE_CSV = "save the table as CSV (UTF-8), one line a row, names in the first line"
ISO_MEDIA = frozenset((b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"))
MPEG_PACKET = 188
DJI_WAY = "DatCon or CsvView turn it into a .csv, which flysid reads"


@dataclass(frozen=True)
class Stranger:
    """A kind of file that is recognised only.

    Attributes
    ----------
    title : what a person calls it.
    hint : what to do instead.
    fits : whether a file with these first bytes is one.
    """

    title: str
    hint: str
    fits: Callable[[bytes], bool]


def _begins(*magics: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(magics)


def _text(pattern: bytes) -> Callable[[bytes], bool]:
    """Fits where the text of a file begins with this, after a mark of its encoding and white space."""
    expression = re.compile(rb"(\xef\xbb\xbf)?\s*" + pattern, re.IGNORECASE)
    return lambda head: expression.match(head) is not None


def _is_iso_media(head: bytes) -> bool:
    size = int.from_bytes(head[:4], "big")
    return head[4:8] in ISO_MEDIA and (size in (0, 1) or size >= 8)


def _is_mpeg(head: bytes) -> bool:
    marks = head[: 5 * MPEG_PACKET : MPEG_PACKET]
    return len(marks) == 5 and marks == b"G" * 5


def _is_dji_dat(head: bytes) -> bool:
    return head[16:21] == b"BUILD" or b"DJI_LOG_V3" in head[:512]


def _is_office(head: bytes) -> bool:
    inside = head[:4096]
    return head.startswith(b"PK\3\4") and (b"[Content_Types].xml" in inside or b"opendocument" in inside)


VIDEO = "no log is in a video; the autopilot's own log is on its SD card"
STRANGERS = (
    Stranger(
        "an encrypted ULog",
        "decrypt it first, with the private key: PX4-Autopilot/Tools/log_encryption/decrypt_logs.py",
        _begins(b"ULogEnc"),
    ),
    Stranger(
        "an encrypted DJI flight log (.DAT)",
        "only DJI can read it; its app's own record can be exported as a .csv, which flysid reads",
        _begins(b"LOGH"),
    ),
    Stranger("a DJI flight log (.DAT)", DJI_WAY, _is_dji_dat),
    Stranger("an encrypted parquet file", "decrypt it first", _begins(b"PARE")),
    Stranger("a video (MP4, MOV)", VIDEO, _is_iso_media),
    Stranger("a video (AVI)", VIDEO, lambda head: head[:4] == b"RIFF" and head[8:12] == b"AVI "),
    Stranger("a video (Matroska, WebM)", VIDEO, _begins(b"\x1aE\xdf\xa3")),
    Stranger("a video (MPEG transport stream)", VIDEO, _is_mpeg),
    Stranger(
        "a picture", "give the log", _begins(b"\xff\xd8\xff", b"\x89PNG\r\n", b"GIF8", b"II*\0", b"MM\0*")
    ),
    Stranger("a PDF", "give the log", _begins(b"%PDF-")),
    Stranger("a spreadsheet or document of an office program", SAVE_CSV, _is_office),
    Stranger("an old Excel or Word file", SAVE_CSV, _begins(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")),
    Stranger(
        "a MATLAB file (.mat)",
        "in MATLAB: writetable(T, 'log.csv')",
        _begins(b"MATLAB 5.0 MAT-file", b"MATLAB 7.3"),
    ),
    Stranger(
        "an HDF5 file",
        "with pandas: pandas.read_hdf(PATH).to_parquet('log.parquet')",
        _begins(b"\x89HDF\r\n\x1a\n"),
    ),
    Stranger(
        "a NumPy array",
        "flysid.Dataset.from_arrays(...) takes arrays; or numpy.savetxt('log.csv', array, delimiter=',')",
        _begins(b"\x93NUMPY"),
    ),
    Stranger(
        "an archive",
        "unpack it first",
        _begins(b"7z\xbc\xaf\x27\x1c", b"Rar!\x1a\x07", b"\xfd7zXZ\0", b"BZh"),
    ),
    Stranger("text in UTF-16", "save it as UTF-8", _begins(b"\xff\xfe", b"\xfe\xff")),
    Stranger(
        "sentences of a GPS receiver (NMEA)",
        "the autopilot's own log holds more; or gpsbabel -i nmea -f IN -o unicsv -F log.csv",
        _text(rb"[$!](G[PNLABQ]|P[A-Z]{3}|BD)[A-Z0-9]{1,4},"),
    ),
    Stranger(
        "a u-blox recording (UBX)", "the autopilot's own log holds the positions, too", _begins(b"\xb5\x62")
    ),
    Stranger(
        "a GPS track (GPX, KML)",
        "the autopilot's own log holds more",
        _text(rb"(<\?xml[^>]*>\s*)?<(gpx|kml)\b"),
    ),
    Stranger(
        "a web page",
        "the download gave a page instead of the log: log in, and download again",
        _text(rb"(<!doctype html|<html)\b"),
    ),
    Stranger("a plan of waypoints", "it was not flown yet: give the log", _text(rb"QGC WPL \d+")),
    Stranger(
        "the metadata of a ROS 2 bag",
        "give the .db3 or .mcap file beside it",
        _text(rb"rosbag2_bagfile_information:"),
    ),
)


def stranger(head: bytes) -> Stranger | None:
    """What a file with these first bytes is, where it is known and not read; None otherwise."""
    return next((kind for kind in STRANGERS if kind.fits(head)), None)
