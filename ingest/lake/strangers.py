"""Files that lie among logs: what they are by their first bytes.

A folder of flights holds notes, pictures, parameters and tracks, too. They are named, not read. Binary data
that nothing here knows may be a log that is damaged, encrypted or of a format that flysid does not read.
"""

from __future__ import annotations

from collections.abc import Mapping

from flysid.ingest.formats.common.compression import GZIP_MAGIC, ZSTD_MAGIC
from flysid.ingest.formats.common.zip_members import ZIP_MAGICS
from flysid.ingest.formats.opening import TAR_MAGIC, TAR_MAGIC_AT

TEXT = "text"
TRUTH_SUFFIX = ".truth.parquet"  # what `flysid synth` lays beside a log: a table, and no log
MAGICS: Mapping[bytes, str] = {
    b"\x89PNG": "picture",
    b"\xff\xd8\xff": "picture",
    b"GIF8": "picture",
    b"II*\0": "picture",
    b"MM\0*": "picture",
    b"RIFF": "picture, sound or video",
    b"\x1a\x45\xdf\xa3": "video",
    b"ID3": "sound",
    b"OggS": "sound",
    b"%PDF": "document",
    b"\xd0\xcf\x11\xe0": "document",
    b"\x7fELF": "program",
    b"MZ": "program",
    b"MATLAB 5.0": "MATLAB file",
    b"\x89HDF": "HDF5 file",
    b"\x93NUMPY": "NumPy file",
}
PACKED: Mapping[bytes, str] = {
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"7z\xbc\xaf": "7z",
    b"Rar!": "rar",
    b"\x04\x22\x4d\x18": "lz4",
    **dict.fromkeys(ZIP_MAGICS, "an archive inside"),
    GZIP_MAGIC: "gzip inside",
    ZSTD_MAGIC: "zstd inside",
}
_MEDIA_MARK, _MEDIA_MARK_AT = b"ftyp", 4
_TEXT_MARKS = (b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf")
_NOT_IN_TEXT = bytes(set(range(32)) - set(b"\a\b\t\n\v\f\r\x1b"))


def kind_of(head: bytes) -> str:
    """What a file is that begins so, in a word; "" where nothing here knows."""
    if not head:
        return "empty file"
    for magic, kind in MAGICS.items():
        if head.startswith(magic):
            return kind
    if head[_MEDIA_MARK_AT:].startswith(_MEDIA_MARK):
        return "picture or video"
    return TEXT if is_text(head) else ""


def is_text(head: bytes) -> bool:
    """Whether these bytes are text: no control characters but those of texts, or a mark of Unicode."""
    return head.startswith(_TEXT_MARKS) or head.translate(None, _NOT_IN_TEXT) == head


def packing_of(head: bytes) -> str:
    """The name of a packing that is not unpacked here, or not so deep; "" for none."""
    if head[TAR_MAGIC_AT:].startswith(TAR_MAGIC):
        return "tar"
    return next((name for magic, name in PACKED.items() if head.startswith(magic)), "")
