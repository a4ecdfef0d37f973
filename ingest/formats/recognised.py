"""Files that people have beside their logs and that flysid does not read: what each is, and the way out.

A folder of flights holds notes, pictures, parameters and tracks, too. They are named, not read. Binary data
that nothing here knows may be a log that is damaged, encrypted or of a format that flysid does not read.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from flysid.ingest.formats.common.compression import GZIP_MAGIC, ZSTD_MAGIC
from flysid.ingest.formats.common.transfer import is_text
from flysid.ingest.formats.common.zip_members import ZIP_MAGICS
from flysid.ingest.formats.rosbag2.side_files import JOURNAL_MAGIC, WAL_MAGICS

TEXT = "text"
PACKINGS: Mapping[bytes, tuple[str, str]] = {  # what is not unpacked here, and what unpacks it
    b"7z\xbc\xaf": ("7z", "7z x"),
    b"Rar!": ("rar", "unrar x"),
    b"\x04\x22\x4d\x18": ("lz4", "unlz4"),
    b"]\0\0\x80\0": ("lzma", "unlzma"),
    b"LZIP": ("lzip", "lzip -d"),
    b"\x1f\x9d": ("compress", "uncompress"),
    b"\x89LZO\0": ("lzop", "lzop -d"),
}
INNER_PACKINGS: Mapping[bytes, str] = {
    **{magic: name for magic, (name, _) in PACKINGS.items()},
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    **dict.fromkeys(ZIP_MAGICS, "an archive inside"),
    GZIP_MAGIC: "gzip inside",
    ZSTD_MAGIC: "zstd inside",
}
TAR_MAGIC = b"ustar"
TAR_MAGIC_AT = 257
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
    kind : in a word, where such a file holds no log for certain; "" where it may.
    """

    title: str
    hint: str
    fits: Callable[[bytes], bool]
    kind: str = ""


