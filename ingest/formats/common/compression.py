"""Compressed logs and messages, expanded within bounds: see `Limits`.

A compressed log is expanded into a temporary file without a name, so that it takes disk, not memory. What
stands before damage is kept, to the byte where the compression allows it.
"""

from __future__ import annotations

import bz2
import lzma
import mmap
import re
import tempfile
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Protocol

from flysid.errors import FormatError
from flysid.ingest.formats.base import Limits, release

GZIP_MAGIC = b"\x1f\x8b\x08"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_BEGINNINGS = {
    "gzip": re.compile(re.escape(GZIP_MAGIC)),
    "zstd": re.compile(rb"\x28\xb5\x2f\xfd|[\x50-\x5f]\x2a\x4d\x18"),  # or what readers shall skip
    "xz": re.compile(rb"\xfd7zXZ\0"),
    "bzip2": re.compile(rb"BZh[1-9]1AY&SY"),
}
_BEGINNING_BYTES = 10
FREE_BYTES = 256 << 20  # of zeros and the like: so much of them is expanded whatever the ratio
_WINDOW = 1 << 27
_RELEASE_BYTES = 1 << 20
_RAW_DEFLATE = -15
_GZIP = 31
_ZSTD_HEAD_BYTES = 18  # at most


class CompressionError(ValueError):
    """A compressed part of a log that cannot be used; the message says why."""


class Decompressor(Protocol):
    """What zlib, zstandard, lzma and bz2 offer for one compressed frame."""

    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...
    def decompress(self, data: memoryview, /) -> bytes: ...


class Packer(Protocol):
    """What zlib, zstandard, lzma and bz2 offer for writing."""

    def compress(self, data: bytes, /) -> bytes: ...
    def flush(self) -> bytes: ...


@dataclass(frozen=True)
class Expanded:
    """A log taken out of its packing, and what was lost on the way ("" for nothing)."""

    view: memoryview
    lost: str


# ------------------------------------------------------------------------------------------------- pieces


@dataclass
class _Growth:
    """Bytes that came out beyond `max_ratio` times what went in, since that was last kept."""

    max_ratio: float
    excess: float = 0.0

    def check(self, given: int, taken: int, at: int) -> None:
        """Raises CompressionError where the bytes up to `at`, `taken` of them new, gave too much."""
        self.excess = max(0.0, self.excess + given - self.max_ratio * taken)
        if self.excess > FREE_BYTES:
            raise CompressionError(
                f"ahead of byte {at} of the packed data they expand to more than {self.max_ratio:g} times "
                "their size: the rest is left out"
            )


def kind_of_packing(view: memoryview, at: int = 0) -> str:
    """What a frame that begins here is packed with: gzip, zstd, xz or bzip2; "" for none."""
    first = bytes(view[at : at + _BEGINNING_BYTES])
    return next((name for name, begins in _BEGINNINGS.items() if begins.match(first)), "")


def unpacked_pieces(view: memoryview, max_ratio: float) -> Iterator[bytes]:
    """What a packed file expands to, piece by piece: all its frames, one behind the other.

    Raises CompressionError where they end early, are damaged, or expand far beyond `max_ratio` times their
    size; what stands before has been given.
    """
    at = 0
    name = kind_of_packing(view) or "zstd"
    growth = _Growth(max_ratio)
    while at < len(view):
        if at and _is_padding(view, at):
            return
        if at and kind_of_packing(view, at) != name:
            raise CompressionError(
                f"{len(view) - at} bytes behind the {name} data at byte {at} are something else"
            )
        at = yield from _UNPACKERS[name](view, at, growth)


def inflated_pieces(view: memoryview, max_ratio: float) -> Iterator[bytes]:
    """What deflate data without a header (a member of a zip archive) expand to; raises CompressionError."""
    yield from _inflate(view, 0, _RAW_DEFLATE, _Growth(max_ratio))


