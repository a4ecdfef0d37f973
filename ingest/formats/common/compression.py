"""Files and messages compressed with zstd, expanded within bounds: see `Limits`.

A compressed log is expanded into a temporary file without a name, so that it takes disk, not memory.
"""

from __future__ import annotations

import mmap
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from flysid.ingest.formats.base import Limits, release
from flysid.ingest.formats.common.tally import Tally

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
FREE_BYTES = 256 << 20  # below this, the ratio is not held against a file
FREE_MESSAGE_BYTES = 1 << 20
_WINDOW = 1 << 27
_PIECE = 1 << 20
_STEP = 512  # zstd expands up to 30,000 times: what one step gives stays below 16 MB


class ChunkError(ValueError):
    """A compressed part of a log that cannot be used; the message says why."""


@contextmanager
def unpacked(view: memoryview, limits: Limits, tally: Tally) -> Iterator[memoryview]:
    """The expanded file, mapped; as much of it as there is where the end or the middle is damaged."""
    with tempfile.TemporaryFile() as file:
        most = max(FREE_BYTES, int(limits.max_ratio * len(view)))
        written, fault = 0, ""
        try:
            for piece in pieces(view):
                file.write(piece)
                written += len(piece)
                if written > most:
                    fault = f"it expands to more than {limits.max_ratio:g} times its size"
                    break
        except ChunkError as error:
            fault = str(error)
        tally.truncated |= bool(fault)
        if not written:
            yield memoryview(b"")
            return
        file.flush()
        mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        data = memoryview(mapped)
        try:
            yield data
        finally:
            with suppress(BufferError):  # a traceback may keep pieces; the map closes with the last of them
                data.release()
                mapped.close()


def pieces(view: memoryview) -> Iterator[bytes]:
    """The expanded bytes, piece by piece. Raises ChunkError where they end early or are damaged."""
    import zstandard

    decoder = zstandard.ZstdDecompressor(max_window_size=_WINDOW).decompressobj()
    try:
        for at in range(0, len(view), _PIECE):
            for step in range(at, min(at + _PIECE, len(view)), _STEP):
                yield decoder.decompress(view[step : min(step + _STEP, len(view))])
                if decoder.eof:
                    return
            release(view, at, min(at + _PIECE, len(view)))
    except zstandard.ZstdError as error:
        raise ChunkError(f"zstd data are damaged: {error}") from error
    raise ChunkError("the file ends inside its zstd frame")


def first_bytes(head: bytes, count: int = 1 << 16) -> bytes:
    """What the beginning of a zstd file expands to, as far as it can be had; at most `count` bytes."""
    import zstandard

    out = b""
    with suppress(zstandard.ZstdError):
        reader = zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(head)
        while len(out) < count and (piece := reader.read(count - len(out))):
            out += piece
    return out


def unpack_message(payload: bytes, limits: Limits) -> bytes:
    """A message that was compressed for itself. Raises ChunkError."""
    import zstandard

    most = min(limits.max_chunk_bytes, int(limits.max_ratio * len(payload)) + FREE_MESSAGE_BYTES)
    try:
        stated = zstandard.get_frame_parameters(payload).content_size
        if stated not in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR) and stated > most:
            raise ChunkError(f"a message that expands to {stated} bytes is beyond the limits")
        decoder = zstandard.ZstdDecompressor(max_window_size=_WINDOW)
        return bytes(decoder.decompress(payload, max_output_size=most))
    except zstandard.ZstdError as error:
        raise ChunkError(f"zstd data are damaged: {error}") from error
