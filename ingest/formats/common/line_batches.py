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
        data = bytes(view[start : start + size])
        if b"\n" not in data:
            data = bytes(view[start : start + longest])
        end = data.rfind(b"\n") + 1
        stop = start + len(data)
        if stop == len(view) and end < len(data):
            last = ending(data[end:], data[:end]) if ending is not None else b""
            if last:
                yield LineBatch(start, stop, data[:end] + last, stop)
            else:
                fault = "the last line has no end"
                yield LineBatch(start, start + end, data[:end], stop, fault, is_cut=True)
        elif end == 0:
            yield LineBatch(start, start, b"", stop, "a line without an end")
        else:
            stop = start + end
            yield LineBatch(start, stop, data[:end], stop)
        release(view, start, stop)
        start = stop
