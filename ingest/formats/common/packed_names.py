"""Names of logs, and the packing that a name asks for."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import PurePosixPath

from flysid.ingest.formats.common.compression import packer_for

PACKED_SUFFIXES = (".gz", ".zst", ".zstd", ".xz", ".bz2")


def own_name(name: str) -> str:
    """A log's name without the suffix of its packing."""
    suffix = PurePosixPath(name).suffix
    return name[: -len(suffix)] if suffix.lower() in PACKED_SUFFIXES and len(name) > len(suffix) else name


def packed_as(name: str, pieces: Iterator[bytes]) -> Iterator[bytes]:
    """The pieces of a file, packed as its name says, or as they are."""
    suffix = PurePosixPath(name).suffix.lower()
    if suffix not in PACKED_SUFFIXES:
        yield from pieces
        return
    packer = packer_for(suffix)
    for piece in pieces:
        yield packer.compress(piece)
    yield packer.flush()


def readable(name: str) -> str:
    """A file's name as text that can be stored: bytes of another encoding are replaced."""
    return os.fsencode(name).decode("utf-8", "replace")
