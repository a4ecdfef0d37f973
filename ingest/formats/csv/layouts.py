"""The layout of a table in text: its separator, its columns with units, and which of them is the time.

    # comments, blank lines
    time_s,pitch_cmd [deg],v_x [m/s]
    0.00,1.5,0.012

The separator is the one of comma, semicolon, tab and blanks that leaves the most numbers. The first of the
lines that it splits alike is the header unless it holds numbers where the lines below do; then the comment
right above may be the header, as NumPy and ROS write it. Units stand in brackets, or in a line of their own
below the names.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from flysid.ingest.formats.common.table_columns import (
    fraction_beside,
    named_and_measured,
    once_each,
    time_name,
    unit_in,
)
from flysid.ingest.formats.common.table_times import MOSTLY, MOVING, TIME_UNITS_NS, rises
from flysid.stretch import FloatArray

BLANKS = b" "  # any number of them, and of tabs
SEPARATORS = (b",", b";", b"\t", BLANKS)
COMMENT = ("#", "%")
ZONE = r"(Z|[+-]\d\d(:?\d\d)?)"
STAMP = rf"^\d{{4}}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d{{1,9}})?)?{ZONE}?$"
CLOCK = r"^\d\d?:\d\d:\d\d(\.\d{1,9})?$"
NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
MISSING = frozenset(
    {"", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None", "inf", "-inf", "Inf", "-Inf"}
)
_NUMBER = re.compile(NUMBER)
_DECIMAL_COMMA = re.compile(r"^[+-]?\d+,\d+$")
_STAMP = re.compile(STAMP)
_CLOCK = re.compile(CLOCK)
_DATE = re.compile(r"^\d{4}-\d\d-\d\d$")
_CELL = re.compile(r'(?:"[^"]*"|\S)+')
# GPS sentences and JSON, whose commas separate no columns
_OTHER_TEXT = re.compile(r"^\s*([$!][A-Z]{2}[A-Z0-9]{1,},|[\[{]\s*([\[{\"\d-]|$))")
DATED = "date and time of day"
CLOCKED = "time of day"


@dataclass(frozen=True)
class Column:
    """A column: its name without the unit, its unit where one is stated and known, and whether it is text."""

    name: str
    unit: str = ""
    is_text: bool = False


@dataclass(frozen=True)
class TimeColumn:
    """Which column tells the time.

    Attributes
    ----------
    unit : of its numbers; DATED or CLOCKED for stamps; "" where nothing states it.
    why : how the unit is known, in a word or two.
    first : (n,) its first values, where `unit` is "".
    nanoseconds : the column that holds what is missing of a second; -1 where none does.
    """

    index: int
    name: str
    unit: str
    why: str = "stated"
    first: FloatArray = field(default_factory=lambda: np.empty(0), compare=False)
    nanoseconds: int = -1

    @property
    def unit_ns(self) -> int:
        """Nanoseconds per unit; 0 for stamps."""
        return 0 if self.is_stamp else TIME_UNITS_NS[self.unit]

    @property
    def is_stamp(self) -> bool:
        """Whether it holds dates or times of day, not numbers."""
        return self.unit in (DATED, CLOCKED)

    @property
    def source(self) -> str:
        """In words, for the stream's `time_source`."""
        return f"{self.name}: {self.unit}" if self.is_stamp else f"{self.name} in {self.unit}, {self.why}"


@dataclass(frozen=True)
class Layout:
    """How to read the lines of a table.

    Attributes
    ----------
    separator : one byte.
    decimal_comma : 1,5 means 1.5.
    start : where the first row begins in the file.
    columns : one per cell of a line.
    time : None where no column tells the time: rows are numbered.
    """

    separator: bytes
    decimal_comma: bool
    start: int
    columns: tuple[Column, ...]
    time: TimeColumn | None

    @property
    def unused_times(self) -> list[str]:
        """Columns that are called a time, where none tells it."""
        named = [(column.name, time_name(column.name)) for column in self.columns]
        return [name for name, says in named if says and says.is_plain] if self.time is None else []


@dataclass(frozen=True)
class _Table:
    """The lines that a separator splits alike: their places and cells; the share of cells that are values."""

    separator: bytes
    places: list[int]
    rows: list[list[str]]
    told: float


