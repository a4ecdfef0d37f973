"""The layout of a table in text: its separator, its columns with units, and which of them is the time.

    # comments, blank lines
    time_s,pitch_cmd [deg],v_x [m/s]
    0.00,1.5,0.012

The separator is the one of comma, semicolon and tab that splits most lines alike. The first such line is the
header unless it holds numbers where the lines below do; units stand in brackets, or in a line of their own
below the header.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from flysid.ingest.formats.common.table_columns import named_and_measured, once_each, time_unit_of
from flysid.ingest.formats.common.table_times import TIME_UNITS_NS
from flysid.ingest.formats.common.units import is_known
from flysid.stretch import FloatArray

SEPARATORS = (b",", b";", b"\t")
ZONE = r"(Z|[+-]\d\d:?\d\d)"
STAMP = rf"^\d{{4}}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d{{1,9}})?)?{ZONE}?$"
CLOCK = r"^\d\d?:\d\d:\d\d(\.\d{1,9})?$"
NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
MISSING = frozenset(
    {"", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None", "inf", "-inf", "Inf", "-Inf"}
)
MOSTLY = 0.9  # of the cells of a column of numbers are numbers
_NUMBER = re.compile(NUMBER)
_DECIMAL_COMMA = re.compile(r"^[+-]?\d+,\d+$")
_STAMP = re.compile(STAMP)
_CLOCK = re.compile(CLOCK)
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
    """

    index: int
    name: str
    unit: str
    why: str = "stated"
    first: FloatArray = field(default_factory=lambda: np.empty(0), compare=False)

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
        named = [column.name for column in self.columns if time_unit_of(column.name) is not None]
        return named if self.time is None else []


@lru_cache(maxsize=4)  # detection asks twice before the reader does
def layout_of(head: bytes) -> Layout | None:
    """The layout of a table whose first bytes these are; None where they are no table of numbers.

    At least half of these bytes must stand in the table's lines: two lines alike in a binary file, or in
    another kind of text, are none.
    """
    lines, size = _lines(head)
    if not lines or _OTHER_TEXT.match(lines[0][1]):
        return None
    ranked = [(*_commonest(lines, s), s) for s in SEPARATORS]
    alike, cells, separator = max(ranked, key=lambda r: (r[0], r[1]))
    if alike < 2:
        return None
    whole = [(at, line, cells_of(line, separator)) for at, line in lines]
    whole = [(at, line, row) for at, line, row in whole if len(row) == cells]
    if 2 * sum(len(line) + 1 for _, line, _ in whole) < size:
        return None
    table = [(at, row) for at, _, row in whole]
    names, rows, start = _header(table)
    decimal_comma = separator != b"," and _has_decimal_commas(rows)
    kinds = [_is_text([row[i] for row in rows], decimal_comma) for i in range(cells)]
    columns = tuple(Column(n, u, t) for (n, u), t in zip(names, kinds, strict=True))
    time = _time_column(columns, rows, decimal_comma)
    if sum(not c.is_text for i, c in enumerate(columns) if time is None or i != time.index) == 0:
        return None
    return Layout(separator, decimal_comma, start, columns, time)


def _lines(head: bytes) -> tuple[list[tuple[int, str]], int]:
    """(place, text) of the whole lines of the head that are neither blank nor comments nor unprintable.

    Second, the bytes of all its lines that are neither blank nor comments.
    """
    found = []
    at = 0
    size = 0
    for raw in head.split(b"\n")[:-1]:
        line = raw.removeprefix(b"\xef\xbb\xbf") if at == 0 else raw
        text = line.decode("utf-8", "replace").strip("\r")
        if text.strip() and text[0] not in "#%":
            size += len(raw) + 1
            if is_printable(line):
                found.append((at, text))
        at += len(raw) + 1
    return found, size


def is_printable(line: bytes) -> bool:
    """Whether a line can be a header or a row: no control characters, and no erased flash in front."""
    text = line.decode("utf-8", "replace").strip("\r")
    return text.replace("\t", "").isprintable() and not line.startswith(b"\xff")


def _commonest(lines: Sequence[tuple[int, str]], separator: bytes) -> tuple[int, int]:
    """How many lines have the commonest number of cells above one, and that number."""
    counts = Counter(len(cells_of(line, separator)) for _, line in lines)
    counts.pop(1, None)
    cells, alike = max(counts.items(), key=lambda c: c[1], default=(0, 0))
    return alike, cells


def cells_of(line: str, separator: bytes) -> list[str]:
    """The cells of a line; a separator inside quotes separates nothing."""
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
    table: Sequence[tuple[int, list[str]]],
) -> tuple[list[tuple[str, str]], list[list[str]], int]:
    """(name, unit) of every column, the rows below, and where the first row or the header begins."""
    first = table[0][1]
    rows = [row for _, row in table]
    below = rows[2:] or rows[1:]  # a second line may hold units
    told = [i for i, cells in enumerate(zip(*below, strict=True)) if all(map(_is_value, cells))]
    if all(_is_value(first[i]) for i in told or range(len(first))):
        return [(f"c{i + 1}", "") for i in range(len(first))], rows, table[0][0]
    named = [named_and_measured(cell, i) for i, cell in enumerate(first)]
    names = once_each([name for name, _ in named])
    units = [unit for _, unit in named]
    second = rows[1] if len(rows) > 2 else []
    # "1" is a unit, too, but a row of nothing else is one of values
    if any(c not in ("", "1") for c in second) and all(is_known(c.strip("[]()")) for c in second):
        units = [cell.strip("[]()") or unit for cell, unit in zip(second, units, strict=True)]
        return list(zip(names, units, strict=True)), rows[2:], table[2][0]
    return list(zip(names, units, strict=True)), rows[1:], table[1][0] if len(table) > 1 else table[0][0]


def _is_value(cell: str) -> bool:
    """Whether a cell holds a number, a date, or nothing."""
    if cell in MISSING:
        return True
    return any(shape.match(cell) for shape in (_NUMBER, _DECIMAL_COMMA, _STAMP, _CLOCK))


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
    """The column that is called a time, rises, and tells most rows theirs: at least half; the first of such.

    Rows without a time are counted as lost. Numbering all rows for their sake would invent times.
    """
    found: list[tuple[int, TimeColumn]] = []
    for index, column in enumerate(columns):
        stated = time_unit_of(column.name)
        if stated is None:
            continue
        told = [row[index] for row in rows if row[index] not in MISSING]
        if column.is_text:
            for shape, kind in ((_STAMP, DATED), (_CLOCK, CLOCKED)):
                stamps = sum(bool(shape.match(cell)) for cell in told)
                if stamps and stamps >= MOSTLY * len(told):
                    found.append((stamps, TimeColumn(index, column.name, kind)))
            continue
        values = np.array(numbers_in(told, decimal_comma))
        if len(values) and np.mean(np.diff(values, append=np.inf) >= 0) >= MOSTLY:
            unit = column.unit if column.unit in TIME_UNITS_NS else stated
            found.append((len(values), TimeColumn(index, column.name, unit, first=values)))
    count, best = max(found, key=lambda each: each[0], default=(0, None))
    return best if 2 * count >= len(rows) else None


def numbers_in(cells: Sequence[str], decimal_comma: bool) -> list[float]:
    """The values of those cells that are numbers."""
    plain = [cell.replace(",", ".") if decimal_comma else cell for cell in cells]
    return [float(cell) for cell in plain if _NUMBER.match(cell)]
