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

from flysid.ingest.formats.common.arrow_arrays import numeric
from flysid.ingest.formats.common.clock import IntArray
from flysid.ingest.formats.common.columns import as_array, numbers
from flysid.ingest.formats.common.table_times import to_ns
from flysid.ingest.formats.csv.layouts import BLANKS, CLOCK, CLOCKED, MISSING, NUMBER, STAMP, ZONE, Layout

BoolArray = npt.NDArray[np.bool_]
LINE_END = 10
QUOTE = 34
WHOLE = r"^\d{1,19}$"  # nanoseconds since 1970 have more digits than a float
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
    """Values of a column (null where missing), and the cells that are neither numbers nor missing."""

    values: pa.Array
    wrong: int = 0
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


def column_of(lines: Lines, rows: IntArray, layout: Layout, index: int) -> CellValues:
    """One column of some lines."""
    text = _text(lines, rows, layout, index)
    if layout.columns[index].is_text:
        return CellValues(text)
    values, wrong = _floats(text, layout.decimal_comma)
    example = text[int(wrong.argmax())].as_py() if wrong.any() else ""
    return CellValues(values, int(wrong.sum()), example)


def stated_times(lines: Lines, rows: IntArray, layout: Layout) -> tuple[IntArray, BoolArray]:
    """(n,) times in ns of some lines, and where a time is stated at all."""
    assert layout.time is not None
    text = _text(lines, rows, layout, layout.time.index)
    if layout.time.unit_ns == 0:
        return stamps(text, layout.time.unit)
    time_ns, known = count_ns(_floats(text, layout.decimal_comma)[0], layout.time.unit_ns)
    if layout.time.nanoseconds >= 0:
        beside = _floats(_text(lines, rows, layout, layout.time.nanoseconds), layout.decimal_comma)[0]
        return with_fraction(time_ns, known, beside)
    if layout.time.unit_ns == 1:
        exact = known & _bools(pc.match_substring_regex(text, WHOLE))
        time_ns[exact] = as_int64(text.filter(numeric(exact)).cast(pa.int64()))
    return time_ns, known


def count_ns(values: pa.Array, unit_ns: int) -> tuple[IntArray, BoolArray]:
    """(n,) numbers of a unit as ns, and which of them are times."""
    return to_ns(np.asarray(values.to_numpy(zero_copy_only=False), dtype=np.float64), unit_ns)


def with_fraction(time_ns: IntArray, known: BoolArray, beside: pa.Array) -> tuple[IntArray, BoolArray]:
    """(n,) whole seconds with the nanoseconds of a column of their own, and which of them are times."""
    fraction, told = count_ns(beside, 1)
    return time_ns + fraction, known & told


def as_int64(values: pa.Array) -> IntArray:
    """Whole numbers as an array."""
    return np.asarray(values.to_numpy(zero_copy_only=False), dtype=np.int64)


def stamps(text: pa.Array, kind: str) -> tuple[IntArray, BoolArray]:
    """Dates and times of day (ISO 8601) as ns since 1970; without a zone they are taken as UTC.

    Times of day alone (CLOCKED) count from midnight.
    """
    if kind == CLOCKED:
        text = _on_first_day(text)
    shaped = pc.match_substring_regex(text, STAMP)
    zoned = pc.match_substring_regex(text, ZONE + "$")
    found = np.zeros(len(text), dtype=np.int64)
    known = np.zeros(len(text), dtype=bool)
    for mine, type_ in ((pc.invert(zoned), pa.timestamp("ns")), (zoned, pa.timestamp("ns", "UTC"))):
        stamps = _cast_stamps(pc.if_else(pc.and_(shaped, mine), text, pa.scalar(None, pa.string())), type_)
        hit = _bools(stamps.is_valid())
        found[hit] = stamps.drop_null().to_numpy(zero_copy_only=False)
        known |= hit
    return found, known


def _on_first_day(text: pa.Array) -> pa.Array:
    """Times of day as stamps of the first day of 1970; "" where a cell is none."""
    is_clock = pc.match_substring_regex(text, CLOCK)
    two_digits = pc.replace_substring_regex(text, r"^(\d:)", r"0\1")
    dated = pc.binary_join_element_wise("1970-01-01 ", two_digits, "")
    return pc.if_else(is_clock, dated, pa.scalar("", pa.string()))


def _cast_stamps(text: pa.Array, kind: pa.DataType) -> pa.Array:
    """Stamps as ns; null where there is no such day or hour, for which Arrow refuses a whole array."""
    try:
        return text.cast(kind).cast(pa.int64())
    except pa.ArrowInvalid:
        if len(text) == 1:
            return pa.nulls(1, pa.int64())
    half = len(text) // 2
    return pa.concat_arrays([_cast_stamps(text[:half], kind), _cast_stamps(text[half:], kind)])


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


def _bools(array: pa.Array) -> BoolArray:
    return np.asarray(array.to_numpy(zero_copy_only=False), dtype=bool)


def _is_blank(buffer: npt.NDArray[np.uint8], ends: IntArray) -> BoolArray:
    """Lines of white space only."""
    ink = np.cumsum(~np.isin(buffer, _WHITE))[ends]
    return np.equal(np.diff(ink, prepend=0), 0)


def _text(lines: Lines, rows: IntArray, layout: Layout, index: int) -> pa.Array:
    """One cell of some lines as strings, without what encloses them."""
    around = ' "\t\r\n' + layout.separator.decode()
    cells = lines.cells.take(numbers(lines.first[rows] + index))
    return pc.utf8_trim(cells.cast(pa.string()), characters=around)


def _floats(text: pa.Array, decimal_comma: bool) -> tuple[pa.Array, BoolArray]:
    """(n,) numbers, null where missing; and where a cell is neither a number nor missing."""
    if decimal_comma:
        text = pc.replace_substring(text, ",", ".")
    text = pc.utf8_ltrim(text, characters="+")
    is_number = pc.match_substring_regex(text, NUMBER)
    values = pc.if_else(is_number, text, pa.scalar(None, pa.string())).cast(pa.float64())
    is_number = pc.and_(is_number, pc.fill_null(pc.is_finite(values), False))  # 1e400 fits no float
    values = pc.if_else(is_number, values, pa.scalar(None, pa.float64()))
    return values, ~_bools(pc.or_(is_number, pc.is_in(text, pa.array(sorted(MISSING)))))