def _is_padding(view: memoryview, at: int) -> bool:
    """Whether nothing but zeros follows, as behind what came from a tape or was downloaded in blocks."""
    places = range(at, len(view), _RELEASE_BYTES)
    return not any(bytes(view[k : k + _RELEASE_BYTES]).strip(b"\0") for k in places)


def _inflate(
    view: memoryview, at: int, wbits: int, growth: _Growth, *, step: int = 16384
) -> Generator[bytes, None, int]:
    """`step`: deflate expands up to 1,032 times: what one step gives stays below 17 MB."""
    made = _Unpacking(lambda: zlib.decompressobj(wbits), zlib.error, view, at, step)
    end, _ = yield from _frame(made, growth)
    return end


def _unzstd(view: memoryview, at: int, growth: _Growth, *, step: int = 512) -> Generator[bytes, None, int]:
    """`step`: zstd expands up to 30,000 times: what one step gives stays below 16 MB.

    What the frame states of its size is held against it only when all of it is there.
    """
    import zstandard

    head = _ZstdHead.read(bytes(view[at : at + _ZSTD_HEAD_BYTES]))

    def decoder() -> Decompressor:
        found: Decompressor = zstandard.ZstdDecompressor(max_window_size=_WINDOW).decompressobj()
        try:
            found.decompress(memoryview(head.without_size))
        except zstandard.ZstdError as error:
            raise CompressionError(f"the zstd frame at byte {at} cannot be unpacked: {error}") from error
        return found

    made = _Unpacking(decoder, zstandard.ZstdError, view, at + head.size, step)
    end, given = yield from _frame(made, growth)
    if head.content is not None and given != head.content:
        raise CompressionError(f"the zstd frame states {head.content} bytes and holds {given}")
    return end


def _gunzip(view: memoryview, at: int, growth: _Growth) -> Generator[bytes, None, int]:
    return (yield from _inflate(view, at, _GZIP, growth))


def _unxz(
    view: memoryview, at: int, growth: _Growth, *, step: int = 512, memory_bytes: int = 256 << 20
) -> Generator[bytes, None, int]:
    """`step`: xz expands up to 7,000 times. `memory_bytes`: presets ask for up to 65 MB, a bomb for 4 GB."""

    def decoder() -> Decompressor:
        return lzma.LZMADecompressor(lzma.FORMAT_XZ, memory_bytes)

    end, _ = yield from _frame(_Unpacking(decoder, lzma.LZMAError, view, at, step), growth)
    return end


def _bunzip(view: memoryview, at: int, growth: _Growth, *, step: int = 512) -> Generator[bytes, None, int]:
    """`step`: bzip2 expands up to 20,000 times."""
    end, _ = yield from _frame(_Unpacking(bz2.BZ2Decompressor, OSError, view, at, step), growth)
    return end


_UNPACKERS: Mapping[str, Callable[[memoryview, int, _Growth], Generator[bytes, None, int]]] = {
    "gzip": _gunzip,
    "zstd": _unzstd,
    "xz": _unxz,
    "bzip2": _bunzip,
}


@dataclass(frozen=True)
class _ZstdHead:
    """The beginning of a zstd frame (RFC 8878, section 3.1.1.1).

    Attributes
    ----------
    size : of the header, in bytes; 0 of what is no whole header, and of skippable frames.
    content : how many bytes the frame states that it expands to; None where it does not.
    without_size : the header as it would be without that.
    """

    size: int = 0
    content: int | None = None
    without_size: bytes = b""

    @classmethod
    def read(cls, head: bytes) -> _ZstdHead:
        """The header that these bytes begin with."""
        if len(head) < _ZSTD_HEAD_BYTES or not head.startswith(ZSTD_MAGIC):
            return cls()
        told = head[4]
        is_single = bool(told & 0x20)  # the content is the window
        content_bytes = (1 if is_single else 0, 2, 4, 8)[told >> 6]
        names_bytes = (0, 1, 2, 4)[told & 3]  # of a dictionary
        window = bytes([(_WINDOW.bit_length() - 11) << 3]) if is_single else head[5:6]
        at = 5 + (not is_single)
        names = head[at : at + names_bytes]
        at += names_bytes
        content = int.from_bytes(head[at : at + content_bytes], "little") + 256 * (content_bytes == 2)
        without = ZSTD_MAGIC + bytes([told & 0x1F]) + window + names
        return cls(at + content_bytes, content if content_bytes else None, without)


