"""Logs in text, walked by whole lines: what a reader of lines needs beside the lines themselves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from flysid.ingest.formats.base import release


@dataclass(frozen=True)
class LineBatch:
    """Whole lines, and the bytes behind them that are none.

    Attributes
    ----------
    start : of `data` in the file.
    data : lines with their ends; empty where the batch holds no line's end.
    stop : of the batch; the bytes from the end of `data` on are lost.
    fault : why they are; "" where there are none.
    is_cut : the file ends inside a line.
    """

    start: int
    data: bytes
    stop: int
    fault: str = ""
    is_cut: bool = False

    @property
    def end(self) -> int:
        """Of the last whole line in the file."""
        return self.start + len(self.data)


def whole_lines(view: memoryview, start: int, size: int, longest: int) -> Iterator[LineBatch]:
    """The lines from `start` on, in batches of about `size` bytes; pages of the file are released behind.

    Parameters
    ----------
    longest : bytes of a batch that holds no line's end in `size` bytes.
    """
    while start < len(view):
        data = bytes(view[start : start + size])
        if b"\n" not in data:
            data = bytes(view[start : start + longest])
        end = data.rfind(b"\n") + 1
        stop = start + len(data)
        if stop == len(view) and end < len(data):
            yield LineBatch(start, data[:end], stop, "the last line has no end", is_cut=True)
        elif end == 0:
            yield LineBatch(start, b"", stop, "a line without an end")
        else:
            stop = start + end
            yield LineBatch(start, data[:end], stop)
        release(view, start, stop)
        start = stop