def _begins(*magics: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(magics)


def _text(pattern: bytes) -> Callable[[bytes], bool]:
    """Fits where the text of a file begins with this, after a mark of its encoding and white space."""
    expression = re.compile(rb"(\xef\xbb\xbf)?\s*(?:" + pattern + rb")", re.IGNORECASE)
    return lambda head: expression.match(head) is not None


def _is_utf_16(head: bytes) -> bool:
    """Whether text in UTF-16 begins here: by its mark, or because every other byte is 0."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return True
    first = head[: 2 * (min(len(head), 256) // 2)]
    return any(
        len(first) >= 32 and not first[zeros::2].strip(b"\0") and 0 not in first[1 - zeros :: 2]
        for zeros in (0, 1)
    )


def _is_iso_media(head: bytes) -> bool:
    size = int.from_bytes(head[:4], "big")
    return head[4:8] in ISO_MEDIA and (size in (0, 1) or size >= 8)


def _is_mpeg(head: bytes) -> bool:
    marks = head[: 5 * MPEG_PACKET : MPEG_PACKET]
    return len(marks) == 5 and marks == b"G" * 5


def _is_matlab_4(head: bytes) -> bool:
    """A matrix of MATLAB 4: kind, rows, columns, whether it is complex, and its name with its length."""
    if len(head) < 24:
        return False
    kind, rows, columns, is_complex, size = struct.unpack_from("<5I", head)
    name = head[20 : 20 + size]
    is_kind = kind % 10 <= 2 and kind // 10 % 10 <= 5 and kind < 100
    is_named = 2 <= size <= 64 and name.endswith(b"\0") and name[:-1].isalnum()
    return is_kind and rows > 0 and columns > 0 and is_complex < 2 and is_named


def _is_arrow_stream(head: bytes) -> bool:
    """The schema of a stream of Arrow: its length behind a mark, in eights of bytes."""
    size = int.from_bytes(head[4:8], "little")
    return head[:4] == b"\xff\xff\xff\xff" and 0 < size < 1 << 20 and size % 8 == 0


def _is_list_of_parameters(head: bytes) -> bool:
    """Whether every whole line, comments aside, is a name with a value."""
    lines = [line.rstrip(b"\r") for line in head.split(b"\n")[:-1]]
    told = [line for line in lines if line.strip() and not line.startswith(b"#")]
    return len(told) >= _LEAST_PARAMETERS and all(map(_PARAMETER.fullmatch, told))


def _is_pickle(head: bytes) -> bool:
    return (
        len(head) > 3
        and head[0] == 0x80
        and 2 <= head[1] <= 5
        and head[2:3] in (b"\x95", b"}", b"c", b"]", b"(")
    )


def _is_dji_dat(head: bytes) -> bool:
    return head[16:21] == b"BUILD" or b"DJI_LOG_V3" in head[:512]


def is_office(head: bytes) -> bool:
    """Whether these bytes, 128 or more, begin a spreadsheet or document that is a .zip archive inside."""
    return head.startswith(b"PK\3\4") and head[FIRST_NAME_AT:].startswith(OFFICE_PARTS)


FIRST_NAME_AT = 30  # in an archive: of its first member
OFFICE_PARTS = (
    b"[Content_Types].xml",
    b"_rels/.rels",
    b"docProps/",
    b"xl/",
    b"word/",
    b"ppt/",
    b"mimetypeapplication/vnd.oasis.opendocument",
)
_PARAMETER = re.compile(rb"((\d+\t){2})?[A-Z][A-Z0-9_]{2,15}[ ,\t]+-?[0-9.]+(e[+-]?\d+)?(\t\d+)?\s*")
_LEAST_PARAMETERS = 3
_YAML = re.compile(rb"[A-Za-z_]\w*:[^\n]*\n(([ -]|[A-Za-z_]\w*:)[^\n]*\n)*---\n")
_TABLES = (b"ARROW1\0\0", b"FEA1", b"Obj\x01avro", b"Obj\x01\x04\x14avro", b"ORC")
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
    Stranger(
        "the write-ahead log or the journal of a database",
        "put it beside its .db3 file, and read that",
        _begins(*WAL_MAGICS, JOURNAL_MAGIC),
    ),
    Stranger("an encrypted parquet file", "decrypt it first", _begins(b"PARE")),
    Stranger("a video (MP4, MOV)", VIDEO, _is_iso_media, "picture or video"),
    Stranger("a video (AVI)", VIDEO, lambda head: head[:4] == b"RIFF" and head[8:12] == b"AVI ", "video"),
    Stranger("a picture or sound (RIFF)", "give the log", _begins(b"RIFF"), "picture, sound or video"),
    Stranger("a sound recording", "give the log", _begins(b"ID3", b"OggS"), "sound"),
    Stranger("a program", "give the log", _begins(b"\x7fELF", b"MZ"), "program"),
    Stranger("a video (Matroska, WebM)", VIDEO, _begins(b"\x1aE\xdf\xa3"), "video"),
    Stranger("a video (MPEG transport stream)", VIDEO, _is_mpeg, "video"),
    Stranger(
        "a picture",
        "give the log",
        _begins(b"\xff\xd8\xff", b"\x89PNG", b"GIF8", b"II*\0", b"MM\0*"),
        "picture",
    ),
    Stranger("a PDF", "give the log", _begins(b"%PDF"), "document"),
    Stranger("a spreadsheet or document of an office program", SAVE_CSV, is_office, "document"),
    Stranger("an old Excel or Word file", SAVE_CSV, _begins(b"\xd0\xcf\x11\xe0"), "document"),
    Stranger(
        "a MATLAB file (.mat)",
        "in MATLAB: writetable(T, 'log.csv')",
        lambda head: head.startswith((b"MATLAB 5.0", b"MATLAB 7.3")) or _is_matlab_4(head),
        "MATLAB file",
    ),
    Stranger(
        "an HDF5 file",
        "with pandas: pandas.read_hdf(PATH).to_parquet('log.parquet')",
        _begins(b"\x89HDF"),
        "HDF5 file",
    ),
    Stranger(
        "a NumPy array",
        "flysid.Dataset.from_arrays(...) takes arrays; or numpy.savetxt('log.csv', array, delimiter=',')",
        _begins(b"\x93NUMPY"),
        "NumPy file",
    ),
    *(
        Stranger(f"an archive ({name})", f"unpack it first: {way}", _begins(magic))
        for magic, (name, way) in PACKINGS.items()
    ),
    Stranger("text in UTF-16", "save it as UTF-8", _is_utf_16),
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
        _text(rb"(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<(gpx|kml)\b"),
    ),
    Stranger(
        "a web page",
        "the download gave a page instead of the log: log in, and download again",
        _text(rb"(<!--.*?-->\s*)*(<!doctype html|<html|<head|<body)\b"),
    ),
    Stranger(
        "a pointer of Git LFS",
        "the file itself is not here yet: git lfs pull",
        _text(rb"version https://git-lfs\.github\.com/"),
    ),
    Stranger(
        "a pointer of git-annex",
        "the file itself is not here yet: git annex get",
        _text(rb"(\.\./)*(/?\.git)?/annex/objects/\S+\s*$"),
    ),
    Stranger(
        "an error message of a store",
        "it says why the log was not sent; mend that, and download again",
        _text(rb"(<\?xml[^>]*>\s*)?<Error>"),
    ),
    Stranger(
        "a layout of PlotJuggler",
        "it names curves and holds no data: give the log that it was made for",
        _text(rb"(<\?xml[^>]*>\s*)?<root>\s*<tabbed_widget"),
    ),
    Stranger("an XML document", "give the log", _text(rb"<\?xml\b")),
    Stranger(
        "a list of parameters",
        "it holds settings, not a flight: give the log",
        _is_list_of_parameters,
    ),
    Stranger(
        "a tlog that Mission Planner wrote as CSV",
        "its messages have different columns: give the .tlog itself, which flysid reads",
        _text(rb"\d{4}-\d\d-\d\dT[\d:.]+,F[ED],[^\n]*,mavlink_\w+_t,"),
    ),
    Stranger(
        "lines of a serial monitor, with the time of the day before each",
        "make it a column: sed 's/^\\[//; s/ *-> */,/; s/\\] */,/' IN > log.csv",
        _text(rb"(\d\d:\d\d:\d\d[.,]\d+ ->|\[\d\d:\d\d:\d\d[.,]\d+\])"),
    ),
    Stranger(
        "messages that `ros2 topic echo` or `rostopic echo` printed",
        "give the bag; or print a row each: ros2 topic echo --csv TOPIC, rostopic echo -p TOPIC",
        lambda head: b"\n---\n" in head and _YAML.match(head) is not None,
    ),
    Stranger(
        "points in the line protocol of InfluxDB",
        "export a table: influx query --raw, pivoted by the time, > log.csv",
        _text(rb"\w+(,[\w-]+=[^ ,\n]+)* [\w.]+=[^ \n]+ \d{19}\r?\n"),
    ),
    Stranger(
        "the settings of a flight controller (CLI diff or dump)",
        "it holds settings, not a flight: give the .bbl file",
        _text(rb"(#[^\n]*\n|\s)*# (diff|dump|version|status|Betaflight /|INAV/|EmuFlight /|Rotorflight /)"),
    ),
    Stranger(
        "a plan of QGroundControl",
        "it is a plan, not a flight: give the log",
        _text(rb'\{[^\0]{0,4096}"fileType"\s*:\s*"Plan"'),
    ),
    Stranger(
        "firmware of a flight controller",
        "give the log",
        _text(rb'\{[^\0]{0,4096}"board_id"|:[0-9A-F]{6}0[0-5][0-9A-F]+\r?\n:'),
    ),
    Stranger("firmware of a flight controller", "give the log", _begins(b"DfuSe", b"UF2\n"), "firmware"),
    Stranger("an e-mail", "save its attachment", _text(rb"(from|received|return-path|mime-version): ")),
    Stranger("a document in RTF", SAVE_CSV, _text(rb"\{\\rtf")),
    Stranger(
        "statements of SQL",
        "export the table as CSV, names in the first line",
        _text(rb"(--[^\n]*\n|\s)*(create table|insert into|begin transaction|pragma )"),
    ),
    Stranger("a link to a web page", "open it, and download the log", _text(rb"\[InternetShortcut\]")),
    Stranger("a key or certificate", "give the log", _text(rb"-----BEGIN ")),
    Stranger(
        "a copy of a symbolic link", "copy the file that it points to", _begins(b"XSym\n", b"!<symlink>")
    ),
    Stranger("a property list of macOS", "give the log", _begins(b"bplist00"), "document"),
    Stranger(
        "a note of macOS about another file",
        "give the file of the same name without ._ in front",
        _begins(b"\0\5\x16\7"),
        "note of macOS",
    ),
    Stranger("a note of macOS about a folder", "give the log", _begins(b"\0\0\0\1Bud1"), "note of macOS"),
    Stranger(
        "a shortcut of Windows",
        "give the file that it points to",
        _begins(b"L\0\0\0\1\x14\2\0"),
        "shortcut",
    ),
    Stranger(
        "observations of a GPS receiver (RINEX)",
        "the autopilot's own log holds the positions, too",
        _text(rb"[^\n]{40,60}(RINEX VERSION|COMPACT RINEX)"),
    ),
    Stranger(
        "a track of a flight recorder (IGC)",
        "the autopilot's own log holds more",
        _text(rb"A[A-Z0-9]{3}[^\n]*\n(H[^\n]*\n)*H[FOP]DTE"),
    ),
    Stranger("a track of a sports watch (FIT)", "give the log", lambda head: head[8:12] == b".FIT", "track"),
    Stranger("a dump of memory after a crash of ArduPilot", "give the log", _text(rb"ArduPilot crash_dump")),
    Stranger("a Python pickle", "with pandas: DataFrame.to_parquet('log.parquet')", _is_pickle),
    Stranger(
        "a table in Feather, Avro or ORC",
        "with pandas: DataFrame.to_parquet('log.parquet')",
        lambda head: _is_arrow_stream(head) or head.startswith(_TABLES),
    ),
    Stranger(
        "a ROS bag of a version before 2.0",
        "rosbag fix old.bag new.bag, of ROS 1, turns it into one",
        _begins(b"#ROSBAG V0", b"#ROSBAG V1", b"#ROSRECORD"),
    ),
    Stranger(
        "an MCAP file that was copied as text, which changed its line ends",
        "copy it in binary mode",
        _begins(b"\x89MCAP0\n", b"\x89MCAP0\r\r\n"),
    ),
    Stranger("a plan of waypoints", "it is a plan, not a flight: give the log", _text(rb"QGC WPL \d+")),
    Stranger(
        "the metadata of a ROS 2 bag",
        "give the .db3 or .mcap file beside it",
        _text(rb"rosbag2_bagfile_information:"),
    ),
)


def stranger(head: bytes) -> Stranger | None:
    """What a file with these first bytes is, where it is known and not read; None otherwise."""
    return next((kind for kind in STRANGERS if kind.fits(head)), None)


def kind_of(head: bytes) -> str:
    """What a file that begins so is, in a word, where it is no log; "" where nothing here knows."""
    known = stranger(head)
    if not head:
        return "empty file"
    if known is not None and known.kind:
        return known.kind
    return TEXT if is_text(head) else ""


def packing_of(head: bytes) -> str:
    """The name of a packing that is not unpacked here, or not so deep; "" for none."""
    if head[TAR_MAGIC_AT:].startswith(TAR_MAGIC):
        return "tar"
    return next((name for magic, name in INNER_PACKINGS.items() if head.startswith(magic)), "")