@dataclass(frozen=True)
class _Unpacking:
    """One frame of packed data: who decodes it and fails how, and where it begins behind its header."""

    make: Callable[[], Decompressor]
    error_type: type[Exception]
    view: memoryview
    start: int
    step: int


def _frame(made: _Unpacking, growth: _Growth) -> Generator[bytes, None, tuple[int, int]]:
    """The expanded bytes of a frame; returns where it ends, and their number. Raises CompressionError."""
    view = made.view
    step = made.step
    decoder = made.make()
    released = made.start
    given = 0
    for at in range(made.start, len(view), step):
        try:
            piece = decoder.decompress(view[at : at + step])
        except made.error_type as error:
            yield from _up_to_damage(made, at)
            raise CompressionError(f"the packed data are damaged before byte {at + step}: {error}") from error
        given += len(piece)
        yield piece
        end = min(at + step, len(view)) - len(decoder.unused_data)
        growth.check(len(piece), end - at, end)
        if decoder.eof:
            return end, given
        if at - released >= _RELEASE_BYTES:
            release(view, released, at)
            released = at
    raise CompressionError(f"the packed data end early, at byte {len(view)}")


def _up_to_damage(made: _Unpacking, damaged: int) -> Iterator[bytes]:
    """What the damaged step still gives: the frame once more, and that step byte by byte."""
    decoder = made.make()
    for at in range(made.start, damaged, made.step):
        decoder.decompress(made.view[at : at + made.step])
    with suppress(made.error_type):
        for at in range(damaged, min(damaged + made.step, len(made.view))):
            yield decoder.decompress(made.view[at : at + 1])


def packer_for(suffix: str) -> Packer:
    """What packs a file of this suffix: .gz, .zst, .zstd, .xz or .bz2."""
    if suffix == ".gz":
        return zlib.compressobj(wbits=_GZIP)
    if suffix == ".xz":
        return lzma.LZMACompressor()
    if suffix == ".bz2":
        return bz2.BZ2Compressor()
    import zstandard

    packer: Packer = zstandard.ZstdCompressor().compressobj()
    return packer


def first_bytes(pieces: Iterator[bytes], count: int) -> bytes:
    """At most `count` bytes of the beginning, as many as can be had."""
    out = bytearray()
    with suppress(CompressionError):
        for piece in pieces:
            out += piece
            if len(out) >= count:
                break
    return bytes(out[:count])


# --------------------------------------------------------------------------------------------- whole logs


@contextmanager
def expand(pieces: Iterator[bytes]) -> Iterator[Expanded]:
    """The pieces as one mapped file; as much of it as there is where the end or the middle is damaged."""
    with tempfile.TemporaryFile() as file:
        written = 0
        lost = ""
        try:
            for piece in pieces:
                written += file.write(piece)
            file.flush()
        except CompressionError as error:
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
    """A message that was compressed for itself. Raises CompressionError."""
    import zstandard

    most = min(limits.max_chunk_bytes, int(limits.max_ratio * len(payload)) + free_bytes)
    try:
        stated = zstandard.get_frame_parameters(payload).content_size
        if stated not in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR) and stated > most:
            raise CompressionError(f"a message that expands to {stated} bytes is beyond the limits")
        decoder = zstandard.ZstdDecompressor(max_window_size=_WINDOW)
        return bytes(decoder.decompress(payload, max_output_size=most))
    except zstandard.ZstdError as error:
        raise CompressionError(f"zstd data are damaged: {error}") from error
