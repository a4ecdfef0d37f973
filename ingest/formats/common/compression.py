"""Compressed logs and messages, expanded within bounds: see `Limits`.

A compressed log is expanded into a temporary file without a name, so that it takes disk, not memory. What
stands before damage is kept, to the byte where the compression allows it.
"""

from __future__ import annotations

import mmap
import tempfile
import zlib
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Protocol

from flysid.errors import FormatError
from flysid.ingest.formats.base import Limits, release

GZIP_MAGIC = b"\x1f\x8b\x08"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
FREE_BYTES = 256 << 20  # below this, the ratio is not held against a file
_WINDOW = 1 << 27
_RELEASE_BYTES = 1 << 20
_RAW_DEFLATE = -15
_GZIP = 31


class ChunkError(ValueError):
    """A compressed part of a log that cannot be used; the message says why."""


class Decoder(Protocol):
    """What zlib and zstandard offer for one compressed frame."""

    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...
    def decompress(self, data: memoryview, /) -> bytes: ...


class Packer(Protocol):
    """What zlib and zstandard offer for writing."""

    def compress(self, data: bytes, /) -> bytes: ...
    def flush(self) -> bytes: ...


@dataclass(frozen=True)
class Expanded:
    """A log taken out of its packing, and what was lost on the way ("" for nothing)."""

    view: memoryview
    lost: str


# ------------------------------------------------------------------------------------------------- pieces


def unpacked_pieces(view: memoryview) -> Iterator[bytes]:
    """What a gzip or zstd file expands to, piece by piece: all its frames, one behind the other.

    Raises ChunkError where they end early or are damaged; what stands before has been given.
    """
    at = 0
    is_gzip = view[: len(GZIP_MAGIC)] == GZIP_MAGIC
    name = "gzip" if is_gzip else "zstd"
    while at < len(view):
        if at and _is_padding(view, at):
            return
        if at and not _begins_frame(view, at, is_gzip):
            raise ChunkError(f"{len(view) - at} bytes behind the {name} data at byte {at} are something else")
        at = yield from (_inflated(view, at, _GZIP) if is_gzip else _unzstd(view, at))


def inflated_pieces(view: memoryview) -> Iterator[bytes]:
    """What deflate data without a header (a member of a zip archive) expand to; raises ChunkError."""
    yield from _inflated(view, 0, _RAW_DEFLATE)


def _is_padding(view: memoryview, at: int) -> bool:
    """Whether nothing but zeros follows, as behind what came from a tape or was downloaded in blocks."""
    places = range(at, len(view), _RELEASE_BYTES)
    return not any(bytes(view[k : k + _RELEASE_BYTES]).strip(b"\0") for k in places)


def _begins_frame(view: memoryview, at: int, is_gzip: bool) -> bool:
    if is_gzip:
        return view[at : at + len(GZIP_MAGIC)] == GZIP_MAGIC
    skippable = bytes(view[at + 1 : at + 4]) == b"\x2a\x4d\x18" and view[at] >> 4 == 5
    return skippable or view[at : at + 4] == ZSTD_MAGIC


def _inflated(view: memoryview, at: int, wbits: int, *, step: int = 16384) -> Generator[bytes, None, int]:
    """`step`: deflate expands up to 1,032 times: what one step gives stays below 17 MB."""
    return (yield from _frame(lambda: zlib.decompressobj(wbits), zlib.error, view, at, step))


def _unzstd(view: memoryview, at: int, *, step: int = 512) -> Generator[bytes, None, int]:
    """`step`: zstd expands up to 30,000 times: what one step gives stays below 16 MB."""
    import zstandard

    def decoder() -> Decoder:
        made: Decoder = zstandard.ZstdDecompressor(max_window_size=_WINDOW).decompressobj()
        return made

    return (yield from _frame(decoder, zstandard.ZstdError, view, at, step))


def _frame(
    make: Callable[[], Decoder], error_type: type[Exception], view: memoryview, start: int, step: int
) -> Generator[bytes, None, int]:
    """The expanded bytes of the frame at `start`; returns where it ends. Raises ChunkError."""
    decoder = make()
    released = start
    for at in range(start, len(view), step):
        try:
            yield decoder.decompress(view[at : at + step])
        except error_type as error:
            yield from _up_to_damage(make(), error_type, view, start, at, step)
            raise ChunkError(f"the packed data are damaged before byte {at + step}: {error}") from error
        if decoder.eof:
            return min(at + step, len(view)) - len(decoder.unused_data)
        if at - released >= _RELEASE_BYTES:
            release(view, released, at)
            released = at
    raise ChunkError(f"the packed data end early, at byte {len(view)}")


def _up_to_damage(
    decoder: Decoder, error_type: type[Exception], view: memoryview, start: int, damaged: int, step: int
) -> Iterator[bytes]:
    """What the damaged step still gives: the frame once more, and that step byte by byte."""
    for at in range(start, damaged, step):
        decoder.decompress(view[at : at + step])
    with suppress(error_type):
        for at in range(damaged, min(damaged + step, len(view))):
            yield decoder.decompress(view[at : at + 1])


def packer_for(suffix: str) -> Packer:
    """What packs a file of this suffix: .gz, .zst or .zstd."""
    if suffix == ".gz":
        return zlib.compressobj(wbits=_GZIP)
    import zstandard

    packer: Packer = zstandard.ZstdCompressor().compressobj()
    return packer


def first_bytes(pieces: Iterator[bytes], count: int) -> bytes:
    """At most `count` bytes of the beginning, as many as can be had."""
    out = bytearray()
    with suppress(ChunkError):
        for piece in pieces:
            out += piece
            if len(out) >= count:
                break
    return bytes(out[:count])


# --------------------------------------------------------------------------------------------- whole logs


@contextmanager
def expanded(pieces: Iterator[bytes], packed_bytes: int, limits: Limits) -> Iterator[Expanded]:
    """The pieces as one mapped file; as much of it as there is where the end or the middle is damaged."""
    most = max(FREE_BYTES, int(limits.max_ratio * packed_bytes))
    with tempfile.TemporaryFile() as file:
        written = 0
        lost = ""
        try:
            for piece in pieces:
                written += file.write(piece)
                if written > most:
                    lost = f"it expands to more than {limits.max_ratio:g} times its size"
                    break
            file.flush()
        except ChunkError as error:
            lost = str(error)
            file.flush()
        except OSError as error:
            raise FormatError(
                f"no room to expand it in {tempfile.gettempdir()}: {error.strerror}",
                hint="set TMPDIR to a folder with more room",
            ) from error
        if not written:
            yield Expanded(memoryview(b""), lost)
            return
        mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        view = memoryview(mapped)
        try:
            yield Expanded(view, lost)
        finally:
            with suppress(BufferError):  # a traceback may keep pieces; the map closes with the last of them
                view.release()
                mapped.close()


# ------------------------------------------------------------------------------------------- one message


def unpack_message(payload: bytes, limits: Limits, *, free_bytes: int = 1 << 20) -> bytes:
    """A message that was compressed for itself. Raises ChunkError."""
    import zstandard

    most = min(limits.max_chunk_bytes, int(limits.max_ratio * len(payload)) + free_bytes)
    try:
        stated = zstandard.get_frame_parameters(payload).content_size
        if stated not in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR) and stated > most:
            raise ChunkError(f"a message that expands to {stated} bytes is beyond the limits")
        decoder = zstandard.ZstdDecompressor(max_window_size=_WINDOW)
        return bytes(decoder.decompress(payload, max_output_size=most))
    except zstandard.ZstdError as error:
        raise ChunkError(f"zstd data are damaged: {error}") from error
