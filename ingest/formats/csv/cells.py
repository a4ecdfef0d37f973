"""The cells of a table's lines, line by line and cell by cell: for batches in which something is wrong.

A line may have too many cells, a cell may be no number; everything else is kept. The cells of a batch are one
Arrow array over the batch's own bytes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from flysid.ingest.formats.common.clock import IntArray
from flysid.ingest.formats.common.columns import as_array, numbers
from flysid.ingest.formats.common.table_kinds import Column
from flysid.ingest.formats.common.table_numbers import floats
from flysid.ingest.formats.csv.layouts import BLANKS, Layout

BoolArray = npt.NDArray[np.bool_]
LINE_END = 10
QUOTE = 34
_WHITE = np.frombuffer(b" \t\r\n", dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines of a batch: [start, end) of each; which have as many cells as the table, and which are blank.

    `first` is the place of each line's first cell in `cells`.
    """

    start: IntArray
    end: IntArray
    is_whole: BoolArray
    is_blank: BoolArray
    first: IntArray
    cells: pa.Array


@dataclass(frozen=True, eq=False)
class CellValues:
    """Values of a column (null where missing), and which cells are neither numbers nor missing.

    `wrong` is empty where there are none; `example` is the first one.
    """

    values: pa.Array
    wrong: IntArray
    example: str = ""


def split_lines(data: bytes, layout: Layout) -> Lines:
    """The lines and cells of a batch that ends with a line's end."""
    buffer = as_array(data)
    borders, ends = _borders(buffer, layout.separator[0])
    starts = np.concatenate([[0], ends[:-1] + 1])
    first = np.searchsorted(borders, starts)
    count = np.searchsorted(borders, ends) - first + 1
    is_whole = (count == len(layout.columns)) & _is_text(data, starts, ends)
    return Lines(starts, ends + 1, is_whole, _is_blank(buffer, ends), first, _as_strings(buffer, borders))


def column_of(text: pa.Array, column: Column) -> CellValues:
    """The cells of a column as its values."""
    if column.is_text:
        return CellValues(text, np.empty(0, dtype=np.int64))
    values, wrong = floats(text, column.style)
    at = np.flatnonzero(wrong)
    return CellValues(values, at, str(text[int(at[0])].as_py()) if len(at) else "")


def _borders(buffer: npt.NDArray[np.uint8], separator: int) -> tuple[IntArray, IntArray]:
    """Places of the bytes that end a cell, and of those among them that end a line."""
    is_end = buffer == LINE_END
    ends = np.flatnonzero(is_end)
    splits = buffer == separator if separator != BLANKS[0] else _between_words(buffer, ends)
    if (buffer == QUOTE).any():
        quotes = np.cumsum(buffer == QUOTE)
        before = np.concatenate([[0], quotes[ends[:-1]]])  # quotes before each line
        inside = (quotes - np.repeat(before, np.diff(ends, prepend=-1))) % 2 == 1
        splits &= ~inside
    return np.flatnonzero(splits | is_end), ends


def _between_words(buffer: npt.NDArray[np.uint8], ends: IntArray) -> BoolArray:
    """The last blank of every run between two words of one line."""
    is_ink = ~np.isin(buffer, _WHITE)
    ink = np.cumsum(is_ink)
    before = np.repeat(
        np.concatenate([[0], ink[ends[:-1]]]), np.diff(ends, prepend=-1)
    )  # ink above each line
    found = ~is_ink & np.append(is_ink[1:], False) & (ink > before) & (buffer != LINE_END)
    return np.asarray(found, dtype=bool)


def _is_text(data: bytes, starts: IntArray, ends: IntArray) -> BoolArray:
    """Lines that are UTF-8."""
    good = np.ones(len(starts), dtype=bool)
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        for i, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
            try:
                data[start:end].decode("utf-8")
            except UnicodeDecodeError:
                good[i] = False
    return good


def _as_strings(buffer: npt.NDArray[np.uint8], borders: IntArray) -> pa.Array:
    """Every cell of a batch with the byte that ends it, as one array over the batch's own bytes."""
    offsets = np.concatenate([[0], borders + 1]).astype(np.int32)
    return pa.Array.from_buffers(
        pa.binary(), len(borders), [None, pa.py_buffer(offsets), pa.py_buffer(buffer)]
    )


def _is_blank(buffer: npt.NDArray[np.uint8], ends: IntArray) -> BoolArray:
    """Lines of white space only."""
    ink = np.cumsum(~np.isin(buffer, _WHITE))[ends]
    return np.equal(np.diff(ink, prepend=0), 0)


def cells_in(lines: Lines, rows: IntArray, layout: Layout, index: int) -> pa.Array:
    """One cell of some lines as strings, without what encloses them."""
    around = ' "\t\r\n' + layout.separator.decode()
    cells = lines.cells.take(numbers(lines.first[rows] + index))
    return pc.utf8_trim(cells.cast(pa.string()), characters=around)