@lru_cache(maxsize=4)  # detection asks twice before the reader does
def layout_of(head: bytes) -> Layout | None:
    """The layout of a table whose first bytes these are; None where they are no table of numbers.

    At least half of these bytes must stand in the table's lines: two lines alike in a binary file, or in
    another kind of text, are none.
    """
    lines, comments, size = _lines(head)
    if not lines or _OTHER_TEXT.match(lines[0][1]):
        return None
    found = [table for s in SEPARATORS if (table := _table(lines, size, s)) is not None]
    if not found:
        return None
    table = max(found, key=lambda t: (t.told, len(t.rows), len(t.rows[0])))
    above = [cells_of(text, table.separator) for at, text in comments if at < table.places[0]]
    names, rows, start = _header(table, above)
    decimal_comma = table.separator != b"," and _has_decimal_commas(rows)
    kinds = [_is_text([row[i] for row in rows], decimal_comma) for i in range(len(names))]
    columns = tuple(Column(n, u, t) for (n, u), t in zip(names, kinds, strict=True))
    time = _time_column(columns, rows, decimal_comma)
    if sum(not c.is_text for i, c in enumerate(columns) if time is None or i != time.index) == 0:
        return None
    return Layout(table.separator, decimal_comma, start, columns, time)


def _table(lines: Sequence[tuple[int, str]], size: int, separator: bytes) -> _Table | None:
    """The lines that a separator splits alike, if they are a table; words between blanks are none."""
    split = [(at, line, cells_of(line, separator)) for at, line in lines]
    counts = Counter(len(row) for _, _, row in split)
    counts.pop(1, None)
    cells, alike = max(counts.items(), key=lambda c: c[1], default=(0, 0))
    whole = [each for each in split if len(each[2]) == cells]
    if alike < 2 or 2 * sum(len(line) + 1 for _, line, _ in whole) < size:
        return None
    rows = [row for _, _, row in whole]
    below = rows[2:] or rows[1:]  # names, units
    told = sum(_is_value(cell) for row in below for cell in row) / (cells * len(below))
    if separator == BLANKS and told < MOSTLY:
        return None
    return _Table(separator, [at for at, _, _ in whole], rows, told)


def _lines(head: bytes) -> tuple[list[tuple[int, str]], list[tuple[int, str]], int]:
    """(place, text) of the whole lines of the head that are neither blank nor comments nor unprintable.

    Second, the comments, without their marks. Third, the bytes of all lines that are neither.
    """
    found = []
    comments = []
    at = 0
    size = 0
    for raw in head.split(b"\n")[:-1]:
        line = raw.removeprefix(b"\xef\xbb\xbf") if at == 0 else raw
        text = text_of(line)
        if text.startswith(COMMENT):
            comments.append((at, text.lstrip("#% \t")))
        elif text.strip() and not is_instruction(text):
            size += len(raw) + 1
            if is_printable(line):
                found.append((at, text))
        at += len(raw) + 1
    return found, comments, size


def text_of(line: bytes) -> str:
    """A line as text: UTF-8, or Windows' letters of the west of Europe, as spreadsheets there write them."""
    try:
        return line.decode().strip("\r")
    except UnicodeDecodeError:
        return line.decode("cp1252", "replace").strip("\r")


def is_instruction(text: str) -> bool:
    """Whether a line tells a spreadsheet the separator: `sep=;`."""
    return len(text) == 5 and text.lower().startswith("sep=")


def is_printable(line: bytes) -> bool:
    """Whether a line can be a header or a row: no control characters, and no erased flash in front."""
    text = line.decode("utf-8", "replace").strip("\r")
    return text.replace("\t", "").isprintable() and not line.startswith(b"\xff")


def cells_of(line: str, separator: bytes) -> list[str]:
    """The cells of a line; a separator inside quotes separates nothing."""
    if separator == BLANKS:
        return [cell.strip('"') for cell in _CELL.findall(line)]
    if '"' not in line:
        return [part.strip() for part in line.split(separator.decode())]
    sign = separator.decode()
    parts = [""]
    quoted = False
    for piece in re.split(f'(["{re.escape(sign)}])', line):
        if piece == '"':
            quoted = not quoted
        elif piece == sign and not quoted:
            parts.append("")
        else:
            parts[-1] += piece
    return [part.strip() for part in parts]


def _header(
    table: _Table, comments: Sequence[list[str]]
) -> tuple[list[tuple[str, str]], list[list[str]], int]:
    """(name, unit) of every column, the rows below, and where the first row begins.

    `comments` : the cells of those above the table.
    """
    rows = table.rows
    first = rows[0]
    below = rows[2:] or rows[1:]  # a second line may hold units
    told = [i for i, cells in enumerate(zip(*below, strict=True)) if all(map(_is_value, cells))]
    if not all(_is_value(first[i]) for i in told or range(len(first))):
        units = _units(rows[1]) if len(rows) > 2 else []
        count = 2 if units else 1
        start = table.places[count] if len(rows) > count else table.places[0]
        return _name(first, units), rows[count:], start
    units = _units(comments[-1]) if comments else []
    names = comments[-2:-1] if units else comments[-1:]
    if names and len(names[0]) == len(first) and not all(map(_is_value, names[0])):
        return _name(names[0], units), rows, table.places[0]
    return _name([""] * len(first), units), rows, table.places[0]


