"""Logs in text, walked by whole lines: what a reader of lines needs beside the lines themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from flysid.ingest.formats.base import release


@dataclass(frozen=True)
class LineBatch:
    """Whole lines, and the bytes behind them that are none.

    Attributes
    ----------
    start, end : of the lines in the file.
    data : lines with their ends; empty where the batch holds no line's end.
    stop : of the batch; the bytes from `end` on are lost.
    fault : why they are; "" where there are none.
    is_cut : the file ends inside a line.
    """

    start: int
    end: int
    data: bytes
    stop: int
    fault: str = ""
    is_cut: bool = False


Ending = Callable[[bytes, bytes], bytes]


def whole_lines(
    view: memoryview, start: int, size: int, longest: int, ending: Ending | None = None
) -> Iterator[LineBatch]:
    """The lines from `start` on, in batches of about `size` bytes; pages of the file are released behind.

    Parameters
    ----------
    longest : bytes of a batch that holds no line's end in `size` bytes.
    ending : of a last line without its end, and the lines before it: the line to read instead; b"" for none.
    """
    while start < len(view):
        stop = min(start + size, len(view))
        end = _last_end(view, start, stop)
        if end == start:
            stop = min(start + longest, len(view))
            end = _last_end(view, start, stop)
        data = bytes(view[start:end])
        if stop == len(view) and end < stop:
            last = ending(bytes(view[end:stop]), data) if ending is not None else b""
            if last:
                yield LineBatch(start, stop, data + last, stop)
            else:
                yield LineBatch(start, end, data, stop, "the last line has no end", is_cut=True)
        elif not data:
            yield LineBatch(start, start, data, stop, "a line without an end")
        else:
            stop = end
            yield LineBatch(start, stop, data, stop)
        release(view, start, stop)
        start = stop


def _last_end(view: memoryview, start: int, stop: int, *, piece_bytes: int = 1 << 12) -> int:
    """Where the last whole line in [start, stop) ends; `start` where none does."""
    while stop > start:
        first = max(start, stop - piece_bytes)
        found = bytes(view[first:stop]).rfind(b"\n")
        if found >= 0:
            return first + found + 1
        stop = first
    return start