def _name(header: Sequence[str], units: Sequence[str]) -> list[tuple[str, str]]:
    """(name, unit) of every column; units of a line of their own come first."""
    named = [named_and_measured(cell.strip("'"), i) for i, cell in enumerate(header)]
    names = once_each([name for name, _ in named])
    if len(units) != len(names):
        units = [""] * len(names)
    return [(name, unit or own) for name, unit, (_, own) in zip(names, units, named, strict=True)]


def _units(cells: Sequence[str]) -> list[str]:
    """The units that a line of cells holds; [] where it holds something else.

    "1" is a unit, too, but a row of nothing else is one of values.
    """
    units = [unit_in(cell) for cell in cells]
    found = [unit for unit in units if unit is not None]
    return found if len(found) == len(units) and any(unit not in ("", "1") for unit in found) else []


def _is_value(cell: str) -> bool:
    """Whether a cell holds a number, a date, or nothing."""
    if cell in MISSING:
        return True
    return any(shape.match(cell) for shape in (_NUMBER, _DECIMAL_COMMA, _STAMP, _CLOCK, _DATE))


def _has_decimal_commas(rows: Sequence[Sequence[str]]) -> bool:
    cells = [cell for row in rows for cell in row]
    return any(map(_DECIMAL_COMMA.match, cells)) and not any("." in c for c in cells if _NUMBER.match(c))


def _is_text(cells: Sequence[str], decimal_comma: bool) -> bool:
    """Whether a column holds words: fewer than nine in ten of its cells are numbers."""
    told = [c for c in cells if c not in MISSING]
    numbers = sum(bool(_NUMBER.match(c.replace(",", ".") if decimal_comma else c)) for c in told)
    return numbers < MOSTLY * len(told)


def _time_column(
    columns: Sequence[Column], rows: Sequence[Sequence[str]], decimal_comma: bool
) -> TimeColumn | None:
    """The column that tells most rows their time, at least half, and rises; the first and plainest of such.

    Rows without a time are counted as lost. Numbering all rows for their sake would invent times. Dates with
    times of day need no name.
    """
    names = [column.name for column in columns]
    fractions = {name: beside for name in names if (beside := fraction_beside(name, names))}
    found: list[tuple[int, int, TimeColumn]] = []
    for index, column in enumerate(columns):
        says = time_name(column.name)
        if column.name in fractions.values() or (says is None and not column.is_text):
            continue
        told = [row[index] for row in rows if row[index] not in MISSING]
        time = TimeColumn(index, column.name, column.unit if column.unit in TIME_UNITS_NS else "")
        if column.is_text:
            padded = ["0" + cell if cell[1:2] == ":" else cell for cell in told]  # in the order of their text
            time = replace(time, unit=_kind_of_stamps(told), first=_places(padded))
            if not (time.unit == DATED or (time.unit and says)):
                continue
        elif column.name in fractions:
            other = names.index(fractions[column.name])
            whole = [numbers_in([row[index], row[other]], decimal_comma) for row in rows]
            values = np.array([pair[0] + pair[1] / 1e9 for pair in whole if len(pair) == 2])
            time = replace(time, unit="s", why=f"with {names[other]}", first=values, nanoseconds=other)
        else:
            values = np.array(numbers_in(told, decimal_comma))
            time = replace(time, unit=time.unit or (says.unit if says else ""), first=values)
        if rises(time.first, MOVING if says is None or says.is_plain else MOSTLY):
            rank = 0 if says is None else 1 + says.is_plain
            found.append((len(time.first), rank, time))
    count, _, best = max(found, key=lambda each: each[:2], default=(0, 0, None))
    return best if 2 * count >= len(rows) else None


def _places(cells: Sequence[str]) -> FloatArray:
    """(n,) the place of each text among all in their order."""
    return np.asarray(np.unique(cells, return_inverse=True)[1], dtype=np.float64)


def _kind_of_stamps(cells: Sequence[str]) -> str:
    """DATED or CLOCKED where most cells are such stamps; "" where they are none."""
    for shape, kind in ((_STAMP, DATED), (_CLOCK, CLOCKED)):
        if cells and sum(bool(shape.match(cell)) for cell in cells) >= MOSTLY * len(cells):
            return kind
    return ""


def numbers_in(cells: Sequence[str], decimal_comma: bool) -> list[float]:
    """The values of those cells that are numbers."""
    plain = [cell.replace(",", ".") if decimal_comma else cell for cell in cells]
    return [float(cell) for cell in plain if _NUMBER.match(cell)]
